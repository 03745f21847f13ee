// The exported controller on the exported arm, as the controller manager would run them.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "elastic_arm.hpp"
#include "tracking_controller.hpp"

using namespace PACKAGE;
using hardware_interface::return_type;
constexpr int N = FJR_N;
const rclcpp_lifecycle::State STATE{};

inline bool succeeds(CallbackReturn result) { return result == CallbackReturn::SUCCESS; }

struct Robot
{
  ElasticArm arm;
  TrackingController controller;
  int64_t now = 0, period = std::llround(FJR_SAMPLE_PERIOD * 1e9);

  // Initialise the arm with the parameters of its tag, and the controller.
  bool init(const std::unordered_map<std::string, std::string> & given)
  {
    if (!succeeds(arm.on_init({{static_cast<unsigned int>(std::llround(1 / FJR_SAMPLE_PERIOD)), given}}))) return false;
    for (const char * joint : fjr_joint_names)
      for (const std::string side : {"", "_motor"}) {
        const std::string name = joint + side;
        for (const char * kind : {"position", "velocity", "effort"})
          arm.states[name + "/" + kind] = std::make_shared<hardware_interface::StateInterface>(name, kind);
        arm.commands[name + "/effort"] = std::make_shared<hardware_interface::CommandInterface>(name, "effort");
      }
    const std::string clock = CLOCK;
    arm.states[clock + "/stamp"] = std::make_shared<hardware_interface::StateInterface>(clock, "stamp");
    controller.on_init();
    set("use_sim_time", true);  // cycles take less than their period: only the stamps are the time
    set("stamp_interface", clock + "/stamp");
    return succeeds(arm.on_configure(STATE)) && succeeds(arm.on_activate(STATE));
  }

  template <typename T>
  void set(const std::string & name, T value) { controller.get_node()->parameters[name] = std::move(value); }

  bool configure() { return succeeds(controller.on_configure(STATE)); }

  bool activate()
  {
    controller.command_interfaces_.clear();
    controller.state_interfaces_.clear();
    for (const auto & name : controller.command_interface_configuration().names)
      controller.command_interfaces_.push_back({arm.commands.at(name)});
    for (const auto & name : controller.state_interface_configuration().names)
      controller.state_interfaces_.push_back({arm.states.at(name)});
    controller.export_interfaces();
    return succeeds(controller.on_activate(STATE));
  }

  bool cycle()
  {
    return cycle([] { return true; });
  }

  // One cycle in which `fault` changes what the arm measured; it returns whether the controller is updated.
  template <typename F>
  bool cycle(F fault)
  {
    const rclcpp::Time time(now);
    now += period;
    bool done = arm.read(time, {}) == return_type::OK;
    if (fault()) done = controller.update(time, {}) == return_type::OK && done;
    return arm.write(time, {}) == return_type::OK && done;
  }

  double effort(int i) const { return *arm.commands.at(std::string(fjr_joint_names[i]) + "_motor/effort")->get_optional(); }
  double link(int i) const { return *arm.states.at(std::string(fjr_joint_names[i]) + "/position")->get_optional(); }
  double speed(int i) const { return *arm.states.at(std::string(fjr_joint_names[i]) + "/velocity")->get_optional(); }
  double stamp() const { return *arm.states.at(CLOCK "/stamp")->get_optional(); }
  double exported(int k) const { return *controller.states[k]->get_optional(); }

  double error() const
  {
    double jets[FJR_JETS * N], worst = 0;
    fjr_reference_jets(fjr_scenario_reference, stamp() * 1e-9, jets);
    for (int i = 0; i < N; ++i) worst = std::fmax(worst, std::fabs(link(i) - jets[i]));
    return worst;
  }
};

inline void show(const char * name, double value) { std::printf("%s %.17g\n", name, value); }

// The timers of the controller, in the thread of the executor.
inline void tick(Robot & r)
{
  for (const auto & timer : r.controller.get_node()->timers) timer->callback();
}

// The kinds of the events so far.
inline std::string events_of(Robot & r)
{
  using Events = rclcpp::Publisher<diagnostic_msgs::msg::DiagnosticStatus>;
  tick(r);
  std::string names;
  for (const auto & event : static_cast<Events *>(r.controller.get_node()->publishers.at("~/events").get())->messages)
    names += event.name + ";";
  return names;
}
