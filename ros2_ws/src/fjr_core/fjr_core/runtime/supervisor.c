/* SPDX-License-Identifier: Apache-2.0
 * The supervisor: a state machine that starts, recovers, holds and stops tracking.
 *
 * Start: ramp from the stop policy's effort over start.ramp_time; transition from the measured state over
 * start.join_time or longer, unless the arm is within limits.start_error. Without start.join_time the start is refused
 * if |q_l - q_ld| exceeds limits.start_error.
 * Recovery (after a gap of the samples, or a resume): transition of the reference from the measured state over
 * recovery.join_time or longer, and blend of the effort over BLEND of that time. The clock of the reference continues.
 * After a gap longer than recovery.longest_gap in real time: stop, as somebody may have reached for the arm.
 * Contact: report it, stop, or yield (gravity compensation, damped motors) until it has ended, then recover.
 * Jump back of the stamps: start again with the reference of the last start; hold the position after a requested one.
 * Stop: at a violated limit, after a long gap, or where the law failed, latched until a resume. Outside the limits nothing is started or
 * resumed. Until the velocities of an observer that was reset have settled, their limits and that of the tracking error
 * are not checked. The functions that return int return 0 if there is no transition to the reference.
 */

#define BLEND 0.05 /* of the join time: a longer blend has a larger error, and no smaller step of u */
#define AHEAD 0.1  /* s; a start is displaced by the velocity error over this time, too */

static void init_supervisor(struct fjr_supervisor* s, const struct fjr_reference* reference) {
  memset(s, 0, sizeof *s);
  s->reference.target = reference;
  s->reference.zero = s->reference.pending_start = s->bound_start = FJR_NEVER;
  s->starting = 1;
}

/* True if this sample triggers no state transition. */
static int continues(const struct fjr_supervisor* s, enum fjr_order order, int64_t stamp, int settling) {
  const int requested = s->resuming || s->holding || s->returning || is_due(&s->reference, stamp);
  return order == FJR_NEXT && !(settling || s->settling || requested);
}

static void begin(struct fjr_controller* c, int64_t stamp) {
  struct fjr_supervisor* s = &c->supervisor;
  if (s->holding) stand(&s->reference, c->measured.values, stamp);
  s->holding = 0;
  begin_reference(&s->reference, stamp);
  s->bound_start = FJR_NEVER;
  s->starting = 1;
}

/* Hold the position if the reference was requested on the time line that has ended: a trajectory is not driven twice. */
static void end_requested(struct fjr_controller* c, int64_t stamp) {
  struct fjr_active* a = &c->supervisor.reference;
  const int next = a->pending && a->pending_start == FJR_NEVER; /* at this sample */
  if (a->target != c->start_reference && !next) stand(a, c->measured.values, stamp);
}

static void handle_order(struct fjr_controller* c, enum fjr_order order, int64_t stamp, int settling) {
  struct fjr_supervisor* s = &c->supervisor;
  if (order == FJR_REPEATED) {
    count(c, FJR_STATES_REPEATED);
    return;
  }
  if (order == FJR_BACK) report(c, FJR_REFERENCE_RESTARTS, stamp), end_requested(c, stamp);
  if (order == FJR_FIRST || order == FJR_BACK) begin(c, stamp);
  if (order == FJR_FORWARD) report(c, FJR_FORWARD_JUMPS, stamp);
  if ((order == FJR_NEXT || order == FJR_GAP) && settling) report(c, FJR_OBSERVER_RESTARTS, stamp);
  if (order != FJR_NEXT || settling) {
    s->transfer.active = 0;
    s->settling = 1 + settling;
  }
}

/* Begin the transition of the reference from the measured state; return its duration [s], 0 if there is none. */
static double join(struct fjr_controller* c, int64_t stamp, double least) {
  double jets[FJR_JETS * N];
  standing_jets(jets, c->measured.values, c->measured.values + 2 * N);
  return begin_transition(&c->supervisor.reference, &c->settings, jets, 0, stamp, least);
}

/* True if the arm is displaced from the jets by more than limits.start_error, or that is infinite. */
static int is_displaced(const struct fjr_controller* c, const double* jets) {
  const double *q = c->measured.values, *dq = q + 2 * N;
  for (int i = 0; i < N; ++i) {
    const double limit = c->settings.start_error[i];
    if (!(limit < (double)INFINITY && fabs(q[i] - jets[i]) + AHEAD * fabs(dq[i] - jets[N + i]) <= limit)) return 1;
  }
  return 0;
}

