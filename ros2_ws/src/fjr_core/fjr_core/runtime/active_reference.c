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
#define LEFT 100           /* excess of a transition that leaves a position limit */

/* Braking before a transition. */
#define QUICKEST 0.05  /* s; the effort is blended meanwhile */
#define ROOM_SHARE 0.8 /* of the way to a position limit: the arm oscillates about its reference */
#define PEAK 2.109375  /* largest deceleration of brake_jets, relative to speed / duration */

enum { NO_TRANSITION, DIRECT, ADDED }; /* ADDED: `segment` is added to the target */

/* The best transition of a search, and how far it exceeds the limits; see excess. */
struct plan {
  double duration, excess; /* s, 0: none */
  int form;
};

static const struct fjr_reference* target(const struct fjr_active* a) { return a->target ? a->target : &a->held; }

/* Jets of the brake at t: q = q0 + dq0 T (1 - r^5 (3 - 2 r)) / 3, with the share r = 1 - (t - t0) / T of the time left.
 *
 * The velocity dq0 r^4 (5 - 4 r) falls over the way dq0 T / 3, and four derivatives end at zero. The acceleration begins
 * at zero; its largest, PEAK dq0 / T, is 1.41 times that of a constant deceleration over the same way. */
static void brake_jets(const struct fjr_brake* b, double t, double* jets) {
  for (int i = 0; i < N; ++i) {
    const double T = b->duration[i], dq = b->speed[i], r = clamp(1 - (t - b->t0) / T, 0, 1);
    jets[i] = b->position[i] + dq * T * (1 - r * r * r * r * r * (3 - 2 * r)) / 3;
    jets[N + i] = dq * r * r * r * r * (5 - 4 * r);
    jets[2 * N + i] = -20 * dq / T * r * r * r * (1 - r);
    jets[3 * N + i] = -20 * dq / (T * T) * r * r * (4 * r - 3);
    jets[4 * N + i] = 120 * dq / (T * T * T) * r * (2 * r - 1);
  }
}

