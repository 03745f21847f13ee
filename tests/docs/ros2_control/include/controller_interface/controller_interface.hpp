// SPDX-License-Identifier: Apache-2.0
// What the controller in docs/export_c.md uses of ros2_control 4 (Jazzy), with the same names and signatures, and no more.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <rclcpp/logging.hpp>

namespace rclcpp
{
class Time
{
public:
  explicit Time(std::int64_t nanoseconds) : ns_(nanoseconds) {}
  double seconds() const { return 1e-9 * static_cast<double>(ns_); }

private:
  std::int64_t ns_;
};

using Duration = Time;
}  // namespace rclcpp

namespace rclcpp_lifecycle
{
class State
{
};

class LifecycleNode
{
public:
  rclcpp::Logger get_logger() const { return {}; }
};

namespace node_interfaces
{
class LifecycleNodeInterface
{
public:
  enum class CallbackReturn : std::uint8_t { SUCCESS = 97, FAILURE = 98, ERROR = 99 };

  virtual ~LifecycleNodeInterface() = default;
  virtual CallbackReturn on_configure(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_cleanup(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_shutdown(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_activate(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_deactivate(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_error(const State &) { return CallbackReturn::FAILURE; }
};
}  // namespace node_interfaces
}  // namespace rclcpp_lifecycle

namespace hardware_interface
{
/// As in ros2_control it can be moved, not copied; `value` is null where the hardware cannot be read.
class LoanedStateInterface
{
public:
  explicit LoanedStateInterface(const double * value) : value_(value) {}
  LoanedStateInterface(const LoanedStateInterface &) = delete;
  LoanedStateInterface(LoanedStateInterface &&) = default;

  template <typename T = double>
  [[nodiscard]] std::optional<T> get_optional(unsigned int max_tries = 10) const
  {
    return value_ && max_tries ? std::optional<T>(*value_) : std::nullopt;
  }

private:
  const double * value_;
};

class LoanedCommandInterface
{
public:
  explicit LoanedCommandInterface(double * value) : value_(value) {}
  LoanedCommandInterface(const LoanedCommandInterface &) = delete;
  LoanedCommandInterface(LoanedCommandInterface &&) = default;

  template <typename T>
  [[nodiscard]] bool set_value(const T & given, unsigned int max_tries = 10)
  {
    *value_ = given;
    return max_tries > 0;
  }

private:
  double * value_;
};
}  // namespace hardware_interface

namespace controller_interface
{
using CallbackReturn = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::CallbackReturn;

enum class return_type : std::uint8_t { OK = 0, ERROR = 1 };
enum class interface_configuration_type : std::uint8_t { ALL = 0, INDIVIDUAL = 1, NONE = 2 };

struct InterfaceConfiguration
{
  interface_configuration_type type = interface_configuration_type::NONE;
  std::vector<std::string> names = {};
};

struct ControllerInterfaceParams
{
  std::string controller_name = "";
  unsigned int update_rate = 0;
};

class ControllerInterface : public rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface
{
public:
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual CallbackReturn on_init() = 0;
  virtual return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) = 0;

  return_type init(const ControllerInterfaceParams & params)
  {
    params_ = params;
    return on_init() == CallbackReturn::SUCCESS ? return_type::OK : return_type::ERROR;
  }

  virtual void assign_interfaces(
    std::vector<hardware_interface::LoanedCommandInterface> && command_interfaces,
    std::vector<hardware_interface::LoanedStateInterface> && state_interfaces)
  {
    command_interfaces_ = std::move(command_interfaces);
    state_interfaces_ = std::move(state_interfaces);
  }

  virtual void release_interfaces()
  {
    command_interfaces_.clear();
    state_interfaces_.clear();
  }

  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() { return node_; }
  unsigned int get_update_rate() const { return params_.update_rate; }

protected:
  std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
  std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;

private:
  ControllerInterfaceParams params_;
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node_ = std::make_shared<rclcpp_lifecycle::LifecycleNode>();
};
}  // namespace controller_interface
