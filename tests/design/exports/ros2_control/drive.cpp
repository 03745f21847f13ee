// Run the exported controller on the exported arm; print numbers by name.
//   drive MODE [parameter=numbers ..]   parameters of the controller, or of the tag of the arm
#include <cstdlib>
#include <new>
#include <sstream>

#include "faults.hpp"
#include "robot.hpp"

static long allocations = 0;
[[gnu::noinline]] void * operator new(std::size_t size) { return ++allocations, std::malloc(size); }
[[gnu::noinline]] void operator delete(void * memory) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void * memory, std::size_t) noexcept { std::free(memory); }

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

// Call a service; print whether it succeeded, and its message.
static void call(Robot & r, const std::string & name)
{
  using std_srvs::srv::Trigger;
  const auto response = std::make_shared<Trigger::Response>();
  const auto & service = r.controller.get_node()->services.at("~/" + name);
  static_cast<rclcpp::Service<Trigger> *>(service.get())->callback(std::make_shared<Trigger::Request>(), response);
  std::printf("%s %d: %s\n", name.c_str(), response->success, response->message.c_str());
}

// Largest speed of the links over the next half second of samples.
static double moving(Robot & r)
{
  double largest = 0;
  for (int k = 0; k < 500; ++k) {
    r.cycle();
    for (int i = 0; i < N; ++i) largest = std::fmax(largest, std::fabs(r.speed(i)));
  }
  return largest;
}

// Hold, play; resume after a stop.
static void request(Robot & r)
{
  call(r, "resume");
  for (int k = 0; k < 3000; ++k) r.cycle();
  call(r, "hold");
  for (int k = 0; k < 2000; ++k) r.cycle();
  show("speed_held", moving(r));
  call(r, "play");
  for (int k = 0; k < 3000; ++k) r.cycle();
  show("speed_playing", moving(r));
  show("state_playing", r.exported(0));
  const auto & velocity = r.arm.states.at(std::string(fjr_joint_names[0]) + "/velocity");
  r.cycle([&] { return velocity->set_value(1e3); });
  show("state_stopped", r.exported(0));
  call(r, "resume");
  r.cycle();
  call(r, "resume");
  for (int k = 0; k < 3000; ++k) r.cycle();
  show("state_resumed", r.exported(0));
  r.controller.on_deactivate(STATE);
  call(r, "hold");
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
  call(r, "hold");
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

// Set a parameter of the controller; return false for one of the arm.
static bool set(Robot & r, const std::string & name, const std::string & text)
{
  const auto begins = [&name](const char * group) { return name.rfind(group, 0) == 0; };
  std::istringstream words(text);
  std::vector<double> numbers;
  for (double value; words >> value;) numbers.push_back(value);
  if (begins("limits.") || begins("gains."))
    r.set(name, numbers);
  else if (begins("start.") || begins("recovery.") || begins("state_timeout"))
    r.set(name, numbers.at(0));
  else
    return false;
  return true;
}

int main(int argc, char ** argv)
{
  const std::string mode = argv[1];
  Robot r;
  std::unordered_map<std::string, std::string> given{{"time", "cycles"}};
  std::string fault;
  for (int i = 2; i < argc; ++i) {
    const std::string word = argv[i], name = word.substr(0, word.find('=')), value = word.substr(word.find('=') + 1);
    if (name == "fault")
      fault = value;
    else if (!set(r, name, value))
      given[name] = value;
  }
  if (!r.init(given)) return 2;
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
  if (mode == "request") request(r);
  if (mode == "not_finite") not_finite(r);
  if (mode == "chained") chained(r);
  if (mode == "fault") return inject(r, fault) ? 0 : 2;
  return 0;
}
