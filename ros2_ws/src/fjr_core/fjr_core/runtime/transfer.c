/* SPDX-License-Identifier: Apache-2.0
 * Bumpless transfer of the effort with the smoothstep s = 3 r^2 - 2 r^3 of the share r of the duration.
 *
 *   ramp:  u = (1 - s) u_stop + s u_law, with the stop policy's effort u_stop at the beginning
 *   blend: u = u_law + (1 - s) (u_last - u_law(0)), with the last effort sent u_last
 *
 * A blend keeps the full feedback from the first sample on: what it adds is an external input omega of eq. (42).
 */

static void begin_transfer(struct fjr_transfer* t, int64_t stamp, double duration, int ramp) {
  t->active = duration > 0, t->ramp = ramp, t->begun = 0;
  t->start = stamp, t->duration = duration;
}

/* Change the law's effort u in place; return 1 if the transfer acted. */
static int apply_transfer(const struct fjr_model* m, struct fjr_controller* c, double* u, int64_t stamp) {
  struct fjr_transfer* t = &c->supervisor.transfer;
  if (!t->active) return 0;
  const double r = clamp((double)(stamp - t->start) * 1e-9 / t->duration, 0, 1), s = r * r * (3 - 2 * r);
  t->active = s < 1;
  if (!t->active) return 0;
  if (!t->begun && t->ramp) standing_effort(m, c, t->initial);
  for (int i = 0; i < N && !t->begun && !t->ramp; ++i) t->initial[i] = c->limits.sent[i] - u[i];
  t->begun = 1;
  for (int i = 0; i < N; ++i) u[i] = (1 - s) * t->initial[i] + (t->ramp ? s * u[i] : u[i]);
  return 1;
}
