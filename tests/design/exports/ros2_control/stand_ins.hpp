// Stand-ins for the parts of ROS 2 and ros2_control 4 (Jazzy) that the exported plugins use, without middleware.
#pragma once

#include <any>
#include <array>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#define RCLCPP_LOG(...) (std::printf(__VA_ARGS__), std::printf("\n"))
#define RCLCPP_ERROR(logger, ...) ((void)(logger), RCLCPP_LOG(__VA_ARGS__))
#define RCLCPP_WARN(logger, ...) ((void)(logger), RCLCPP_LOG(__VA_ARGS__))
#define RCLCPP_INFO(logger, ...) ((void)(logger), RCLCPP_LOG(__VA_ARGS__))
#define PLUGINLIB_EXPORT_CLASS(plugin, base) static_assert(std::is_base_of_v<base, plugin>);

namespace std_msgs::msg
{
struct Float64MultiArray
{
  struct Dimension { std::string label; std::uint32_t size, stride; };
  struct { std::vector<Dimension> dim; } layout;
  std::vector<double> data;
};
}  // namespace std_msgs::msg

namespace diagnostic_msgs::msg
{
struct DiagnosticStatus
{
  static constexpr std::uint8_t OK = 0, WARN = 1, ERROR = 2;
  std::uint8_t level = OK;
  std::string name, message;
};
}  // namespace diagnostic_msgs::msg

namespace std_srvs::srv
{
struct Trigger
{
  struct Request { using SharedPtr = std::shared_ptr<Request>; };
  struct Response
  {
    using SharedPtr = std::shared_ptr<Response>;
    bool success = false;
    std::string message;
  };
};
}  // namespace std_srvs::srv

namespace rclcpp
{
struct Logger {};

class Time
{
public:
  explicit Time(std::int64_t now) : now_(now) {}
  std::int64_t nanoseconds() const { return now_; }

private:
  std::int64_t now_;
};

struct Duration {};

template <typename M>
struct Publisher
{
  using SharedPtr = std::shared_ptr<Publisher>;
  std::vector<M> messages;
  void publish(const M & message) { messages.push_back(message); }
};

template <typename S>
struct Service
{
  using SharedPtr = std::shared_ptr<Service>;
  std::function<void(typename S::Request::SharedPtr, typename S::Response::SharedPtr)> callback;
};

struct TimerBase
{
  using SharedPtr = std::shared_ptr<TimerBase>;
  std::function<void()> callback;
};

class Parameter
{
public:
  explicit Parameter(std::any value) : value_(std::move(value)) {}
  std::vector<double> as_double_array() const { return std::any_cast<std::vector<double>>(value_); }
  std::vector<std::string> as_string_array() const { return std::any_cast<std::vector<std::string>>(value_); }
  std::string as_string() const { return std::any_cast<std::string>(value_); }
  double as_double() const { return std::any_cast<double>(value_); }
  bool as_bool() const { return std::any_cast<bool>(value_); }

private:
  std::any value_;
};
}  // namespace rclcpp

namespace rclcpp_lifecycle
{
struct State {};

class LifecycleNode
{
public:
  bool has_parameter(const std::string & name) const { return parameters.count(name) > 0; }
  template <typename T>
  void declare_parameter(const std::string & name, const T & value) { parameters.emplace(name, value); }
  rclcpp::Parameter get_parameter(const std::string & name) const { return rclcpp::Parameter(parameters.at(name)); }
  rclcpp::Logger get_logger() const { return {}; }
  const char * get_name() const { return "tracking_controller"; }
  template <typename M>
  typename rclcpp::Publisher<M>::SharedPtr create_publisher(const std::string & topic, int)
  {
    auto made = std::make_shared<rclcpp::Publisher<M>>();
    publishers[topic] = made;
    return made;
  }
  template <typename P>
  rclcpp::TimerBase::SharedPtr create_wall_timer(P, std::function<void()> callback)
  {
    timers.push_back(std::make_shared<rclcpp::TimerBase>(rclcpp::TimerBase{std::move(callback)}));
    return timers.back();
  }
  template <typename S, typename F>
  typename rclcpp::Service<S>::SharedPtr create_service(const std::string & name, F callback)
  {
    auto made = std::make_shared<rclcpp::Service<S>>(rclcpp::Service<S>{std::move(callback)});
    services[name] = made;
    return made;
  }
  std::map<std::string, std::any> parameters{{"use_sim_time", false}};
  std::map<std::string, std::shared_ptr<void>> publishers, services;
  std::vector<rclcpp::TimerBase::SharedPtr> timers;
};
}  // namespace rclcpp_lifecycle

