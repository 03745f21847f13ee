// SPDX-License-Identifier: Apache-2.0
// In place of rclcpp's logging: the macro, to stderr.
#pragma once

#include <cstdio>

namespace rclcpp
{
struct Logger
{
};
}  // namespace rclcpp

#define RCLCPP_ERROR(logger, ...) \
  do { \
    static_cast<void>(static_cast<const rclcpp::Logger &>(logger)); \
    std::fprintf(stderr, __VA_ARGS__); \
    std::fputc('\n', stderr); \
  } while (0)
