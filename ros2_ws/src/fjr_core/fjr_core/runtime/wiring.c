/* SPDX-License-Identifier: Apache-2.0
 * The check of the wiring: find exchanged joints and wrong signs of efforts and encoders in the first samples.
 *
 * The misfit d of a row of m components (wiring_rows.c) is (y - x)' S^-1 (y - x). The noise in S is an estimate, often
 * far too small after 9 states. So y - x has Student's distribution with f degrees of freedom, and the deviance of the row
 * is (f + m) log(1 + d / f) + log det S. Each hypothesis on the wiring is undone in the window; its evidence is the
 * decrease of the deviance over all rows, which is twice the logarithm of a likelihood ratio. Only rows that change are
 * evaluated again.
 *
 * A comparison begins after a sample that is due and goes on after the next ones: after each, at most WORK operations
 * and one hypothesis. An operation takes no longer than the evaluation of one row with its S.
 */
#define WORK (16 * N)
#define FEWEST 9              /* states of the first comparison */
#define FULL (FJR_WINDOW - 2) /* states from which a choice is made between nearly equal explanations */
#define EARLY 2               /* samples between comparisons until the window is full .. */
#define RARER 1.1             /* .. and the ratio of their numbers later: the mean cost of a sample vanishes */
#define CONFIRMED 2           /* consecutive comparisons that must agree on the first joint of a fault */
#define DRIVEN 5.0            /* deviations of constant torques, beyond which a motor must move */
#define LOADED 100.0          /* factor on the deviation of constant torques later, when the arm may touch something */

#define EVIDENCE 23.025850929940457 /* 2 log 1e5: a false alarm has probability 1e-5 (Wald) */
#define CLEARER 9.210340371976184   /* 2 log 1e2: against another fault before FULL, and for a velocity that is late */
#define FILTERED 27.63102111592855  /* 2 log 1e6: .. and for one through a low-pass */
#define FAILS 1.25    /* least misfit per component of a suspected row; its mean is at most 1 if it is right */
#define FITS 1.6      /* largest misfit per component of a torque once the fault is undone .. */
#define FOLLOWS 3.0   /* .. and of a velocity */
#define CLOSER 2.0    /* undoing the fault decreases the mean squares of its torques by this factor, whatever S is */
#define COARSE 0.5    /* largest share of intervals without motion; else the encoder is too coarse for a slope */

/* ---- Comparison of the wiring as measured ----------------------------------------------------------------------- */

static int is_coarse(const struct fjr_comparison* c, int i) {
  int still = 0;
  for (int k = 0; k < c->intervals; ++k) still += c->slope[i][k] == 0;
  return still > COARSE * c->intervals;
}

/* Return the deviance of a misfit of a row without log det S. */
static double student(const struct sides* s, double misfit) {
  return (s->freedom + s->m) * log(1 + misfit / s->freedom);
}

/* Find the slope that a velocity follows, which does not follow its own, not even late, and is not noise alone; s: its
 * factorised row. */
static struct fjr_wiring_fault wrong_velocity(const struct fjr_comparison* c, int i, struct sides* s) {
  const int m = s->m, j = i % N, first = i - j;
  struct fjr_wiring_fault fault = {.count = 0};
  double left[N], late[INTERVALS], slope[MOTION];
  double own = student(s, distance(s->S, m, s->y, 1, s->x));
  own = fmin(own, student(s, distance(s->S, m, s->y, 0, s->x)) + CLEARER); /* all is noise */
  int k = 0, clear = 1;
  for (int other = 0; other < N; ++other) {
    const double sign = other == j ? -1 : 1;
    slow_motion(c, c->slope[first + other], slope);
    left[other] = is_coarse(c, first + other) ? (double)INFINITY : distance(s->S, m, s->y, sign, slope);
    if (left[other] < left[k]) k = other;
  }
  for (int other = 0; other < N; ++other) clear &= other == k || left[other] > left[k] + CLEARER;
  for (int lag = 1; lag <= LAGS; ++lag) { /* such as of a driver's buffer, or its low-pass, which fits much slow motion */
    delayed(late, c->slope[i], c->intervals, lag, c->dq[i][0]);
    slow_motion(c, late, slope);
    own = fmin(own, student(s, distance(s->S, m, s->y, 1, slope)) + CLEARER);
    filtered(late, c->slope[i], c->intervals, lag * lag, c->dq[i][0]);
    slow_motion(c, late, slope);
    own = fmin(own, student(s, distance(s->S, m, s->y, 1, slope)) + FILTERED);
  }
  if (!(c->full || clear) || !(left[k] < FOLLOWS * m)) return fault;
  if (!(own - student(s, left[k]) > EVIDENCE)) return fault;
  fault.kind = k == j ? FJR_VELOCITY_SIGN : FJR_VELOCITY_OF_ANOTHER;
  fault.side = i >= N, fault.count = 1 + (k != j), fault.joint[0] = j;
  if (k != j) fault.joint[1] = k;
  return fault;
}

