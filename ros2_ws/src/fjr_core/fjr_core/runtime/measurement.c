/* SPDX-License-Identifier: Apache-2.0
 * The measured state: the sample in joint coordinates, or through the velocity observer.
 *
 * The observer and its gains are described in velocity_observer.py.
 */

#define LONGEST_CALL 1.5e-3 /* s; longer intervals are predicted in several calls */
#define OBSERVED 5          /* samples after an observer reset before its velocities are used */
#define UNSEEN 0.01         /* rad, m; a motion by the measured velocity that a position has to show, ... */
#define UNCHANGED 20000000  /* ns; ... after this time and two intervals: slow encoders repeat their values */
#define COUNTED 0.5         /* s; ... within this time: at rest a velocity may have a small offset */

static void forget_observer(struct fjr_controller* c) { c->measured.stamp = FJR_NEVER; }

static void restart_observer(struct fjr_measured* s, const double* position) {
  copy(s->x_hat, position, 2 * N);
  fill(s->x_hat + 2 * N, 0, 2 * N);
  s->k = 0;
}

/* Evaluate the observer over dt with the gains g and h / dt. */
static void advance_observer(const struct fjr_model* m, struct fjr_measured* s, const double* y, const double* u,
                             double dt, double g, double h) {
  double next[4 * N];
  const double gain[2] = {g, h};
  m->arg[0] = s->x_hat, m->arg[1] = y, m->arg[2] = u, m->arg[3] = &dt, m->arg[4] = gain, m->res[0] = next;
  if (m->observer(m->arg, m->res, m->iw, m->w, 0)) fill(next, NAN, 4 * N);
  copy(s->x_hat, next, 4 * N);
}

/* Predict over dt and correct by the positions y; u: the effort held since. */
static void continue_observer(const struct fjr_model* m, struct fjr_measured* s, const double* y, const double* u,
                              double dt) {
  const int calls = (int)ceil(dt / LONGEST_CALL), k = ++s->k;
  const double z = exp(-m->bandwidth * dt), first_h = 6.0 / ((k + 1.0) * (k + 2.0));
  double g = 1 - z * z, h = (1 - z) * (1 - z);
  if (first_h > h) g = 2 * (2 * k + 1.0) / ((k + 1.0) * (k + 2.0)), h = first_h; /* a line through all samples so far */
  for (int i = 1; i < calls; ++i) advance_observer(m, s, y, u, dt / calls, 0, 0);
  advance_observer(m, s, y, u, dt / calls, g, h / dt);
  if (!all_finite(s->x_hat, 4 * N)) restart_observer(s, y);
}

static void observe(const struct fjr_model* m, struct fjr_measured* s, const double* y, const double* u,
                    int64_t stamp) {
  const double dt = s->stamp == FJR_NEVER ? (double)INFINITY : (double)(stamp - s->stamp) * 1e-9;
  if (stamp == s->stamp) return;
  s->stamp = stamp;
  if (0 < dt && dt <= LONGEST_GAP)
    continue_observer(m, s, y, u, dt);
  else
    restart_observer(s, y);
}

/* Positions of links and motors from those, or the joint torques, of the sample. */
static void joint_positions(const struct fjr_model* m, const struct fjr_sample* sample, double* position) {
  double deflection[N];
  copy(position, sample->link, N);
  if (m->torque) multiply(deflection, m->compliance, sample->motor);
  for (int i = 0; i < N; ++i)
    position[N + i] = m->torque ? position[i] + deflection[i] : sample->motor[i] / m->gear_ratio[i];
}

/* Return as bits the joints whose values have repeated under new stamps for a while in which the velocity has moved the
 * link: their source is dead. */
static int32_t frozen_joints(const struct fjr_model* m, struct fjr_controller* c, const struct fjr_sample* sample) {
  const struct fjr_sample* last = &c->seen;
  const double *dq = sample->velocity, *dq_last = last->velocity;
  const int64_t interval = c->stamps.interval;
  int32_t found = 0;
  for (int i = 0; i < N; ++i) {
    const int stands = sample->link[i] == last->link[i] && sample->motor[i] == last->motor[i];
    const int same = stands && (m->observer || (dq[i] == dq_last[i] && dq[N + i] == dq_last[N + i]));
    const int64_t elapsed = sample->stamp - c->changed[i];
    const double moved = m->observer ? 0 : fabs(dq[i]) * fmin((double)elapsed * 1e-9, COUNTED);
    if (!same || elapsed < 0)
      c->changed[i] = sample->stamp;
    else if (interval && elapsed > UNCHANGED + 2 * interval && moved > UNSEEN)
      found |= 1 << i % 31;
  }
  c->seen = *sample;
  return found;
}

/* Write the measured state; return 1 if it is finite. How large it may be is a matter of the limits (state_limits.c). */
static int measure(const struct fjr_model* m, struct fjr_controller* c, const struct fjr_sample* sample,
                   enum fjr_order order) {
  struct fjr_measured* s = &c->measured;
  double position[2 * N];
  joint_positions(m, sample, position);
  if (!m->observer) {
    copy(s->values, position, 2 * N);
    copy(s->values + 2 * N, sample->velocity, N);
    for (int i = 0; i < N; ++i) s->values[3 * N + i] = sample->velocity[N + i] / m->gear_ratio[i];
  } else if (order != FJR_REPEATED) {
    if (order != FJR_NEXT) forget_observer(c);
    observe(m, s, position, c->limits.left, sample->stamp);
    copy(s->values, s->x_hat, 4 * N);
  }
  int finite = 1;
  for (int i = 0; i < 4 * N; ++i) finite &= isfinite(s->values[i]) != 0;
  for (int i = 0; i < N && finite; ++i) s->change[i] = position[i] - s->link[i], s->link[i] = position[i];
  return finite;
}

/* Return how many further samples the velocities need before they are used. */
static int settling_after(const struct fjr_model* m, const struct fjr_controller* c, enum fjr_order order) {
  return m->observer && order != FJR_REPEATED && c->measured.k == 0 ? OBSERVED : 0;
}
