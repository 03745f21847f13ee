/* SPDX-License-Identifier: Apache-2.0
 * The control step: select the effort of a sample and pass it through transfer and limits; see step.h.
 */

/* Write the effort before transfer and limits, with V: NaN unless it is the law's. A stop sends the stop policy's;
 * while velocities settle the last effort stays, or at a start the stop policy's. */
static void select_effort(const struct fjr_model* m, struct fjr_controller* c, const double* jets,
                          enum fjr_order order, int64_t stamp, double* u, double* V) {
  const struct fjr_supervisor* s = &c->supervisor;
  if (!(s->stopped || s->settling || s->yielding)) {
    double ahead[FJR_JETS * N];
    const int64_t dt = c->stamps.last == FJR_NEVER ? 0 : stamp - c->stamps.last;
    if (m->lead) active_jets(&s->reference, stamp + m->lead, ahead);
    if (evaluate_law(m, c, m->lead ? ahead : jets, order, dt, u, V)) return;
    const struct fjr_event event = {FJR_STOPS, FJR_STOPS_LAW, NONE, 0, stamp, NAN, NAN};
    stop(c, FJR_STOPS_LAW, event);
  }
  forget_law(c);
  *V = NAN;
  if (s->stopped)
    moving_effort(m, c, u);
  else if (s->yielding)
    carry_effort(m, c, c->measured.values, c->measured.values + 3 * N, u);
  else if (s->starting)
    hold_effort(m, c, c->measured.values, 0, u);
  else
    copy(u, c->limits.sent, N);
}

/* Pass the effort through transfer and limits; the bound on V continues only if it is the law's own. */
static void blend_and_limit(const struct fjr_model* m, struct fjr_controller* c, double* u, double V, int64_t stamp) {
  struct fjr_supervisor* s = &c->supervisor;
  const int blended = apply_transfer(m, c, u, stamp), limited = limit_effort(c, u, stamp);
  if (blended || limited || !isfinite(V))
    s->bound_start = FJR_NEVER;
  else if (s->bound_start == FJR_NEVER)
    s->bound_start = stamp;
}

static void write_command(const struct fjr_controller* c, struct fjr_command* command, double V, int restarted) {
  command->V = V;
  copy(command->position, c->measured.values, 2 * N);
  copy(command->velocity, c->measured.values + 2 * N, 2 * N);
  command->state = (int32_t)fjr_state_of(c);
  command->restarted = restarted;
  command->bound_start = c->supervisor.bound_start;
}

/* The stop policy's effort for a sample that has no effort of the law; nothing else changes. */
static int without_effort(const struct fjr_model* m, struct fjr_controller* c, int64_t stamp,
                          struct fjr_command* command) {
  forget_observer(c);
  forget_law(c);
  standing_effort(m, c, command->u);
  blend_and_limit(m, c, command->u, NAN, stamp);
  active_jets(&c->supervisor.reference, stamp, command->jets);
  write_command(c, command, NAN, 0);
  return 1;
}

static int not_finite(const struct fjr_model* m, struct fjr_controller* c, int64_t stamp, struct fjr_command* command) {
  const struct fjr_event event = {FJR_EFFORTS_NOT_FINITE, NONE, NONE, 0, stamp, NAN, NAN};
  report_episode(c, &c->journal.not_finite, event);
  return without_effort(m, c, stamp, command);
}

/* As at a silence the stop effort once: the last effort is of states that were frozen already. The next other state is a
 * recovery. */
static int frozen(const struct fjr_model* m, struct fjr_controller* c, int32_t joints, int64_t stamp,
                  struct fjr_command* command) {
  const struct fjr_event event = {FJR_STATES_FROZEN, joints, NONE, 0, stamp, NAN, NAN};
  report_episode(c, &c->journal.frozen, event);
  if (c->stamps.silent) return 0;
  c->stamps.silent = 1;
  return without_effort(m, c, stamp, command);
}

