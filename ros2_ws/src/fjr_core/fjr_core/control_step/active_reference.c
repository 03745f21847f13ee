/* SPDX-License-Identifier: Apache-2.0
 * The reference that is tracked, on the time line of the stamps: its clock, requests, transitions and standstill.
 */

#define SHORTEST 0.2 /* s; duration of braking */
#define LONGEST 2.0
#define MATCHED 1e-6 /* difference of two jets, relative to 1 + the largest entry of the same derivative */

static const struct fjr_reference* target(const struct fjr_active* a) { return a->target ? a->target : &a->held; }

/* Jets (FJR_JETS, N) at the stamp; at time 0 before the reference begins. */
static void active_jets(const struct fjr_active* a, int64_t stamp, double* jets) {
  const double t = a->zero == FJR_NEVER ? 0 : (double)(stamp - a->zero) * 1e-9;
  if (a->joins && t < a->segment.t1)
    segment_jets(&a->segment, t, jets);
  else
    fjr_reference_jets(target(a), t, jets);
}

static int is_due(const struct fjr_active* a, int64_t stamp) {
  return a->pending && (a->pending_start == FJR_NEVER || stamp >= a->pending_start);
}

static void take_reference(struct fjr_active* a, const struct fjr_reference* reference, int64_t start) {
  a->target = reference, a->pending = 0, a->joins = 0;
  a->zero = a->transition_end = start;
}

/* Set time 0 to this stamp; discard a requested reference whose start is on another time line. */
static void begin_reference(struct fjr_active* a, int64_t stamp) {
  const int counts = a->pending && (a->zero == FJR_NEVER || a->pending_start == FJR_NEVER);
  take_reference(a, counts ? a->pending : a->target, stamp);
}

/* Begin a transition of duration > 0 [s] from jets0 into the requested reference; return 0 if there is none. */
static int begin_transition(struct fjr_active* a, const double* jets0, int64_t stamp, double duration) {
  const double t0 = (double)(stamp - a->zero) * 1e-9, t1 = t0 + duration;
  double jets1[FJR_JETS * N];
  fjr_reference_jets(target(a), t1, jets1);
  if (!make_segment(&a->segment, jets0, jets1, t0, t1)) return 0;
  a->joins = 1;
  a->transition_end = stamp + (int64_t)rint(duration * 1e9);
  return 1;
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
  return begin_transition(a, jets, stamp, duration);
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
static int advance_reference(struct fjr_active* a, int64_t stamp, double join_time) {
  double jets0[FJR_JETS * N], here[FJR_JETS * N], there[FJR_JETS * N];
  if (!is_due(a, stamp)) return 1;
  const struct fjr_reference* reference = a->pending;
  const int64_t start = a->pending_start == FJR_NEVER ? stamp : a->pending_start;
  active_jets(a, start, here);
  fjr_reference_jets(reference, 0, there);
  active_jets(a, stamp, jets0);
  take_reference(a, reference, start);
  return join_time == 0 || match(here, there) || begin_transition(a, jets0, stamp, join_time);
}