/* Jets (FJR_JETS, N) at the stamp; at time 0 before the reference begins. */
static void active_jets(const struct fjr_active* a, int64_t stamp, double* jets) {
  const double t = a->zero == FJR_NEVER ? 0 : (double)(stamp - a->zero) * 1e-9;
  const int joins = t < a->segment.t1 ? a->joins : NO_TRANSITION;
  double added[FJR_JETS * N];
  if (t < a->brake.t1) {
    brake_jets(&a->brake, t, jets);
    return;
  }
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

static void forget_brake(struct fjr_active* a) { a->brake.t1 = -(double)INFINITY; }

static void take_reference(struct fjr_active* a, const struct fjr_reference* reference, int64_t start) {
  forget_brake(a);
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

static double lowest_position(const struct fjr_settings* s, int i) { return fmax(s->lower[i], s->lower[N + i]); }

static double highest_position(const struct fjr_settings* s, int i) { return fmin(s->upper[i], s->upper[N + i]); }

/* Return how far q is outside an interval. */
static double beyond(double q, double low, double high) { return fmax(0, fmax(q - high, low - q)); }

/* Return the position at which a joint turns between two instants a time h apart, by a cubic through both positions and
 * velocities; q1 if it does not turn. */
static double turning_point(double q0, double dq0, double q1, double dq1, double h) {
  if (!(dq0 * dq1 < 0)) return q1;
  const double c2 = 3 * (q1 - q0) / h - 2 * dq0 - dq1, c3 = dq0 + dq1 - 2 * (q1 - q0) / h;
  const double root = sqrt(fmax(0, c2 * c2 - 3 * c3 * dq0)), s = dq0 / (dq0 > 0 ? root - c2 : -root - c2);
  return q0 + h * s * (dq0 + s * (c2 + s * c3));
}

/* Return how far the transition from jets0 exceeds the limits, relative to them or in rad; at most 1: it respects them.
 *
 * Velocities: VELOCITY_SHARE of the limits of link and motor. Accelerations: settings.acceleration, or without one
 * hold_deceleration and MORE times those of the target meanwhile. Positions: the limits of link and motor, also between
 * the instants, and those between target and start, by EXCURSION of the way that the difference of the velocities makes
 * in `least` further. What the target does meanwhile, and the arm at the start, is within the limits. A transition that
 * leaves the limits of the positions exceeds more than LEFT, as it ends in a stop. */
static double excess(const struct fjr_active* a, const struct fjr_settings* s, const double* jets0, double least) {
  double most[2 * N], low[N], high[N], lowest[N], highest[N], jets[FJR_JETS * N], last[2 * N];
  double goal[INSTANTS + 1][3 * N], worst = 0, left = 0;
  const double t0 = a->segment.t0, step = (a->segment.t1 - t0) / INSTANTS;
  copy(low, jets0, N), copy(high, jets0, N), copy(most, jets0 + N, 2 * N), copy(last, jets0, 2 * N);
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
    lowest[i] = fmin(low[i], lowest_position(s, i)), highest[i] = fmax(high[i], highest_position(s, i));
    low[i] = fmax(low[i] - more, lowest[i]), high[i] = fmin(high[i] + more, highest[i]);
  }
  for (int k = 0; k <= INSTANTS; ++k) {
    segment_jets(&a->segment, t0 + k * step, jets);
    for (int i = 0; i < 3 * N && a->joins == ADDED; ++i) jets[i] += goal[k][i];
    for (int i = 0; i < 2 * N; ++i) worst = fmax(worst, fabs(jets[N + i]) / most[i]);
    for (int i = 0; i < N; ++i) {
      const double turn = turning_point(last[i], last[N + i], jets[i], jets[N + i], step);
      worst = fmax(worst, 1 + beyond(jets[i], low[i], high[i]));
      left = fmax(left, beyond(turn, lowest[i], highest[i]));
    }
    copy(last, jets, 2 * N);
  }
  return left > 0 ? LEFT + left : worst;
}

/* Return the shortest transition from jets0 to the target that respects the limits, of at least `least` > 0 [s]; if none
 * does, that with the least excess. */
static struct plan shortest(struct fjr_active* a, const struct fjr_settings* s, const double* jets0, int exact,
                            int64_t stamp, double least) {
  struct plan best = {0, (double)INFINITY, ADDED};
  for (double duration = least; duration <= fmax(least, LONGEST_TRANSITION); duration *= GROWTH)
    for (int form = ADDED; form >= DIRECT; --form) {
      const double found = lead(a, jets0, exact, stamp, duration, form) ? excess(a, s, jets0, least) : (double)INFINITY;
      const struct plan plan = {duration, found, form};
      if (found <= 1) return plan;
      if (found < best.excess) best = plan;
    }
  return best;
}

/* Jets at q with velocity dq and zero higher derivatives. */
static void standing_jets(double* jets, const double* q, const double* dq) {
  fill(jets, 0, FJR_JETS * N);
  copy(jets, q, N);
  if (dq) copy(jets + N, dq, N);
}

/* Brake from the measured position and velocity in jets0 to a standstill, whose jets are written to `rest`; return the
 * excess of its positions.
 *
 * All joints brake as long as the fastest does at hold_deceleration. A joint whose way to a position limit is shorter
 * brakes over ROOM_SHARE of it, but over no shorter way than a constant deceleration at its acceleration limit needs. */
static double begin_brake(struct fjr_active* a, const struct fjr_settings* s, const double* jets0, int64_t stamp,
                          double* rest) {
  struct fjr_brake* b = &a->brake;
  double speed = 0, left = 0, end = 0;
  for (int i = 0; i < N; ++i) speed = fmax(speed, fabs(jets0[N + i]));
  const double longest = clamp(PEAK * speed / s->hold_deceleration, SHORTEST, LONGEST);
  standing_jets(rest, jets0, 0);
  copy(b->position, jets0, N), copy(b->speed, jets0 + N, N);
  for (int i = 0; i < N; ++i) {
    const double q = jets0[i], dq = jets0[N + i], low = lowest_position(s, i), high = highest_position(s, i);
    const double most = s->acceleration[i] < (double)INFINITY ? s->acceleration[i] : s->hold_deceleration;
    const double room = ROOM_SHARE * (dq < 0 ? q - low : high - q);
    b->duration[i] = clamp(fmax(3 * room / fabs(dq), 1.5 * fabs(dq) / most), QUICKEST, longest);
    rest[i] += dq * b->duration[i] / 3;
    left = fmax(left, beyond(rest[i], low, high));
    end = fmax(end, b->duration[i]);
  }
  b->t0 = (double)(stamp - a->zero) * 1e-9, b->t1 = b->t0 + end;
  return left > 0 ? LEFT + left : 0;
}

/* Begin the shortest transition from jets0 to the target that respects the limits, of at least `least` > 0 [s]; from a
 * measured state (not `exact`), if there is none, after a brake, if that exceeds them less. Return the duration [s] of
 * both, 0 if there is no transition. */
static double begin_transition(struct fjr_active* a, const struct fjr_settings* s, const double* jets0, int exact,
                               int64_t stamp, double least) {
  forget_brake(a);
  const struct plan plan = shortest(a, s, jets0, exact, stamp, least);
  if (!exact && plan.excess > 1) {
    double rest[FJR_JETS * N];
    const double braked = begin_brake(a, s, jets0, stamp, rest), before = a->brake.t1 - a->brake.t0;
    const int64_t then = stamp + (int64_t)ceil(before * 1e9);
    const struct plan next = shortest(a, s, rest, 1, then, least);
    if (fmax(braked, next.excess) < plan.excess && lead(a, rest, 1, then, next.duration, next.form))
      return before + next.duration;
    forget_brake(a);
  }
  return plan.duration > 0 && lead(a, jets0, exact, stamp, plan.duration, plan.form) ? plan.duration : 0;
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