/* Report when samples become older, by more than the timeout, than the youngest of their time line. */
static void note_age(struct fjr_controller* c, int64_t stamp, int64_t arrival) {
  const struct fjr_event event = {FJR_STATES_LATE, NONE, NONE, 0, stamp, NAN, NAN};
  const int late = arrival - stamp - c->stamps.least_age > c->stamps.timeout;
  if (late) report_episode(c, &c->journal.late, event);
  c->journal.late = late;
}

/* State transitions of this sample; return 0 if there is no transition to the reference. */
static int advance(struct fjr_controller* c, enum fjr_order order, int64_t stamp, int settling) {
  handle_order(c, order, stamp, settling);
  return handle_requests(c, order, stamp);
}

/* Advance the supervisor and select the effort; return 0, with supervisor and journal as before, if it is not finite. */
static int attempt(const struct fjr_model* m, struct fjr_controller* c, enum fjr_order order, int64_t stamp,
                   struct fjr_command* command) {
  const int settling = settling_after(m, c, order);
  if (continues(&c->supervisor, order, stamp, settling)) {
    supervised_jets(c, stamp, command->jets);
    select_effort(m, c, command->jets, order, stamp, command->u, &command->V);
    return all_finite(command->u, N);
  }
  const struct fjr_supervisor supervisor = c->supervisor;
  const struct fjr_journal journal = c->journal;
  if (advance(c, order, stamp, settling)) {
    supervised_jets(c, stamp, command->jets);
    select_effort(m, c, command->jets, order, stamp, command->u, &command->V);
    if (all_finite(command->u, N)) return 1;
  }
  c->supervisor = supervisor;
  c->journal = journal;
  return 0;
}

int fjr_step(const struct fjr_model* m, struct fjr_controller* c, const struct fjr_sample* sample, int64_t arrival,
             struct fjr_command* command) {
  const int64_t stamp = sample->stamp, waited = c->stamps.waiting;
  const enum fjr_order order = classify(&c->stamps, m->simulated, stamp, arrival);
  if (waited != FJR_NEVER && waited != stamp) count(c, FJR_STATES_STALE);
  if (order == FJR_STALE) return 0;
  fjr_check_wiring(m, c);
  if (order == FJR_OLDER || order == FJR_DOUBTED) {
    const int32_t late = stamp == c->stamps.last ? FJR_STATES_REPEATED : FJR_STATES_OLDER;
    count(c, order == FJR_OLDER ? late : FJR_JUMPS_DOUBTED);
    return 0;
  }
  const int32_t joints = frozen_joints(m, c, sample);
  if (joints) return frozen(m, c, joints, stamp, command);
  if (order == FJR_LATE || order == FJR_GAP) note_gap(&c->stamps, stamp, arrival);
  if (!measure(m, c, sample, order)) return not_finite(m, c, stamp, command);
  if (order == FJR_NEXT || order == FJR_REPEATED) check_change(c, stamp, stamp - c->stamps.last);
  stop_miswired(c, stamp);
  stop_unmoved(m, c, stamp);
  if (!m->simulated) stop_after_gap(c, order, stamp, arrival);
  heed_contact(c, stamp);
  watch_wiring(m, c, order, stamp);
  if (!attempt(m, c, order, stamp, command)) return not_finite(m, c, stamp, command);
  remember_state(c, order == FJR_NEXT ? (double)(stamp - c->stamps.last) * 1e-9 : 0);
  blend_and_limit(m, c, command->u, command->V, stamp);
  accept_law(c);
  const int64_t elapsed = accept_stamp(&c->stamps, stamp, arrival);
  if (!m->simulated) note_age(c, stamp, arrival);
  if (c->supervisor.stopped) c->stopped_time += elapsed;
  c->journal.not_finite = c->journal.frozen = 0;
  write_command(c, command, command->V, order == FJR_BACK);
  return 1;
}

int64_t fjr_waits_until(const struct fjr_controller* c) {
  return c->stamps.waiting == FJR_NEVER ? FJR_NEVER : c->stamps.waiting_since + WAITING;
}