static int start_tracking(struct fjr_controller* c, int64_t stamp) {
  struct fjr_supervisor* s = &c->supervisor;
  const double least = c->settings.start_join_time, ramp = c->settings.ramp_time;
  double jets[FJR_JETS * N];
  active_jets(&s->reference, stamp, jets);
  begin_transfer(&s->transfer, stamp, ramp, 1);
  if (least == 0) {
    check_start(c, jets, stamp);
  } else if (is_displaced(c, jets)) {
    if (!(join(c, stamp, least) > 0)) return 0;
    if (ramp == 0) begin_transfer(&s->transfer, stamp, BLEND * least, 0);
  }
  s->starting = s->stopped != 0;
  return 1;
}

static int recover(struct fjr_controller* c, int64_t stamp) {
  const double least = c->settings.recovery_join_time;
  double duration = 0;
  c->supervisor.bound_start = FJR_NEVER;
  if (least > 0) {
    if (!((duration = join(c, stamp, least)) > 0)) return 0;
    begin_transfer(&c->supervisor.transfer, stamp, BLEND * least, 0);
  }
  report_value(c, FJR_RECOVERIES, stamp, duration);
  return 1;
}

/* End the stop unless the state violates a limit; return 1 if tracking can recover at this sample. */
static int resume(struct fjr_controller* c, int64_t stamp) {
  struct fjr_supervisor* s = &c->supervisor;
  s->stopped = s->resuming = 0;
  check_limits(c, 0, stamp);
  if (s->stopped) return 0;
  count(c, FJR_RESUMES);
  s->starting = s->starting && c->settings.recovery_join_time == 0;
  if (s->starting) begin(c, stamp);
  return s->settling == 0;
}

/* Stop after a long gap of the arrivals that ends at this sample, also where a resume was requested before it. */
static void stop_after_gap(struct fjr_controller* c, enum fjr_order order, int64_t stamp, int64_t arrival) {
  const double gap = (double)(arrival - c->stamps.arrival) * 1e-9, longest = c->settings.recovery_longest_gap;
  const struct fjr_event event = {FJR_STOPS, FJR_STOPS_SILENCE, NONE, 0, stamp, gap, longest};
  const int stays = c->supervisor.stopped && !c->supervisor.resuming;
  if (order == FJR_FIRST || order == FJR_REPEATED || stays) return;
  if (longest > 0 && gap > longest) stop(c, FJR_STOPS_SILENCE, event);
}

/* Report a contact when it begins and react to it, also where a stop is about to end; when it has ended, recover from
 * yielding. */
static void heed_contact(struct fjr_controller* c, int64_t stamp) {
  struct fjr_contact* t = &c->contact;
  struct fjr_supervisor* s = &c->supervisor;
  const int stays = s->stopped && !s->resuming, yielded = s->yielding;
  if (t->acting == t->heeded) return;
  t->heeded = t->acting;
  if (t->acting) {
    const struct fjr_event seen = {FJR_CONTACTS, t->joints, t->joint, 0, stamp, t->value, t->limit};
    report_event(c, seen);
    if (c->settings.on_contact == FJR_STOP && !stays) stop(c, FJR_STOPS_CONTACT, contact_stop(t, stamp));
  }
  s->yielding = t->acting && c->settings.on_contact == FJR_YIELD && !stays;
  if (yielded && !s->yielding) s->returning = !s->stopped;
}

/* Carry out requests since the last sample; start or recover once the velocities have settled. */
static int handle_requests(struct fjr_controller* c, enum fjr_order order, int64_t stamp) {
  struct fjr_supervisor* s = &c->supervisor;
  int ready = 0;
  if (s->settling && order != FJR_REPEATED) ready = !--s->settling;
  if (s->returning) ready = s->settling == 0;
  s->returning = 0;
  if (s->resuming) ready = resume(c, stamp);
  if (ready && !s->stopped) check_limits(c, 0, stamp);
  if (ready && !s->stopped && !(s->starting ? start_tracking(c, stamp) : recover(c, stamp))) return 0;
  if (s->holding && s->stopped) stand(&s->reference, c->measured.values, stamp);
  if (s->holding && !s->stopped && !brake(&s->reference, stamp, c->settings.hold_deceleration)) return 0;
  s->holding = 0;
  return advance_reference(&s->reference, &c->settings, stamp, s->stopped ? 0 : c->settings.recovery_join_time);
}

/* Write the reference's jets at the stamp; stop if the state violates a limit. */
static void supervised_jets(struct fjr_controller* c, int64_t stamp, double* jets) {
  struct fjr_supervisor* s = &c->supervisor;
  active_jets(&s->reference, stamp, jets);
  s->joining = stamp < s->reference.transition_end;
  if (!s->stopped) check_limits(c, s->settling || s->yielding ? 0 : jets, stamp);
}
