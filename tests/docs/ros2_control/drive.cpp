// SPDX-License-Identifier: Apache-2.0
// Runs the controller of docs/export_c.md on the exported plant; prints its worst error from 2 s on, and its first effort.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <memory>
#include <string>

#include <controller_interface/controller_interface.hpp>

#include "paper_k31.h"

extern "C" controller_interface::ControllerInterface * made_by_plugin();

int main()
{
  std::unique_ptr<controller_interface::ControllerInterface> controller(made_by_plugin());
  paper_k31_work work;
  double x[4], position[2], velocity[2], jets[5], effort = 0.0, worst = 0.0, first = 0.0;
  std::copy_n(paper_k31_x0, 4, x);
  const std::string joint = paper_k31_joint_names[0];
  const std::map<std::string, const double *> states = {{joint + "/position", &position[0]},
    {joint + "_motor/position", &position[1]}, {joint + "/velocity", &velocity[0]},
    {joint + "_motor/velocity", &velocity[1]}};
  for (const auto & name : controller->state_interface_configuration().names)
    controller->state_interfaces_.push_back({states.at(name)});
  if (controller->command_interface_configuration().names != std::vector<std::string>{joint + "/effort"}) return 2;
  controller->command_interfaces_.push_back({&effort});
  controller->on_init();
  controller->on_activate({});
  for (int k = 0; k < 4000; ++k) {
    const double t = 1e-3 * k;
    paper_k31_plant_measure(x, position, velocity, &work);
    if (controller->update({100.0 + t}, {1e-3}) != controller_interface::return_type::OK) return 1;
    if (k == 0) first = effort;
    paper_k31_reference(t, jets, &work);
    if (k >= 2000) worst = std::max(worst, std::fabs(position[0] - jets[0]));
    for (int i = 0; i < PAPER_K31_INNER_STEPS; ++i)
      paper_k31_plant_step(x, &effort, PAPER_K31_SAMPLE_PERIOD / PAPER_K31_INNER_STEPS, x, &work);
  }
  position[0] = std::nan("");
  const bool stops = controller->update({200.0}, {1e-3}) == controller_interface::return_type::ERROR && effort == 0.0;
  std::printf("%.17g %.17g %s\n", worst, first, stops ? "stops" : "goes on");
  return 0;
}
