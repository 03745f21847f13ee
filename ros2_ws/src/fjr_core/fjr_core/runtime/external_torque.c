/* SPDX-License-Identifier: Apache-2.0
 * The external torques on the links at a sample (monitoring/external_torque.py), from measured positions. There are none
 * while the velocities of an observer settle.
 */

int fjr_observe_torque(struct fjr_torque_observer* o, const struct fjr_model* m, const struct fjr_controller* c,
                       const struct fjr_sample* sample, double* torque) {
  const double dt = (double)(sample->stamp - o->stamp) * 1e-9;
  double position[2 * N], next[3 * N];
  joint_positions(m, sample, position);
  if (m->observer && c->measured.k < OBSERVED) fill(position, NAN, 2 * N);
  o->arg[0] = o->kept, o->arg[1] = position, o->arg[2] = c->measured.values + 2 * N;
  o->arg[3] = &o->bandwidth, o->arg[4] = &dt, o->res[0] = next;
  if (o->update(o->arg, o->res, o->iw, o->w, 0)) fill(next, NAN, 3 * N);
  copy(o->kept, next, 3 * N);
  copy(torque, next + 2 * N, N);
  o->stamp = sample->stamp;
  return all_finite(next, 3 * N);
}
