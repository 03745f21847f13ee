/* SPDX-License-Identifier: Apache-2.0
 * The reference that is tracked, on the time line of the stamps: its clock, requests, transitions and standstill.
 */

#define SHORTEST 0.2 /* s; duration of braking */
#define LONGEST 2.0
#define MATCHED 1e-6 /* difference of two jets, relative to 1 + the largest entry of the same derivative */

/* Duration of a transition: the first of a geometric series that respects the limits at INSTANTS + 1 instants. */
#define GROWTH 1.25
#define LONGEST_TRANSITION 20.0 /* s; then the duration with the least excess */
#define INSTANTS 20
#define MORE 1.5
#define EXCURSION 0.25     /* of a transition whose only difference is the velocity, relative to difference and duration */
#define VELOCITY_SHARE 0.8 /* of a velocity limit that a transition uses: the arm oscillates about its reference */

enum { NO_TRANSITION, DIRECT, ADDED }; /* ADDED: `segment` is added to the target */

static const struct fjr_reference* target(const struct fjr_active* a) { return a->target ? a->target : &a->held; }

/* Jets (FJR_JETS, N) at the stamp; at time 0 before the reference begins. */
static void active_jets(const struct fjr_active* a, int64_t stamp, double* jets) {
  const double t = a->zero == FJR_NEVER ? 0 : (double)(stamp - a->zero) * 1e-9;
  const int joins = t < a->segment.t1 ? a->joins : NO_TRANSITION;
  double added[FJR_JETS * N];
  if (joins == DIRECT) {
    segment_jets(&a->segment, t, jets);
    return;
  }
  fjr_reference_jets(target(a), t, jets);
  if (joins == NO_TRANSITION) return;
  segment_jets(&a->segment, t, added);
  for (int k = 0; k < FJR_JETS * N; ++k) jets[k] += added[k];
}

static int is_due(const struct fjr_active* a, int64_t stamp) {
  return a->pending && (a->pending_start == FJR_NEVER || stamp >= a->pending_start);
}

static void take_reference(struct fjr_active* a, const struct fjr_reference* reference, int64_t start) {
  a->target = reference, a->pending = 0, a->joins = NO_TRANSITION;
  a->zero = a->transition_end = start;
}

/* Set time 0 to this stamp; discard a requested reference whose start is on another time line. */
static void begin_reference(struct fjr_active* a, int64_t stamp) {
  const int counts = a->pending && (a->zero == FJR_NEVER || a->pending_start == FJR_NEVER);
  take_reference(a, counts ? a->pending : a->target, stamp);
}

/* Lead from jets0 to the target over a duration > 0 [s]; return 0 if that is not finite.
 *
 * DIRECT: one polynomial of degree 9 from jets0 to the target's jets at the end. ADDED: the target plus one from the
 * difference of jets0 to 0, which changes the least where the difference is small; its higher derivatives begin at
 * those of the target unless `exact`. */
static int lead(struct fjr_active* a, const double* jets0, int exact, int64_t stamp, double duration, int form) {
  const double t0 = (double)(stamp - a->zero) * 1e-9, t1 = t0 + duration;
  double from[FJR_JETS * N], to[FJR_JETS * N];
  copy(from, jets0, FJR_JETS * N);
  fjr_reference_jets(target(a), form == ADDED ? t0 : t1, to);
  if (form == ADDED) {
    for (int k = 0; k < FJR_JETS * N; ++k) from[k] = exact || k < 2 * N ? jets0[k] - to[k] : 0;
    fill(to, 0, FJR_JETS * N);
  }
  if (!make_segment(&a->segment, from, to, t0, t1)) return 0;
  a->joins = form;
  a->transition_end = stamp + (int64_t)rint(duration * 1e9);
  return 1;
}

/* Return how far the transition from jets0 exceeds the limits, relative to them or in rad; at most 1: it respects them.
 *
 * Velocities: VELOCITY_SHARE of the limits of link and motor. Accelerations: settings.acceleration, or without one
 * hold_deceleration and MORE times those of the target meanwhile. Positions: the limits of link and motor, and those
 * between target and start, by EXCURSION of the way that the difference of the velocities makes in `least` further.
 * What the target does meanwhile, and the arm at the start, is within the limits. */