/* Evaluate a row and flag it as right if it agrees and the evidence against a changed sign suffices; return whether it
 * is suspected, -1 if S is not positive definite. known: it is right. */
static int judge_row(struct fjr_wiring* w, int row, struct sides* s, int known) {
  struct fjr_comparison* c = &w->comparison;
  const double log_det = factorised(s->S, s->m), misfit = distance(s->S, s->m, s->y, 1, s->x);
  const double against = distance(s->S, s->m, s->y, -1, s->x) - misfit;
  if (!isfinite(log_det + misfit)) return -1;
  if (row < 2 * N) {
    c->misfit[row] = misfit, c->deviance[row] = student(s, misfit) + log_det;
    c->squares[row] = squares(s);
  }
  c->agrees[row] = c->full && against > EVIDENCE && misfit < FITS * s->m;
  return !known && misfit > FAILS * s->m;
}

/* Evaluate all rows of the latest states as measured: right and suspected ones, and a wrong velocity; return 0 if a row
 * has no value, near overflow. */
static int begin_comparison(const struct fjr_model* m, struct fjr_wiring* w, const struct arm* arm,
                            struct fjr_wiring_fault* velocity) {
  struct fjr_comparison* c = &w->comparison;
  const struct wires v = as_measured();
  int32_t efforts[N];
  struct sides s;
  for (int row = 0; row < 4 * N; ++row) {
    if (row < 2 * N)
      torque_row(m, c, &v, arm, row, 1, &s);
    else
      speed_row(c, row - 2 * N, &s);
    const int suspected = judge_row(w, row, &s, w->right[row]);
    if (suspected < 0) return 0;
    if (row < 2 * N)
      c->suspected[row] = suspected;
    else if (suspected && !velocity->count && !is_coarse(c, row - 2 * N))
      *velocity = wrong_velocity(c, row - 2 * N, &s);
  }
  for (int i = 0; i < N; ++i) /* the spring is in both equations */
    c->suspected[i] = (c->suspected[i] || c->suspected[N + i]) && !w->right[i];
  for (int j = 0; j < N; ++j) { /* an effort is in the equations of all motors that it drives */
    efforts[j] = 0;
    for (int i = 0; i < N; ++i) efforts[j] |= m->B_m[i * N + j] != 0 && c->suspected[N + i];
  }
  for (int j = 0; j < N; ++j) c->suspected[N + j] = efforts[j];
  for (int row = 0; row < 4 * N; ++row) w->right[row] |= c->agrees[row];
  return 1;
}

/* ---- Hypotheses ------------------------------------------------------------------------------------------------- */

enum { UNDO_EFFORT, UNDO_LINK, UNDO_MOTOR, UNDO_ALL }; /* sides; the signs of all suspected efforts */
#define HYPOTHESES (UNDO_ALL * N * N + 1)              /* number of sides and pairs of joints; i = j: a wrong sign */

/* Write hypothesis h as a fault; return 0 if its joints are not suspected. */
static int hypothesis(const struct fjr_comparison* c, int h, struct fjr_wiring_fault* fault) {
  const int undo = h / (N * N), i = h / N % N, j = h % N;
  const int32_t* suspected = c->suspected + (undo == UNDO_EFFORT || undo == UNDO_ALL ? N : 0);
  fault->side = undo != UNDO_LINK, fault->count = 0;
  if (undo == UNDO_ALL) {
    fault->kind = FJR_EFFORT_SIGN;
    for (int k = 0; k < N; ++k)
      if (suspected[k]) fault->joint[fault->count++] = k;
    return fault->count > 1;
  }
  if (j < i || !suspected[i] || !suspected[j]) return 0;
  fault->kind = (undo == UNDO_EFFORT ? FJR_EFFORT_SIGN : FJR_ENCODER_SIGN) + (i != j);
  fault->joint[fault->count++] = i;
  if (i != j) fault->joint[fault->count++] = j;
  return 1;
}

