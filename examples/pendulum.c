/* SPDX-License-Identifier: Apache-2.0 */
/* The control step in a program of one's own: a pendulum with a stiff joint (docs/real_time.md). */
#include "control_step.c"

#include <stdio.h>

static int law(const double** arg, double** res, long long int* iw, double* w, int mem) {
  const double *position = arg[0], *velocity = arg[1], *jets = arg[2], *gains = arg[3];
  (void)iw, (void)w, (void)mem;
  res[0][0] = sin(position[0]) + jets[2] - gains[0] * (position[0] - jets[0]) - gains[1] * (velocity[0] - jets[1]);
  res[1][0] = NAN; /* no storage */
  return 0;
}

static int gravity(const double** arg, double** res, long long int* iw, double* w, int mem) {
  (void)iw, (void)w, (void)mem;
  res[0][0] = sin(arg[0][0]);
  return 0;
}

int main(void) {
  const double gains[] = {25, 10};
  const double *arg[8];
  double *res[3], w[1];
  long long int iw[1];
  struct fjr_model model = {.law = law, .gravity = gravity, .gear_ratio = {1}, .arg = arg, .res = res, .iw = iw, .w = w};
  struct fjr_settings settings = {.effort = {5}, .effort_rate = {INFINITY}, .start_error = {INFINITY}, .B_inverse = {1}};
  struct fjr_reference hold = {.kind = FJR_HOLD, .position = {0.5}};
  struct fjr_controller controller;
  struct fjr_command command;
  double q = 0, dq = 0;
  for (int i = 0; i < 6; ++i) settings.lower[i] = -INFINITY, settings.upper[i] = INFINITY;
  settings.state_timeout = 500000000;
  fjr_init(&controller, &settings, gains, &hold);
  for (int k = 0; k < 3000; ++k) {
    const struct fjr_sample sample = {k * INT64_C(1000000), {q}, {q}, {dq, dq}};
    if (!fjr_step(&model, &controller, &sample, sample.stamp, &command)) return 1;
    dq += 1e-3 * (command.u[0] - sin(q));
    q += 1e-3 * dq;
  }
  printf("q = %.3f rad, %lld samples saturated\n", q, (long long)controller.journal.count[FJR_EFFORTS_SATURATED]);
  return 0;
}
