/* SPDX-License-Identifier: Apache-2.0 */
#include <math.h>
#include <string.h>

static int any(const double* values, int32_t count) {
  for (int32_t i = 0; i < count; ++i)
    if (values[i] != 0.0) return 1;
  return 0;
}

static int all_finite(const double* values, int32_t count) {
  for (int32_t i = 0; i < count; ++i)
    if (!isfinite(values[i])) return 0;
  return 1;
}

/* One inner step; it leaves the state unchanged if it fails. */
static int inner_step(struct fjr_robot* r, int ideal) {
  r->arg[0] = r->state, r->arg[1] = r->u, r->res[0] = r->next;
  if (ideal) {
    r->arg[2] = &r->dt;
  } else {
    r->arg[2] = r->external, r->arg[3] = r->parameters, r->arg[4] = &r->dt;
  }
  if ((ideal ? r->step : r->nonideal_step)(r->arg, r->res, r->iw, r->w, 0)) return FJR_STEP_FAILED;
  memcpy(r->state, r->next, (size_t)(ideal ? 4 : 6) * (size_t)r->n * sizeof(double));
  return FJR_NO_FAULT;
}

int fjr_robot_advance(struct fjr_robot* r, int64_t time) {
  const int64_t steps = time > r->time ? (time - r->time) / r->inner_step : 0;
  const int ideal = r->perfect && !any(r->external, r->n);
  if (r->perfect) memcpy(r->state + 4 * r->n, r->u, (size_t)r->n * sizeof(double));
  if (r->engine && steps && r->engine_advance(r->engine, r, steps)) return FJR_STEP_FAILED;
  for (int64_t k = 0; !r->engine && k < steps; ++k)
    if (inner_step(r, ideal)) return FJR_STEP_FAILED;
  r->time += steps * r->inner_step;
  return all_finite(r->state, 4 * r->n) ? FJR_NO_FAULT : FJR_DIVERGED;
}

int fjr_robot_measure(struct fjr_robot* r) {
  double *position = r->measured, *velocity = position + 2 * r->n, *torque = velocity + 2 * r->n;
  r->arg[0] = r->state, r->arg[1] = r->u, r->arg[2] = r->parameters;
  r->res[0] = position, r->res[1] = velocity, r->res[2] = torque;
  if ((r->perfect ? r->outputs : r->nonideal_outputs)(r->arg, r->res, r->iw, r->w, 0)) return FJR_STEP_FAILED;
  if (!r->sensors->perfect) fjr_sensors_disturb(r->sensors, r->n, r->time, position, velocity);
  return FJR_NO_FAULT;
}

void fjr_sensors_disturb(struct fjr_sensors* s, int32_t n, int64_t instant, double* position, double* velocity) {
  if (instant != s->instant) {
    s->instant = instant;
    s->normal(s->random, 4 * n, s->draw);
  }
  for (int32_t i = 0; i < 2 * n; ++i) {
    position[i] += s->deviation[i] * s->draw[i];
    if (s->step[i] != 0.0) position[i] = rint(position[i] / s->step[i]) * s->step[i];
    velocity[i] += s->deviation[2 * n + i] * s->draw[2 * n + i];
  }
}