namespace hardware_interface
{
enum class return_type { OK, ERROR };
enum class CallbackReturn { SUCCESS, FAILURE, ERROR };

class Handle
{
public:
  Handle(const std::string & prefix, const std::string & name) : name_(prefix + "/" + name) {}
  const std::string & get_name() const { return name_; }
  template <typename T = double>
  [[nodiscard]] std::optional<T> get_optional() const { return value_; }
  [[nodiscard]] bool set_value(double value) { return value_ = value, true; }

private:
  std::string name_;
  double value_ = std::numeric_limits<double>::quiet_NaN();
};

struct StateInterface : Handle
{
  using Handle::Handle;
  using SharedPtr = std::shared_ptr<StateInterface>;
};

struct CommandInterface : Handle
{
  using Handle::Handle;
  using SharedPtr = std::shared_ptr<CommandInterface>;
};

// A loan; a null handle is a value that is not available.
template <typename T>
struct Loaned
{
  typename T::SharedPtr handle;
  template <typename V = double>
  [[nodiscard]] std::optional<V> get_optional() const { return handle ? handle->get_optional() : std::nullopt; }
  [[nodiscard]] bool set_value(double value) { return handle && handle->set_value(value); }
};

struct HardwareInfo
{
  unsigned int rw_rate = 0;
  std::unordered_map<std::string, std::string> hardware_parameters;
};

struct HardwareComponentInterfaceParams { HardwareInfo hardware_info; };

class SystemInterface
{
public:
  virtual ~SystemInterface() = default;
  virtual CallbackReturn on_init(const HardwareComponentInterfaceParams & params)
  {
    info_ = params.hardware_info;
    return CallbackReturn::SUCCESS;
  }
  virtual CallbackReturn on_configure(const rclcpp_lifecycle::State &) = 0;
  virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &) = 0;
  virtual CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) = 0;
  virtual return_type read(const rclcpp::Time &, const rclcpp::Duration &) = 0;
  virtual return_type write(const rclcpp::Time &, const rclcpp::Duration &) = 0;
  bool has_state(const std::string & name) const { return states.count(name) > 0; }
  bool has_command(const std::string & name) const { return commands.count(name) > 0; }
  const StateInterface::SharedPtr & get_state_interface_handle(const std::string & name) { return states.at(name); }
  const CommandInterface::SharedPtr & get_command_interface_handle(const std::string & name) { return commands.at(name); }
  rclcpp::Logger get_logger() const { return {}; }
  std::map<std::string, StateInterface::SharedPtr> states;
  std::map<std::string, CommandInterface::SharedPtr> commands;

protected:
  HardwareInfo info_;
};
}  // namespace hardware_interface

namespace controller_interface
{
using hardware_interface::CallbackReturn;
using hardware_interface::return_type;
enum class interface_configuration_type { INDIVIDUAL };

struct InterfaceConfiguration
{
  interface_configuration_type type;
  std::vector<std::string> names;
};

class ChainableControllerInterface
{
public:
  virtual ~ChainableControllerInterface() = default;
  virtual CallbackReturn on_init() = 0;
  virtual CallbackReturn on_configure(const rclcpp_lifecycle::State &) = 0;
  virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &) = 0;
  virtual CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) = 0;
  virtual CallbackReturn on_error(const rclcpp_lifecycle::State &) = 0;
  virtual CallbackReturn on_shutdown(const rclcpp_lifecycle::State &) = 0;
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  return_type update(const rclcpp::Time & time, const rclcpp::Duration & period)
  {
    if (!chained && update_reference_from_subscribers(time, period) != return_type::OK) return return_type::ERROR;
    return update_and_write_commands(time, period);
  }
  void export_interfaces()
  {
    states = on_export_state_interfaces_list();
    ordered_exported_reference_interfaces_ = on_export_reference_interfaces_list();
  }
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() const { return node_; }
  unsigned int get_update_rate() const { return rate; }
  bool is_in_chained_mode() const { return chained; }

  unsigned int rate = 1000;
  bool chained = false;
  std::vector<hardware_interface::Loaned<hardware_interface::CommandInterface>> command_interfaces_;
  std::vector<hardware_interface::Loaned<hardware_interface::StateInterface>> state_interfaces_;
  std::vector<hardware_interface::StateInterface::SharedPtr> states;
  std::vector<hardware_interface::CommandInterface::SharedPtr> ordered_exported_reference_interfaces_;

protected:
  virtual std::vector<hardware_interface::StateInterface::SharedPtr> on_export_state_interfaces_list() = 0;
  virtual std::vector<hardware_interface::CommandInterface::SharedPtr> on_export_reference_interfaces_list() = 0;
  virtual return_type update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &) = 0;
  virtual return_type update_and_write_commands(const rclcpp::Time &, const rclcpp::Duration &) = 0;

private:
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node_ = std::make_shared<rclcpp_lifecycle::LifecycleNode>();
};
}  // namespace controller_interface
