// SPDX-License-Identifier: Apache-2.0
// What the controller in docs/export_c.md uses of ros2_control (Jazzy), with the same names and signatures, and no more.
#pragma once

#include <optional>
#include <string>
#include <vector>

namespace rclcpp
{
struct Time
{
  double seconds() const { return s; }
  double s;
};

struct Duration
{
  double seconds() const { return s; }
  double s;
};
}  // namespace rclcpp

namespace rclcpp_lifecycle
{
struct State
{
};
}  // namespace rclcpp_lifecycle

namespace hardware_interface
{
struct LoanedStateInterface
{
  std::optional<double> get_optional(unsigned int max_tries = 10) const { return max_tries ? *value : std::optional<double>(); }
  const double * value;
};

struct LoanedCommandInterface
{
  [[nodiscard]] bool set_value(const double & given, unsigned int max_tries = 10)
  {
    *value = given;
    return max_tries > 0;
  }
  double * value;
};
}  // namespace hardware_interface

namespace controller_interface
{
enum class return_type { OK, ERROR };
enum class CallbackReturn { SUCCESS, FAILURE, ERROR };
enum class interface_configuration_type { ALL, INDIVIDUAL, NONE };

struct InterfaceConfiguration
{
  interface_configuration_type type;
  std::vector<std::string> names;
};

class ControllerInterface
{
public:
  virtual ~ControllerInterface() = default;
  virtual CallbackReturn on_init() = 0;
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual CallbackReturn on_activate(const rclcpp_lifecycle::State & previous_state) = 0;
  virtual return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) = 0;

  std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
  std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;
};
}  // namespace controller_interface
