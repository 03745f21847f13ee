/* SPDX-License-Identifier: Apache-2.0
 * The effort of a stop: zero, or gravity compensation with damped motors.
 *
 *   zero: u = 0.   gravity_hold: u = B_m^-1 (grad P_l(q_l) - K_md dq_m) with a sample, B_m^-1 grad P_l(q_l) without.
 *
 * After a wiring fault, where gravity compensation would drive the arm, u = 0 under either policy (`released`).
 *
 * Damping by a velocity with a wrong sign or gain would drive the motors. So dq_m of each motor counts by the factor
 *
 *   a = <dq_m slope> / (ENOUGH <dq_m^2>), from 0 to 1        slope: of q_m; < >: mean over the last AGREEMENT
 *
 * by least squares: 0 for a wrong sign, 1 / (ENOUGH g) for a large gain g, 1 for a sensor that is right. With a diagonal
 * K_md the mean power of the damping, -K_md a <dq_m slope>, is never above 0.
 */
#define AGREEMENT 0.02 /* s */
#define ENOUGH 0.8     /* share of the slope in a velocity, beyond which noise, delay and coarse encoders do not count */

/* Keep the motors of an accepted sample, `dt` [s] after the last one, and compare their velocities with the slopes. */
static void compare_velocities(struct fjr_stop_policy* p, const double* q_m, const double* dq_m, double dt) {
  const double stay = exp(-dt / AGREEMENT);
  for (int i = 0; i < N; ++i) {
    const double mean = (dq_m[i] + p->dq_m[i]) / 2, size = stay * p->size[i] + mean * mean * dt;
    const double agreed = stay * p->agreed[i] + mean * (q_m[i] - p->q_m[i]);
    const int counts = 0 < dt && dt <= LONGEST_GAP && isfinite(size + agreed);
    if (counts) p->size[i] = size, p->agreed[i] = agreed;
  }
  copy(p->q_m, q_m, N), copy(p->dq_m, dq_m, N);
}

/* Gravity compensation at q_l, with damped motors; dq_m: 0 for no damping. */
static void carry_effort(const struct fjr_model* m, const struct fjr_controller* c, const double* q_l,
                         const double* dq_m, double* u) {
  const struct fjr_stop_policy* p = &c->policy;
  double torque[N], damping[N], confirmed[N];
  fill(u, 0, N);
  m->arg[0] = q_l, m->res[0] = torque;
  if (m->gravity(m->arg, m->res, m->iw, m->w, 0)) return;
  if (dq_m) {
    for (int i = 0; i < N; ++i)
      confirmed[i] = p->agreed[i] > 0 ? dq_m[i] * fmin(p->agreed[i] / (ENOUGH * p->size[i]), 1) : 0;
    multiply(damping, c->settings.hold_damping, confirmed);
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

/* Keep an accepted sample; dt [s]: since the one that it follows, 0: none. */
static void remember_state(struct fjr_controller* c, double dt) {
  copy(c->policy.q_l, c->measured.values, N);
  c->policy.known = 1;
  compare_velocities(&c->policy, c->measured.values + N, c->measured.values + 3 * N, dt);
}