/* Undo a fault in the signals, and flag the rows of torques (2N) that change. */
static void undo_fault(const struct fjr_model* m, const struct fjr_wiring_fault* fault, struct wires* v, int* changed) {
  const int efforts = fault->kind <= FJR_EFFORTS_EXCHANGED, first = efforts || !fault->side ? 0 : N;
  int* order = efforts ? v->effort : v->from;
  double* sign = efforts ? v->effort_sign : v->sign;
  for (int row = 0; row < 2 * N; ++row) changed[row] = !efforts && !first && row < N;
  for (int k = 0; k < fault->count; ++k) {
    const int j = fault->joint[k];
    if (fault->kind == FJR_EFFORT_SIGN || fault->kind == FJR_ENCODER_SIGN)
      sign[first + j] = -1;
    else
      order[first + j] = first + fault->joint[1 - k];
    for (int i = 0; i < N; ++i) {
      const int spring = !efforts && m->K[j * N + i] != 0, at = j * N + i;
      changed[i] |= spring;
      changed[N + i] |= spring || (efforts ? m->B_m[i * N + j] != 0 : first && (m->M_m[at] != 0 || m->D_m[at] != 0));
    }
  }
}

/* Return whether a fault concerns joint i: it is named, or one of its efforts drives the motor of i. */
static int concerns(const struct fjr_model* m, const struct fjr_wiring_fault* fault, int i) {
  for (int k = 0; k < fault->count; ++k) {
    const int j = fault->joint[k];
    if (fault->kind <= FJR_EFFORTS_EXCHANGED ? m->B_m[i * N + j] != 0 : i == j) return 1;
  }
  return 0;
}

static int same_joints(const struct fjr_wiring_fault* a, const struct fjr_wiring_fault* b) {
  if (a->kind != b->kind || a->count != b->count) return 0;
  for (int k = 0; k < a->count; ++k)
    if (a->joint[k] != b->joint[k]) return 0;
  return 1;
}

/* Keep a fault that explains the window: the best one, the best of an effort, and the evidence of the best with another
 * kind or other joints. */
static void keep_explanation(struct fjr_comparison* c, const struct fjr_wiring_fault* fault, double evidence) {
  const int same = same_joints(fault, &c->best);
  if (fault->kind <= FJR_EFFORTS_EXCHANGED && evidence >= c->effort_evidence)
    c->best_effort = *fault, c->effort_evidence = evidence;
  if (evidence >= c->evidence) {
    if (!same) c->other_evidence = c->evidence;
    c->best = *fault, c->evidence = evidence;
  } else if (!same && evidence > c->other_evidence) {
    c->other_evidence = evidence;
  }
}

/* Undo a fault in the window, and keep it if it explains the rows that it concerns; return the number of operations. */
static int try_hypothesis(const struct fjr_model* m, struct fjr_comparison* c, const struct arm* measured,
                          const struct fjr_wiring_fault* fault) {
  const int count = c->intervals, moved = fault->kind > FJR_EFFORTS_EXCHANGED && !fault->side; /* links */
  const struct arm* arm = measured;
  struct wires v = as_measured();
  struct arm undone;
  struct sides s;
  double before = 0, left = 0, evidence = 0;
  int changed[2 * N], work = 1 + 2 * moved;
  undo_fault(m, fault, &v, changed);
  if (moved && !evaluate_arm(m, c, &v, &undone)) return work;
  if (moved) arm = &undone;
  for (int row = 0; row < 2 * N; ++row) {
    if (!concerns(m, fault, row % N)) continue;
    if (changed[row]) torque_row(m, c, &v, arm, row, 0, &s);
    before += c->squares[row], left += changed[row] ? squares(&s) : c->squares[row];
  }
  if (!(CLOSER * left < before)) return work;
  for (int pass = 0; pass < 2; ++pass) /* the joints of the fault, which must fit, then all others */
    for (int row = 0; row < 2 * N; ++row) {
      const int own = concerns(m, fault, row % N);
      if (own == pass) continue;
      double misfit = c->misfit[row];
      if (changed[row]) {
        torque_row(m, c, &v, arm, row, 1, &s);
        const double log_det = factorised(s.S, count);
        misfit = distance(s.S, count, s.y, 1, s.x), ++work;
        evidence += c->deviance[row] - (student(&s, misfit) + log_det);
      }
      if (own && !(misfit < FITS * count)) return work;
    }
  if (evidence > EVIDENCE) keep_explanation(c, fault, evidence);
  return work;
}

