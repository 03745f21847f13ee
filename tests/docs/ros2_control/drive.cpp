// SPDX-License-Identifier: Apache-2.0
// Drives the controller of docs/export_c.md on the exported plant as the controller manager does; prints "name value" lines.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <controller_interface/controller_interface.hpp>

#include "paper_k31.h"

using controller_interface::CallbackReturn;
using controller_interface::return_type;

extern "C" controller_interface::ControllerInterface * made_by_plugin();

static bool reference_fails = false;

// What the controller calls in place of paper_k31_reference: fails on demand and then writes nothing.
extern "C" int reference_of_the_test(double t, double jets[PAPER_K31_JETS], paper_k31_work * work)
{
  return reference_fails ? 1 : paper_k31_reference(t, jets, work);
}

// A controller, activated on the plant at its start.
struct Rig
{
  std::unique_ptr<controller_interface::ControllerInterface> controller{made_by_plugin()};
  paper_k31_work work;
  double x[4], position[2], velocity[2], effort = std::nan("");
  std::int64_t ns = 100'000'000'000;

  explicit Rig(const std::string & unread = "")
  {
    std::copy_n(paper_k31_x0, 4, x);
    paper_k31_plant_measure(x, position, velocity, &work);
    configured(static_cast<unsigned int>(std::lround(1.0 / PAPER_K31_SAMPLE_PERIOD)));
    const std::string joint = paper_k31_joint_names[0];
    const std::map<std::string, const double *> states = {{joint + "/position", &position[0]},
      {joint + "_motor/position", &position[1]}, {joint + "/velocity", &velocity[0]},
      {joint + "_motor/velocity", &velocity[1]}};
    std::vector<hardware_interface::LoanedStateInterface> read;
    for (const auto & name : controller->state_interface_configuration().names)
      read.emplace_back(name == unread ? nullptr : states.at(name));
    std::vector<hardware_interface::LoanedCommandInterface> written;
    for (const auto & name : controller->command_interface_configuration().names)
      if (name == joint + "/effort") written.emplace_back(&effort);
    controller->assign_interfaces(std::move(written), std::move(read));
    controller->on_activate({});
  }

  bool configured(unsigned int rate)
  {
    controller->init({"flexible_joint_controller", rate});
    return controller->on_configure({}) == CallbackReturn::SUCCESS;
  }

  return_type update()
  {
    const auto period = static_cast<std::int64_t>(std::lround(1e9 * PAPER_K31_SAMPLE_PERIOD));
    paper_k31_plant_measure(x, position, velocity, &work);
    const return_type result = controller->update(rclcpp::Time(ns), rclcpp::Duration(period));
    ns += period;
    for (int i = 0; i < PAPER_K31_INNER_STEPS; ++i)
      paper_k31_plant_step(x, &effort, PAPER_K31_SAMPLE_PERIOD / PAPER_K31_INNER_STEPS, x, &work);
    return result;
  }
};

static void tells(const char * name, double value) { std::printf("%s %.17g\n", name, value); }

static void track()
{
  Rig rig;
  double worst = 0.0, jets[PAPER_K31_JETS];
  for (int k = 0; k < 4000; ++k) {
    if (rig.update() != return_type::OK) return tells("failed_at", k);
    if (k == 0) tells("first_effort", rig.effort);
    paper_k31_reference(1e-3 * k, jets, &rig.work);
    if (k >= 2000) worst = std::max(worst, std::fabs(rig.position[0] - jets[0]));
  }
  tells("worst_error", worst);
}

// The effort that each way to stop leaves behind after 100 updates; what it was before.
static void stop(const char * name, CallbackReturn (controller_interface::ControllerInterface::*transition)(
                                      const rclcpp_lifecycle::State &))
{
  Rig rig;
  for (int k = 0; k < 100; ++k) rig.update();
  tells("effort_before", rig.effort);
  (rig.controller.get()->*transition)({});
  tells(name, rig.effort);
  rig.controller->release_interfaces();
  (rig.controller.get()->*transition)({});  // with nothing to write
}

// The effort after an update that must fail; -1e9 where it did not say so.
static void failing(const char * name, Rig & rig)
{
  tells(name, rig.update() == return_type::ERROR ? rig.effort : -1e9);
}

int main()
{
  track();
  stop("deactivated", &controller_interface::ControllerInterface::on_deactivate);
  stop("error", &controller_interface::ControllerInterface::on_error);
  stop("shutdown", &controller_interface::ControllerInterface::on_shutdown);

  Rig no_reference, not_finite, unread{std::string(paper_k31_joint_names[0]) + "/velocity"};
  no_reference.update();
  reference_fails = true;
  failing("reference_fails", no_reference);
  reference_fails = false;
  not_finite.update();
  not_finite.x[0] = std::nan("");
  failing("state_not_finite", not_finite);
  failing("state_unread", unread);

  for (unsigned int rate : {0u, 500u, 1000u, 2000u}) {
    Rig rig;
    std::printf("configures_at_%u %d\n", rate, rig.configured(rate));
  }
  return 0;
}
