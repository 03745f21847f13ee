/* SPDX-License-Identifier: Apache-2.0
 * The effort of a stop: zero, or gravity compensation with damped motors.
 *
 *   zero: u = 0.   gravity_hold: u = B_m^-1 (grad P_l(q_l) - K_md dq_m) with a sample, B_m^-1 grad P_l(q_l) without.
 *
 * After a wiring fault, where gravity compensation would drive the arm, u = 0 under either policy (`released`).
 */

/* Gravity compensation at q_l, with damped motors; dq_m: 0 for no damping. */
static void carry_effort(const struct fjr_model* m, const struct fjr_controller* c, const double* q_l,
                         const double* dq_m, double* u) {
  double torque[N], damping[N];
  fill(u, 0, N);
  m->arg[0] = q_l, m->res[0] = torque;
  if (m->gravity(m->arg, m->res, m->iw, m->w, 0)) return;
  if (dq_m) {
    multiply(damping, c->settings.hold_damping, dq_m);
    for (int i = 0; i < N; ++i) torque[i] -= damping[i];
  }
  multiply(u, c->settings.B_inverse, torque);
}

/* The effort of a robot that stands still at q_l; dq_m: 0 for no damping. */
static void hold_effort(const struct fjr_model* m, const struct fjr_controller* c, const double* q_l,
                        const double* dq_m, double* u) {
  if (c->settings.gravity_hold && !c->policy.released)
    carry_effort(m, c, q_l, dq_m, u);
  else
    fill(u, 0, N);
}

/* At the last valid link positions, always finite; zero before the first sample. */
static void standing_effort(const struct fjr_model* m, const struct fjr_controller* c, double* u) {
  if (c->policy.known)
    hold_effort(m, c, c->policy.q_l, 0, u);
  else
    fill(u, 0, N);
}

/* At the measured state, always finite. */
static void moving_effort(const struct fjr_model* m, const struct fjr_controller* c, double* u) {
  hold_effort(m, c, c->measured.values, c->measured.values + 3 * N, u);
  if (!all_finite(u, N)) standing_effort(m, c, u);
}

static void remember_position(struct fjr_controller* c) {
  copy(c->policy.q_l, c->measured.values, N);
  c->policy.known = 1;
}
