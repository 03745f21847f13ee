// SPDX-License-Identifier: Apache-2.0
// Host of an exported controller of ros2_control: recorded inputs as state interfaces and times of updates. The program
// has its own clock, so that the controller reads the recorded time of arrival.
#include <time.h>

#include <algorithm>
#include <cmath>
#include <memory>

#include "tracking_controller.hpp"

using namespace PACKAGE;

#include "input.h"

constexpr int N = FJR_N;
const rclcpp_lifecycle::State STATE_{};
static int64_t steady = 0;

extern "C" int clock_gettime(clockid_t, struct timespec * now) noexcept
{
  now->tv_sec = steady / 1000000000, now->tv_nsec = steady % 1000000000;
  return 0;
}

using State = hardware_interface::StateInterface;
using Command = hardware_interface::CommandInterface;

struct Host
{
  TrackingController controller;
  std::vector<State::SharedPtr> states;
  std::vector<Command::SharedPtr> commands;

  explicit Host(bool simulated)
  {
    controller.on_init();
    controller.get_node()->parameters["use_sim_time"] = simulated;
    controller.rate = static_cast<unsigned int>(std::llround(1 / FJR_SAMPLE_PERIOD));
    if (controller.on_configure(STATE_) != CallbackReturn::SUCCESS) std::exit(3);
    for (const auto & name : controller.command_interface_configuration().names) {
      commands.push_back(std::make_shared<Command>(name, ""));
      controller.command_interfaces_.push_back({commands.back()});
    }
    for (const auto & name : controller.state_interface_configuration().names)
      states.push_back(std::make_shared<State>(name, "")), controller.state_interfaces_.push_back({nullptr});
    controller.export_interfaces();
    if (controller.on_activate(STATE_) != CallbackReturn::SUCCESS) std::exit(3);
  }

  // One cycle of the controller manager; without a sample the values are not available. Efforts are written once.
  void update(int64_t time, const fjr_sample * sample)
  {
    double values[4 * N];
    if (sample) std::copy_n(sample->velocity, 2 * N, std::copy_n(sample->motor, N, std::copy_n(sample->link, N, values)));
    for (std::size_t i = 0; i < states.size(); ++i) {
      controller.state_interfaces_[i].handle = sample ? states[i] : nullptr;
      if (sample) (void)states[i]->set_value(values[i]);
    }
    for (const auto & command : commands) (void)command->set_value(NAN);
    if (controller.update(rclcpp::Time(time), {}) != controller_interface::return_type::OK) std::exit(4);
    double u[N];
    for (int i = 0; i < N; ++i) u[i] = *commands[i]->get_optional();
    if (!std::isnan(u[0])) put(u);
  }
};

int main(int count, char ** argument)
{
  if (count != 6) return 2;
  const inputs all = read_inputs(argument);
  auto host = std::make_unique<Host>(all.simulated);
  for (int64_t k = 0; k < all.rounds; ++k)
    for (std::size_t i = 0; i < all.count; ++i) {
      fjr_sample sample = all.input[i].sample;
      steady = all.input[i].time + k * all.shift, sample.stamp += k * all.shift;
      switch (all.input[i].kind) {
        case STATE:
        case NOT_FINITE:
          if (all.simulated) host->update(sample.stamp, nullptr);
          host->update(sample.stamp, &sample);
          break;
        case TICK: host->update(steady, nullptr); break;
        case RESTART: host = std::make_unique<Host>(all.simulated); break;
        default: break;
      }
    }
  std::free(all.input);
  return 0;
}
