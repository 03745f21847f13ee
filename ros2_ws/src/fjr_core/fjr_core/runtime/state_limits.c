/* SPDX-License-Identifier: Apache-2.0
 * Limits of the measured state: positions, velocities, deflection and tracking error. A value at its limit is within.
 */

#define TIMING 0.02 /* s; error of the time between two stamps, as where a driver stamps late */
#define LEAST 0.01  /* rad, m; a smaller change of position may be noise */

static void stop(struct fjr_controller* c, int32_t cause, struct fjr_event event) {
  struct fjr_supervisor* s = &c->supervisor;
  s->stopped = cause;
  s->resuming = s->transfer.active = 0;
  s->bound_start = FJR_NEVER;
  if (cause != FJR_STARTS_REFUSED) count(c, cause);
  report_event(c, event);
}

/* Write the deflections, and the tracking errors; q_ld: 0 for none. */
static void complete_values(double* values, const double* q_ld) {
  for (int i = 0; i < N; ++i) {
    values[4 * N + i] = values[N + i] - values[i];
    values[5 * N + i] = q_ld ? values[i] - q_ld[i] : 0;
  }
}

/* Return 1 if a value violates a limit, and write the first as the event of a stop. */
static int violated(const struct fjr_controller* c, const double* values, int64_t stamp, struct fjr_event* found) {
  for (int i = 0; i < 6 * N; ++i) {
    const int below = values[i] < c->settings.lower[i], velocity = i >= 2 * N && i < 4 * N;
    if (!(below || values[i] > c->settings.upper[i]) || (velocity && c->supervisor.settling)) continue;
    const double limit = below ? c->settings.lower[i] : c->settings.upper[i];
    const struct fjr_event event = {FJR_STOPS, FJR_STOPS_LINK_POSITION + i / N, i % N, below, stamp, values[i], limit};
    *found = event;
    return 1;
  }
  return 0;
}

/* Stop at the first violated limit. q_ld: 0 skips the limit of the tracking error. */
static void check_limits(struct fjr_controller* c, const double* q_ld, int64_t stamp) {
  struct fjr_event found;
  complete_values(c->measured.values, q_ld);
  if (violated(c, c->measured.values, stamp, &found)) stop(c, found.detail, found);
}

/* Stop if a link position has changed by more than its velocity limit allows, although its velocity is within: an
 * encoder jumps by a turn, or two robots send their states. elapsed [ns]: since the last sample. */
static void check_change(struct fjr_controller* c, int64_t stamp, int64_t elapsed) {
  const double time = (double)elapsed * 1e-9 + TIMING, *change = c->measured.change;
  for (int i = 0; i < N && !c->supervisor.stopped; ++i) {
    const double lower = fmin(c->settings.lower[2 * N + i] * time, -LEAST);
    const double upper = fmax(c->settings.upper[2 * N + i] * time, LEAST);
    const double expected = c->measured.values[2 * N + i] * time;
    const int below = change[i] < lower;
    if (!(below || change[i] > upper) || expected < lower || expected > upper) continue;
    const struct fjr_event event = {FJR_STOPS, FJR_STOPS_POSITION_JUMP, i, below, stamp, change[i], below ? lower : upper};
    stop(c, FJR_STOPS_POSITION_JUMP, event);
  }
}

/* Return the event of a stop because of a contact. */
static struct fjr_event contact_stop(const struct fjr_contact* t, int64_t stamp) {
  const struct fjr_event event = {FJR_STOPS, FJR_STOPS_CONTACT, t->joint, 0, stamp, fabs(t->value), t->limit};
  return event;
}

int fjr_is_outside(const struct fjr_controller* c, struct fjr_event* found) {
  double values[6 * N];
  copy(values, c->measured.values, 4 * N);
  complete_values(values, 0);
  if (violated(c, values, c->stamps.last, found)) return 1;
  *found = contact_stop(&c->contact, c->stamps.last);
  return c->contact.acting && c->settings.on_contact == FJR_STOP;
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