/* ---- The check -------------------------------------------------------------------------------------------------- */

/* Return the fault with the largest evidence, or an effort's of nearly equal ones; none while they are open. Link and
 * motor encoder of a joint cannot be told apart at rest: either stops the robot. */
static struct fjr_wiring_fault decided(const struct fjr_comparison* c) {
  const struct fjr_wiring_fault none = {.count = 0};
  const double near = c->evidence - CLEARER;
  if (!c->best.count || (!c->full && c->other_evidence > near)) return none;
  return c->best_effort.count && c->effort_evidence > near ? c->best_effort : c->best;
}

/* End a comparison with a fault or none; the check has found it if CONFIRMED comparisons agree on its first joint. */
static void conclude(struct fjr_wiring* w, struct fjr_wiring_fault fault) {
  const int same = fault.count && w->fault.count && fault.joint[0] == w->fault.joint[0];
  w->agreed = same ? w->agreed + 1 : fault.count > 0;
  w->fault = fault;
  w->found = w->agreed >= CONFIRMED;
  w->comparing = 0;
}

/* Standard deviation of constant torques: friction, payload, offsets of encoders. The largest weight is that at the
 * first positions, or with one link turned by pi / 2; forces and torques are not compared. */
static int estimate_constant(const struct fjr_model* m, struct fjr_wiring* w, const double* q_l) {
  double turned[N], weight[N], most[2] = {0, 0}; /* of revolute, of prismatic joints */
  for (int k = 0; k <= N; ++k) {
    copy(turned, q_l, N);
    if (k < N && !m->slides[k]) turned[k] += 1.5707963267948966;
    m->arg[0] = turned, m->res[0] = weight;
    if (m->gravity(m->arg, m->res, m->iw, m->w, 0)) return 0;
    for (int i = 0; i < N; ++i) most[m->slides[i]] = fmax(most[m->slides[i]], fabs(weight[i]));
  }
  for (int i = 0; i < N; ++i)
    w->constant[i] = WEIGHT * most[m->slides[i]] + (m->slides[i] ? SHIFT : OFFSET) * m->K[i * N + i];
  w->has_constant = 1;
  return 1;
}

/* Begin a comparison of the latest states if one is due; return the number of operations. */
static int compare_if_due(const struct fjr_model* m, struct fjr_wiring* w, struct arm* arm) {
  const struct fjr_wiring_fault none = {.count = 0};
  const struct wires v = as_measured();
  struct fjr_comparison* c = &w->comparison;
  struct fjr_wiring_fault velocity = none;
  if (w->count < w->due) return 0;
  w->due = w->count < FULL ? w->count + EARLY : w->count + 1;
  if (w->count >= FJR_WINDOW) w->due = (int64_t)ceil(RARER * (double)w->count);
  take_signals(w, c);
  c->full = c->intervals + 1 >= FULL, c->next = 0, c->best = c->best_effort = none;
  c->evidence = c->effort_evidence = c->other_evidence = -INFINITY;
  if (!evaluate_arm(m, c, &v, arm) || !(w->has_constant || estimate_constant(m, w, c->ends[0]))) return 4 * N;
  for (int i = 0; i < N; ++i) c->constant[i] = w->constant[i] * (w->count > FJR_WINDOW ? LOADED : 1);
  w->comparing = begin_comparison(m, w, arm, &velocity);
  if (w->comparing && velocity.count) conclude(w, velocity);
  return 4 * N;
}

void fjr_wiring_start(struct fjr_wiring* w) {
  memset(w, 0, sizeof *w);
  fjr_wiring_skip(w);
}

void fjr_wiring_skip(struct fjr_wiring* w) {
  w->count = 0, w->due = FEWEST;
  w->fault.count = w->agreed = w->has_constant = w->comparing = w->waiting = 0;
}

void fjr_wiring_see(struct fjr_wiring* w, double t, const double* position, const double* velocity) {
  const int64_t at = w->count++ % FJR_WINDOW;
  w->t[at] = t;
  copy(w->q[at], position, 2 * N);
  copy(w->dq[at], velocity, 2 * N);
  fill(w->u[at], 0, N);
  w->waiting = 1;
}

void fjr_wiring_sent(struct fjr_wiring* w, const double* u) {
  if (w->count) copy(w->u[(w->count - 1) % FJR_WINDOW], u, N);
}

int fjr_wiring_is_right(const struct fjr_wiring* w) {
  for (int row = 0; row < 4 * N; ++row)
    if (!w->right[row]) return 0;
  return 1;
}

