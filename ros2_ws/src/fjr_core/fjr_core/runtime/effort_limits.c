/* SPDX-License-Identifier: Apache-2.0
 * Limits of the effort and of its rate, with the time spent in saturation.
 */

static void saturate(const struct fjr_settings* s, double* u) {
  for (int i = 0; i < N; ++i) u[i] = clamp(u[i], -s->effort[i], s->effort[i]);
}

/* Return 1 if a joint has a finite limit. */
static int has_limit(const double* limit) {
  for (int i = 0; i < N; ++i)
    if (limit[i] < (double)INFINITY) return 1;
  return 0;
}

static void keep_effort(struct fjr_effort_limits* l, const double* u) {
  copy(l->sent, u, N);
  copy(l->left, u, N);
}

/* Time since the last effort [s], at most state_timeout. */
static double since_last(const struct fjr_controller* c, int64_t stamp) {
  if (c->limits.stamp == FJR_NEVER || stamp < c->limits.stamp) return 0;
  const int64_t dt = stamp - c->limits.stamp;
  return (double)(dt < c->stamps.timeout ? dt : c->stamps.timeout) * 1e-9;
}

/* Count saturated samples by joint and samples at the rate limit; report the beginning of a saturation. */
static void report_limits(struct fjr_controller* c, int64_t stamp) {
  struct fjr_effort_limits* l = &c->limits;
  int32_t first = NONE, joints = 0;
  if (l->slowed) count(c, FJR_EFFORTS_RATE_LIMITED);
  if (!l->clipped) {
    c->journal.saturation = 0;
    return;
  }
  for (int i = N - 1; i >= 0; --i)
    if (l->saturated[i]) ++c->journal.saturated[i], first = i, joints |= (int32_t)(1u << (i % 31));
  const struct fjr_event event = {FJR_EFFORTS_SATURATED, joints, first, 0, stamp, NAN, NAN};
  report_episode(c, &c->journal.saturation, event);
}

/* Limit the finite effort u of the sample in place; return 1 if a limit acted. The first effort starts from zero. */
static int limit_effort(struct fjr_controller* c, double* u, int64_t stamp) {
  struct fjr_effort_limits* l = &c->limits;
  const struct fjr_settings* s = &c->settings;
  const double dt = since_last(c, stamp);
  if (l->clipped) {
    for (int i = 0; i < N; ++i) l->seconds[i] += l->saturated[i] ? dt : 0;
    l->seconds_any += dt;
  }
  l->clipped = l->slowed = 0;
  for (int i = 0; i < N; ++i) {
    l->saturated[i] = fabs(u[i]) > s->effort[i];
    l->clipped |= l->saturated[i];
  }
  if (l->clipped) saturate(s, u);
  for (int i = 0; i < N; ++i) {
    const double rate = s->effort_rate[i], step = rate < (double)INFINITY ? rate * dt : (double)INFINITY;
    if (!(fabs(u[i] - l->sent[i]) > step)) continue;
    l->slowed = 1;
    u[i] = clamp(u[i], l->sent[i] - step, l->sent[i] + step);
  }
  l->stamp = stamp;
  keep_effort(l, u);
  report_limits(c, stamp);
  return l->clipped || l->slowed;
}
