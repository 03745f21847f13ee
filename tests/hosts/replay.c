/* SPDX-License-Identifier: Apache-2.0
 * Host of an exported controller: give it recorded inputs, write each effort that it sends.
 */
#include "fjr.h"
#include "input.h"

static struct fjr_work work;
static struct fjr_model model;
static struct fjr_controller controller;
static struct {
  struct fjr_settings settings;
  double gains[FJR_GAINS > 0 ? FJR_GAINS : 1], hold_damping[FJR_N * FJR_N];
} changed;

static void restart(int simulated) {
  fjr_scenario_model(&model, &work);
  model.simulated = simulated;
  fjr_init(&controller, &fjr_scenario_settings, fjr_scenario_gains, fjr_scenario_reference);
}

static void check_silence(int64_t now) {
  double u[FJR_N];
  if (fjr_silence(&model, &controller, now, u)) put(u);
}

static void take(struct input input, int simulated) {
  struct fjr_command command;
  switch (input.kind) {
    case STATE:
      if (simulated) check_silence(input.sample.stamp);
      if (fjr_step(&model, &controller, &input.sample, input.time, &command)) put(command.u);
      break;
    case TICK: check_silence(input.time); break;
    case HOLD: fjr_hold(&controller); break;
    case RESUME: fjr_resume(&controller); break;
    case CHANGE:
      fjr_use_gains(&controller, changed.gains, changed.hold_damping);
      fjr_apply(&controller, &changed.settings);
      break;
    case RESTART: restart(simulated); break;
    default: break;
  }
}

int main(int count, char** argument) {
  if (count != 6) return 2;
  const struct inputs all = read_inputs(argument);
  FILE* file = fopen(argument[5], "rb");
  if (!file || fread(&changed, sizeof changed, 1, file) != 1) return 2;
  fclose(file);
  restart(all.simulated);
  for (int64_t k = 0; k < all.rounds; ++k)
    for (size_t i = 0; i < all.count; ++i) {
      struct input input = all.input[i];
      input.time += k * all.shift, input.sample.stamp += k * all.shift;
      take(input, all.simulated);
    }
  free(all.input);
  return 0;
}