int fjr_wiring_compare(const struct fjr_model* m, struct fjr_wiring* w) {
  const struct wires v = as_measured();
  struct fjr_wiring_fault fault;
  struct arm arm;
  int work = 0;
  if (!w->waiting || w->found) return 0;
  w->waiting = 0;
  if (!w->comparing)
    work = compare_if_due(m, w, &arm);
  else if (!evaluate_arm(m, &w->comparison, &v, &arm))
    w->comparing = 0;
  for (; w->comparing && w->comparison.next < HYPOTHESES && work < WORK; ++w->comparison.next)
    if (hypothesis(&w->comparison, w->comparison.next, &fault)) work += try_hypothesis(m, &w->comparison, &arm, &fault);
  if (w->comparing && w->comparison.next == HYPOTHESES) conclude(w, decided(&w->comparison));
  return work;
}

/* Let the check see an accepted state, with the effort that was sent for the last one. */
static void watch_wiring(const struct fjr_model* m, struct fjr_controller* c, enum fjr_order order, int64_t stamp) {
  struct fjr_wiring* w = &c->wiring;
  if (!m->dynamics || m->observer || order == FJR_REPEATED || w->found) return;
  if (!c->settings.wiring_check || order != FJR_NEXT) fjr_wiring_skip(w);
  if (!c->settings.wiring_check || fjr_wiring_is_right(w)) return;
  if (w->count)
    fjr_wiring_sent(w, c->limits.left);
  else
    w->first = stamp;
  fjr_wiring_see(w, (double)(stamp - w->first) * 1e-9, c->measured.values, c->measured.values + 2 * N);
}

/* Stop if the values of a joint repeat under new stamps while effort and spring must have moved its motor: its source is
 * dead, or a brake is closed. The torque on the motor counts from the effort at which they stood still, and as far as it
 * exceeds DRIVEN deviations of constant torques (friction, payload, offsets of encoders). */
static void stop_unmoved(const struct fjr_model* m, struct fjr_controller* c, int64_t stamp) {
  const double dt = (double)c->stamps.interval * 1e-9, *link = c->seen.link;
  double zeta[N], spring[N], drive[N], tangent, *stood = c->driven[0], *speed = c->driven[1], *way = c->driven[2];
  for (int i = 0; i < N; ++i) zeta[i] = c->seen.motor[i] / m->gear_ratio[i] - link[i];
  multiply(spring, m->K, zeta);
  multiply(drive, m->B_m, c->limits.left);
  for (int i = 0; i < N; ++i) {
    const int64_t elapsed = stamp - c->changed[i];
    if (m->pieces) spring[i] = on_curve(m, i, zeta[i], &tangent);
    spring[i] += m->cubic[i] * zeta[i] * zeta[i] * zeta[i];
    if (elapsed <= 0 || c->supervisor.stopped) stood[i] = drive[i];
    const double torque = drive[i] - spring[i], least = fmin(fabs(torque), fabs(drive[i] - stood[i]));
    const double beyond = c->wiring.constant[i] > 0 ? least - DRIVEN * c->wiring.constant[i] : 0;
    speed[i] = beyond > 0 ? speed[i] + copysign(beyond, torque) / m->M_m[i * N + i] * dt : 0;
    way[i] = beyond > 0 ? way[i] + speed[i] * dt : 0;
    if (elapsed <= UNCHANGED + 2 * c->stamps.interval || fabs(way[i]) <= UNSEEN || c->supervisor.stopped) continue;
    const struct fjr_event event = {FJR_STOPS, FJR_STOPS_NO_MOTION, i, 0, stamp, fabs(way[i]), UNSEEN};
    stop(c, FJR_STOPS_NO_MOTION, event);
  }
}

/* Stop without any effort once the check has found a fault. */
static void stop_miswired(struct fjr_controller* c, int64_t stamp) {
  struct fjr_wiring* w = &c->wiring;
  if (!w->found || w->reported) return;
  const struct fjr_event event = {FJR_STOPS, FJR_STOPS_WIRING, w->fault.joint[0], 0, stamp, NAN, NAN};
  w->reported = 1;
  c->journal.wiring = w->fault;
  c->policy.released = 1;
  stop(c, FJR_STOPS_WIRING, event);
}

void fjr_check_wiring(const struct fjr_model* m, struct fjr_controller* c) { (void)fjr_wiring_compare(m, &c->wiring); }