static double excess(const struct fjr_active* a, const struct fjr_settings* s, const double* jets0, double least) {
  double most[2 * N], low[N], high[N], jets[FJR_JETS * N], goal[INSTANTS + 1][3 * N], worst = 0;
  const double t0 = a->segment.t0, step = (a->segment.t1 - t0) / INSTANTS;
  copy(low, jets0, N), copy(high, jets0, N), copy(most, jets0 + N, 2 * N);
  for (int k = 0; k <= INSTANTS; ++k) {
    fjr_reference_jets(target(a), t0 + k * step, jets);
    copy(goal[k], jets, 3 * N);
    for (int i = 0; i < 2 * N; ++i) most[i] = fmax(fabs(most[i]), fabs(jets[N + i]));
    for (int i = 0; i < N; ++i) low[i] = fmin(low[i], jets[i]), high[i] = fmax(high[i], jets[i]);
  }
  for (int i = 0; i < N; ++i) {
    const int limited = s->acceleration[i] < (double)INFINITY;
    const double more = EXCURSION * least * fabs(jets0[N + i] - goal[0][N + i]);
    most[i] = fmax(most[i], VELOCITY_SHARE * fmin(s->upper[2 * N + i], s->upper[3 * N + i]));
    most[N + i] = fmax(limited ? most[N + i] : MORE * most[N + i], limited ? s->acceleration[i] : s->hold_deceleration);
    low[i] = fmin(low[i], fmax(low[i] - more, fmax(s->lower[i], s->lower[N + i])));
    high[i] = fmax(high[i], fmin(high[i] + more, fmin(s->upper[i], s->upper[N + i])));
  }
  for (int k = 0; k <= INSTANTS; ++k) {
    segment_jets(&a->segment, t0 + k * step, jets);
    for (int i = 0; i < 3 * N && a->joins == ADDED; ++i) jets[i] += goal[k][i];
    for (int i = 0; i < 2 * N; ++i) worst = fmax(worst, fabs(jets[N + i]) / most[i]);
    for (int i = 0; i < N; ++i) worst = fmax(worst, 1 + fmax(0, fmax(jets[i] - high[i], low[i] - jets[i])));
  }
  return worst;
}

/* Begin the shortest transition from jets0 to the target that respects the limits, of at least `least` > 0 [s].
 * Return its duration [s], 0 if there is none. */
static double begin_transition(struct fjr_active* a, const struct fjr_settings* s, const double* jets0, int exact,
                               int64_t stamp, double least) {
  double best = 0, smallest = (double)INFINITY;
  int form = ADDED;
  for (double duration = least; duration <= fmax(least, LONGEST_TRANSITION); duration *= GROWTH)
    for (int each = ADDED; each >= DIRECT; --each) {
      const double found = lead(a, jets0, exact, stamp, duration, each) ? excess(a, s, jets0, least) : (double)INFINITY;
      if (found <= 1) return duration;
      if (found < smallest) smallest = found, best = duration, form = each;
    }
  return best > 0 && lead(a, jets0, exact, stamp, best, form) ? best : 0;
}

/* Jets at q with velocity dq and zero higher derivatives. */
static void standing_jets(double* jets, const double* q, const double* dq) {
  fill(jets, 0, FJR_JETS * N);
  copy(jets, q, N);
  if (dq) copy(jets + N, dq, N);
}

static void stand(struct fjr_active* a, const double* q, int64_t stamp) {
  memset(&a->held, 0, sizeof a->held);
  a->held.kind = FJR_HOLD;
  copy(a->held.position, q, N);
  take_reference(a, 0, stamp);
}

/* Bring each joint to standstill over dq T / 2, T = max |dq| / deceleration; return 0 if there is no transition. */
static int brake(struct fjr_active* a, int64_t stamp, double deceleration) {
  double jets[FJR_JETS * N], q[N], speed = 0;
  active_jets(a, stamp, jets);
  for (int i = 0; i < N; ++i) speed = fmax(speed, fabs(jets[N + i]));
  const double duration = clamp(speed / deceleration, SHORTEST, LONGEST);
  for (int i = 0; i < N; ++i) q[i] = jets[i] + jets[N + i] * (duration / 2);
  stand(a, q, stamp);
  return lead(a, jets, 1, stamp, duration, DIRECT);
}

static int match(const double* jets, const double* others) {
  for (int order = 0; order < FJR_JETS; ++order) {
    double scale = 1;
    for (int i = 0; i < N; ++i) scale = fmax(scale, 1 + fabs(jets[order * N + i]));
    for (int i = 0; i < N; ++i)
      if (!(fabs(jets[order * N + i] - others[order * N + i]) <= MATCHED * scale)) return 0;
  }
  return 1;
}

/* Begin a requested reference at its start, with a transition unless its jets match; return 0 if there is none. */
static int advance_reference(struct fjr_active* a, const struct fjr_settings* s, int64_t stamp, double join_time) {
  double jets0[FJR_JETS * N], here[FJR_JETS * N], there[FJR_JETS * N];
  if (!is_due(a, stamp)) return 1;
  const struct fjr_reference* reference = a->pending;
  const int64_t start = a->pending_start == FJR_NEVER ? stamp : a->pending_start;
  active_jets(a, start, here);
  fjr_reference_jets(reference, 0, there);
  active_jets(a, stamp, jets0);
  take_reference(a, reference, start);
  return join_time == 0 || match(here, there) || begin_transition(a, s, jets0, 1, stamp, join_time) > 0;
}
