// Faults of what the controller measures, and what it sends meanwhile.
#pragma once

#include <algorithm>
#include <deque>
#include <map>

#include "robot.hpp"

using Values = std::vector<double>;

// What a fault needs: the interfaces of the controller, their values in past cycles, and the cycle of the fault.
struct Measured
{
  Robot & robot;
  std::deque<Values> past;
  int k = 0;

  Values values() const
  {
    Values found;
    for (const auto & state : robot.controller.state_interfaces_) found.push_back(*state.handle->get_optional());
    return found;
  }

  void set(const Values & values) const
  {
    auto & states = robot.controller.state_interfaces_;
    for (std::size_t i = 0; i < values.size(); ++i) (void)states[i].handle->set_value(values[i]);
  }

  void set(std::size_t i, double value) const { (void)robot.controller.state_interfaces_[i].handle->set_value(value); }
};

// The faults by name; each returns whether the controller is updated in this cycle.
inline const std::map<std::string, bool (*)(Measured &)> FAULTS = {
  {"none", [](Measured &) { return true; }},
  {"not_finite", [](Measured & m) {
     const double bad = m.k % 2 ? NAN : INFINITY;
     m.set(0, bad), m.set(4 * N - 1, -bad);
     return true;
   }},
  {"huge", [](Measured & m) { return m.set(0, 1e200), true; }},
  {"stamp_not_finite", [](Measured & m) { return m.set(4 * N, NAN), true; }},
  {"stamp_out_of_range", [](Measured & m) { return m.set(4 * N, m.k % 2 ? 8e18 : -8e18), true; }},
  {"repeated", [](Measured & m) { return m.set(m.past[m.past.size() - 2 - m.k]), true; }},
  {"older", [](Measured & m) {
     if (m.k % 2) m.set(m.past[m.past.size() - 51]);
     return true;
   }},
  {"jump", [](Measured & m) { return m.set(4 * N, m.values()[4 * N] + 100e9), true; }},
  {"no_update", [](Measured &) { return false; }},
  {"few_updates", [](Measured & m) { return m.k % 10 != 0; }},
};

// Efforts that are not finite or exceed their limit.
inline int bad_efforts(const Robot & r)
{
  const auto & limit = std::any_cast<const Values &>(r.controller.get_node()->parameters.at("limits.effort"));
  int bad = 0;
  for (int i = 0; i < N; ++i) bad += !(std::fabs(r.effort(i)) <= limit[i]);
  return bad;
}

// Track for 3 s, inject a fault for a time, then track until V stays small; the name: FAULT or FAULT:SECONDS.
inline bool inject(Robot & r, const std::string & named)
{
  const std::string name = named.substr(0, named.find(':'));
  const int length = std::lround(std::stod(named.substr(named.find(':') + 1)) * 1e9 / r.period), before = 3000;
  if (!FAULTS.count(name)) return false;
  Measured m{r, {}, 0};
  int bad = 0, calm = 0, recovered = -1;
  double largest = 0;
  for (int k = 0; k < before + length + 8000; ++k) {
    const bool faulty = k >= before && k < before + length;
    r.cycle([&] {
      m.k = k - before;
      m.past.push_back(m.values());
      return faulty ? FAULTS.at(name)(m) : true;
    });
    if (k > 0) bad += bad_efforts(r);
    if (k >= before) largest = std::fmax(largest, std::fabs(r.effort(0)));
    calm = r.exported(0) == FJR_TRACKING && r.exported(3) < 1e-5 ? calm + 1 : 0;
    if (k >= before + length && recovered < 0 && calm > 100) recovered = k - before - length - 100;
    if (k % 10 == 9) tick(r);
  }
  show("bad", bad);
  show("largest", largest);
  show("recovery", recovered < 0 ? INFINITY : recovered * FJR_SAMPLE_PERIOD);
  std::printf("events %s\n", events_of(r).c_str());
  return true;
}