int fjr_silence(const struct fjr_model* m, struct fjr_controller* c, int64_t now, double* u) {
  if (!is_silent(&c->stamps, m->simulated, now)) return 0;
  report_value(c, FJR_SILENCES, c->stamps.last, (double)c->stamps.timeout * 1e-9);
  fjr_stop_effort(m, c, u);
  return 1;
}

void fjr_stop_effort(const struct fjr_model* m, struct fjr_controller* c, double* u) {
  standing_effort(m, c, u);
  saturate(&c->settings, u);
  keep_effort(&c->limits, u);
  c->limits.clipped = c->limits.slowed = 0;
  forget_law(c);
  c->supervisor.bound_start = FJR_NEVER;
}

void fjr_init(struct fjr_controller* c, const struct fjr_settings* settings, const double* gains,
              const struct fjr_reference* reference) {
  memset(c, 0, sizeof *c);
  c->settings = *settings;
  c->gains = gains;
  c->stamps.timeout = settings->state_timeout;
  c->limits.stamp = FJR_NEVER;
  fill(c->seen.link, NAN, N);
  forget_observer(c);
  fjr_start(c, reference);
}

void fjr_start(struct fjr_controller* c, const struct fjr_reference* reference) {
  if (reference) c->start_reference = reference;
  forget_stamps(&c->stamps);
  init_supervisor(&c->supervisor, c->start_reference);
  fjr_wiring_start(&c->wiring);
  memset(&c->contact, 0, sizeof c->contact);
  fill(c->policy.agreed, 0, N), fill(c->policy.size, 0, N);
  c->policy.released = 0;
  c->journal.saturation = c->journal.not_finite = c->journal.frozen = c->journal.late = 0;
}

void fjr_apply(struct fjr_controller* c, const struct fjr_settings* settings) {
  if (c->contact.acting && settings->on_contact != c->settings.on_contact) c->contact.heeded = 0; /* react anew */
  c->settings = *settings;
  c->stamps.timeout = settings->state_timeout;
  saturate(settings, c->limits.sent);
  c->limits.clipped = c->limits.clipped && has_limit(settings->effort);
  c->limits.slowed = c->limits.slowed && has_limit(settings->effort_rate);
  report(c, FJR_SETTINGS_CHANGED, c->stamps.last);
}

void fjr_use_gains(struct fjr_controller* c, const double* gains, const double* hold_damping) {
  c->gains = gains;
  copy(c->settings.hold_damping, hold_damping, N * N);
  c->supervisor.bound_start = FJR_NEVER;
  report(c, FJR_GAINS_CHANGED, c->stamps.last);
}

void fjr_follow(struct fjr_controller* c, const struct fjr_reference* reference, int64_t start) {
  c->supervisor.holding = 0;
  c->supervisor.reference.pending = reference;
  c->supervisor.reference.pending_start = start;
  report(c, FJR_REFERENCES_CHANGED, c->stamps.last);
}

void fjr_hold(struct fjr_controller* c) {
  c->supervisor.holding = 1;
  c->supervisor.reference.pending = 0;
  report(c, FJR_HOLDS, c->stamps.last);
}

void fjr_resume(struct fjr_controller* c) {
  if (!c->supervisor.stopped) return;
  fjr_wiring_start(&c->wiring);
  c->policy.released = c->contact.heeded = c->supervisor.yielding = 0;
  c->supervisor.resuming = 1;
}

enum fjr_state fjr_state_of(const struct fjr_controller* c) {
  const struct fjr_supervisor* s = &c->supervisor;
  if (s->stopped) return FJR_STOPPED;
  if (c->stamps.last == FJR_NEVER) return FJR_WAITING;
  return s->transfer.active || s->settling || s->joining || s->yielding ? FJR_JOINING : FJR_TRACKING;
}

void fjr_jets_at(const struct fjr_controller* c, int64_t stamp, double* jets) {
  active_jets(&c->supervisor.reference, stamp, jets);
}
