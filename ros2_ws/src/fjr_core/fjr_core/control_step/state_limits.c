/* SPDX-License-Identifier: Apache-2.0
 * Limits of the measured state: positions, velocities, deflection and tracking error. A value at its limit is within.
 */

static void stop(struct fjr_controller* c, int32_t cause, struct fjr_event event) {
  struct fjr_supervisor* s = &c->supervisor;
  s->stopped = cause;
  s->transfer.active = 0;
  s->bound_start = FJR_NEVER;
  if (cause != FJR_STARTS_REFUSED) count(c, cause);
  report_event(c, event);
}

/* Stop at the first violated limit. q_ld: 0 skips the limit of the tracking error. */
static void check_limits(struct fjr_controller* c, const double* q_ld, int64_t stamp) {
  double* values = c->measured.values;
  for (int i = 0; i < N; ++i) {
    values[4 * N + i] = values[N + i] - values[i];
    values[5 * N + i] = q_ld ? values[i] - q_ld[i] : 0;
  }
  for (int i = 0; i < 6 * N; ++i) {
    const int below = values[i] < c->settings.lower[i], velocity = i >= 2 * N && i < 4 * N;
    if (!(below || values[i] > c->settings.upper[i]) || (velocity && c->supervisor.settling)) continue;
    const int32_t cause = FJR_STOPS_LINK_POSITION + i / N;
    const double limit = below ? c->settings.lower[i] : c->settings.upper[i];
    const struct fjr_event event = {FJR_STOPS, cause, i % N, below, stamp, values[i], limit};
    stop(c, cause, event);
    return;
  }
}

/* Refuse the start if |q_l - q_ld| exceeds its limit at a joint. */
static void check_start(struct fjr_controller* c, const double* q_ld, int64_t stamp) {
  for (int i = 0; i < N; ++i) {
    const double error = fabs(c->measured.values[i] - q_ld[i]), limit = c->settings.start_error[i];
    if (!(error > limit)) continue;
    const struct fjr_event event = {FJR_STARTS_REFUSED, NONE, i, 0, stamp, error, limit};
    stop(c, FJR_STARTS_REFUSED, event);
    return;
  }
}
