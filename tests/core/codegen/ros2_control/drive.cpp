// Run the exported controller on the exported arm as the controller manager would; print numbers by name.
//   drive MODE [parameter=numbers ..]   a parameter of the tag of the arm
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <new>
#include <sstream>

#include "elastic_arm.hpp"
#include "tracking_controller.hpp"

using namespace PACKAGE;
using hardware_interface::return_type;
constexpr int N = FJR_N;
const rclcpp_lifecycle::State STATE{};

static long allocations = 0;
[[gnu::noinline]] void * operator new(std::size_t size) { return ++allocations, std::malloc(size); }
[[gnu::noinline]] void operator delete(void * memory) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void * memory, std::size_t) noexcept { std::free(memory); }

static bool succeeds(CallbackReturn result) { return result == CallbackReturn::SUCCESS; }

struct Robot
{
  ElasticArm arm;
  TrackingController controller;
  int64_t now = 1000000000, period = std::llround(FJR_SAMPLE_PERIOD * 1e9);

  // Initialise the arm with the parameters of its tag, and the controller.
  bool init(const std::unordered_map<std::string, std::string> & given, bool stamped)
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
    if (stamped) set("stamp_interface", clock + "/stamp");
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
    const rclcpp::Time time(now);
    now += period;
    bool done = arm.read(time, {}) == return_type::OK;
    done = controller.update(time, {}) == return_type::OK && done;
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

static void show(const char * name, double value) { std::printf("%s %.17g\n", name, value); }

// The timers of the controller, in the thread of the executor.
static void tick(Robot & r)
{
  for (const auto & timer : r.controller.get_node()->timers) timer->callback();
}

// One line per cycle: what the controller read and the effort it wrote.
static void record(Robot & r, int cycles)
{
  for (int k = 0; k < cycles; ++k) {
    r.cycle();
    for (const auto & state : r.controller.state_interfaces_) std::printf("%a ", *state.get_optional());
    for (int i = 0; i < N; ++i) std::printf("%a ", r.effort(i));
    std::printf("\n");
  }
}

static void track(Robot & r)
{
  double worst = 0;
  for (int k = 0; k < 6000; ++k) {
    r.cycle();
    if (k > 3000) worst = std::fmax(worst, r.error());
    if (k % 10 == 9) tick(r);
  }
  show("worst_error", worst);
  show("state", r.exported(0));
  show("V", r.exported(3));
  using Certificates = rclcpp::Publisher<std_msgs::msg::Float64MultiArray>;
  const auto & sent = static_cast<Certificates *>(r.controller.get_node()->publishers.at("~/certificate").get())->messages;
  show("certificates", static_cast<double>(sent.size()));
  for (std::size_t i = 0; i < sent.back().data.size(); ++i) show(("certificate_" + std::to_string(i)).c_str(), sent.back().data[i]);
}

// Memory that the plugins allocate while they run.
static void allocate(Robot & r)
{
  for (int k = 0; k < 2000; ++k) {
    if (k == 10) allocations = 0;
    r.cycle();
  }
  show("allocations", static_cast<double>(allocations));
}

// Deactivate the controller in motion, then start again; restart the hardware.
static void restart(Robot & r)
{
  for (int k = 0; k < 1000; ++k) r.cycle();
  show("speed_before", r.speed(0));
  r.controller.on_deactivate(STATE);
  for (int i = 0; i < N; ++i) show(("stop_effort_" + std::to_string(i)).c_str(), r.effort(i));
  show("activates", r.activate());
  for (int k = 0; k < 4000; ++k) r.cycle();
  show("state", r.exported(0));
  r.controller.on_deactivate(STATE);
  r.arm.on_deactivate(STATE);
  const double before = r.link(0);
  for (int k = 0; k < 50; ++k) r.arm.read(rclcpp::Time(r.now += r.period), {});
  show("moved_while_inactive", r.link(0) - before);
  show("speed_while_inactive", r.speed(0));
  r.arm.on_activate(STATE);
  r.activate();
  for (int k = 0; k < 4000; ++k) r.cycle();
  show("state_after_restart", r.exported(0));
}

static std::string events_of(Robot & r)
{
  using Events = rclcpp::Publisher<diagnostic_msgs::msg::DiagnosticStatus>;
  tick(r);
  std::string names;
  for (const auto & event : static_cast<Events *>(r.controller.get_node()->publishers.at("~/events").get())->messages)
    names += event.name + ";";
  return names;
}

// A value that is not available: the effort stays until the timeout, then it is that of the stop policy.
static void silence(Robot & r)
{
  for (int k = 0; k < 300; ++k) r.cycle();
  const double before = r.effort(0);
  const auto kept = std::exchange(r.controller.state_interfaces_[0].handle, nullptr);
  r.cycle();
  show("held", r.effort(0) - before);
  while (r.effort(0) == before) r.cycle();
  show("after_timeout", r.effort(0));
  r.controller.state_interfaces_[0].handle = kept;
  for (int k = 0; k < 10; ++k) r.cycle();
  show("state", r.exported(0));
  std::printf("events %s\n", events_of(r).c_str());
}

static void stop(Robot & r)
{
  for (int k = 0; k < 1500; ++k) r.cycle();
  show("state", r.exported(0));
  show("stops", r.exported(1));
  show("effort", r.effort(0));
  std::printf("events %s\n", events_of(r).c_str());
}

static void not_finite(Robot & r)
{
  for (int k = 0; k < 300; ++k) r.cycle();
  const double before = r.effort(0);
  const rclcpp::Time time(r.now += r.period);
  r.arm.read(time, {});
  (void)r.arm.states.at(std::string(fjr_joint_names[0]) + "/position")->set_value(NAN);
  show("update", r.controller.update(time, {}) == return_type::OK);
  show("effort", r.effort(0));
  show("change", r.effort(0) - before);
}

// The arm is led by the reference interfaces: it holds its position, then follows a slow sine.
static void chained(Robot & r)
{
  auto & references = r.controller.ordered_exported_reference_interfaces_;
  const double start = r.link(0);
  for (int k = 0; k < 200; ++k) r.cycle();
  show("held", r.link(0) - start);
  double worst = 0;
  for (int k = 0; k < 6000; ++k) {
    const double t = k * FJR_SAMPLE_PERIOD, c = 0.2, w = 1.5;
    (void)references[0]->set_value(start + c * (1 - std::cos(w * t)));
    (void)references[N]->set_value(c * w * std::sin(w * t));
    (void)references[2 * N]->set_value(c * w * w * std::cos(w * t));
    r.cycle();
    if (k > 1000) worst = std::fmax(worst, std::fabs(r.link(0) - *references[0]->get_optional()));
  }
  show("worst_error", worst);
  std::printf("first_reference %s\n", references[0]->get_name().c_str());
}

static void configure(Robot & r)
{
  for (unsigned int rate : {0u, 500u, 1000u}) {
    r.controller.rate = rate;
    show(("configures_at_" + std::to_string(rate)).c_str(), r.configure());
  }
  r.set("limits.effort", std::vector<double>{1.0});
  show("short_list", r.configure());
  r.set("limits.effort", std::vector<double>(N, -1.0));
  show("negative_limit", r.configure());
  r.set("limits.effort", std::vector<double>(N, 1.0));
  r.set("on_stop", std::string("brake"));
  show("unknown_policy", r.configure());
}

int main(int argc, char ** argv)
{
  const std::string mode = argv[1];
  Robot r;
  std::unordered_map<std::string, std::string> given{{"time", "cycles"}};
  bool stamped = true;
  for (int i = 2; i < argc; ++i) {
    const std::string word = argv[i], name = word.substr(0, word.find('=')), value = word.substr(word.find('=') + 1);
    if (name == "unstamped")
      stamped = false;
    else if (name.rfind("limits.", 0) == 0 || name.rfind("gains.", 0) == 0)
      continue;
    else
      given[name] = value;
  }
  if (!r.init(given, stamped)) return 2;
  for (int i = 2; i < argc; ++i) {
    const std::string word = argv[i], name = word.substr(0, word.find('='));
    std::istringstream values(word.substr(word.find('=') + 1));
    std::vector<double> numbers;
    for (double value; values >> value;) numbers.push_back(value);
    if (name.rfind("limits.", 0) == 0 || name.rfind("gains.", 0) == 0) r.set(name, numbers);
  }
  if (mode == "configure") return configure(r), 0;
  if (mode == "silence") r.set("state_timeout", 0.005);
  r.controller.chained = mode == "chained";
  if (!r.configure() || !r.activate()) return 3;
  if (mode == "record") record(r, 400);
  if (mode == "track") track(r);
  if (mode == "allocate") allocate(r);
  if (mode == "restart") restart(r);
  if (mode == "silence") silence(r);
  if (mode == "stop") stop(r);
  if (mode == "not_finite") not_finite(r);
  if (mode == "chained") chained(r);
  return 0;
}
