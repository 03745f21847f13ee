/* SPDX-License-Identifier: Apache-2.0
 * The external torques on the links at a sample (monitoring/external_torque.py), from measured positions. There are none
 * while the velocities of an observer settle, nor for values that no sensor measures, which would keep the thresholds of
 * contact high for seconds.
 * A state whose values all repeat under a new stamp is older than that; it is not used, for as long as a moving robot may
 * send one.
 */
#define MEASURABLE 1e9 /* rad, m, rad/s, m/s */

static int is_measurable(const double* values) {
  for (int i = 0; i < 2 * N; ++i)
    if (!(fabs(values[i]) <= MEASURABLE)) return 0;
  return 1;
}

/* Return 1 if the state repeats the last one, dt [s] later; if not, keep it. */
static int repeats(struct fjr_torque_observer* o, const double* position, const double* velocity, double dt) {
  int same = 0 < dt && dt * 1e9 <= UNCHANGED;
  for (int i = 0; i < 2 * N; ++i) same &= position[i] == o->seen[0][i] && velocity[i] == o->seen[2][i];
  if (same) return 1;
  find_steps(o, position);
  copy(o->seen[1], o->seen[0], 2 * N), copy(o->seen[0], position, 2 * N), copy(o->seen[2], velocity, 2 * N);
  return 0;
}

int fjr_watch_torque(struct fjr_torque_observer* o, struct fjr_contact* c, const double* position,
                     const double* velocity, int64_t stamp) {
  const int size = N * (1 + o->errors);
  const double dt = (double)(stamp - o->stamp) * 1e-9;
  double none[2 * N];
  fill(none, NAN, 2 * N);
  if (!is_measurable(position) || !is_measurable(velocity))
    position = none;
  else if (repeats(o, position, velocity, dt))
    return all_finite(o->kept + 2 * size, N);
  o->arg[0] = o->kept, o->arg[1] = position, o->arg[2] = velocity, o->arg[3] = &o->bandwidth, o->arg[4] = &dt;
  o->res[0] = o->next;
  if (o->update(o->arg, o->res, o->iw, o->w, 0)) fill(o->next, NAN, 3 * size);
  add_integration_error(o, dt);
  copy(o->kept, o->next, 3 * size);
  o->stamp = stamp;
  if (!all_finite(o->kept + 2 * size, N)) return 0;
  watch_contact(o, c, o->kept + 2 * size, stamp);
  return 1;
}

int fjr_observe_torque(struct fjr_torque_observer* o, const struct fjr_model* m, struct fjr_controller* c,
                       const struct fjr_sample* sample, double* torque) {
  double position[2 * N];
  joint_positions(m, sample, position);
  if (m->observer && c->measured.k < OBSERVED) fill(position, NAN, 2 * N);
  const int known = fjr_watch_torque(o, &c->contact, position, c->measured.values + 2 * N, sample->stamp);
  copy(torque, o->kept + 2 * N * (1 + o->errors), N);
  return known;
}
