/* SPDX-License-Identifier: Apache-2.0
 * Lock-step: send a state and the time, wait for the command with its stamp, advance one sample.
 *
 * A state without a command is sent again unchanged and never skipped. After the first command since a start or a
 * reset, FJR_UNANSWERED if no command comes for `timeout`; before, the robot waits. If a channel loses or delays a
 * state, the sample passes with the held effort, in every run alike.
 */

#define FJR_MANY 2000 /* a publisher keeps 5000 samples */

/* Send the time, after the state of that time, so that subscribers receive the state first. After FJR_MANY times wait
 * until they have received all: a recorder that has no core for a while must not miss any. */
static int show_time(struct fjr_plant* p) {
  show(p, stamp_of(p));
  fjr_put_stamp(p->clock, p->shown);
  if (send_message(p, FJR_CLOCK, p->clock)) return p->fault;
  if (++p->times_shown % FJR_MANY == 0 && p->settle)
    for (int32_t k = FJR_STATE; k < FJR_OUTPUTS; ++k) p->settle(p->host, k);
  return p->fault;
}

/* Take a sample; it is to be sent, or put into the channel. */
static int measure(struct fjr_plant* p) {
  if (take_sample(p)) return p->fault;
  if (p->states->on && p->heard) {
    fjr_channel_push(p->states, p->robot->time, p->sample);
  } else { /* without errors until the first command */
    memcpy(p->held, p->sample, (SAMPLE_VALUES + 6 * (size_t)p->robot->n) * sizeof(double));
    p->holds = 1;
  }
  return 0;
}

static const double* arrived(struct fjr_plant* p) {
  if (!p->holds) return p->states->on ? fjr_channel_pop(p->states, p->robot->time) : NULL;
  p->holds = 0;
  return p->held;
}

/* Send the states that have arrived up to the first that can still receive a command: awaited, FJR_NO_TIME: none. */
static int send_first(struct fjr_plant* p, int64_t now) {
  const double* sample;
  p->awaited = FJR_NO_TIME;
  while ((sample = arrived(p))) {
    const int64_t stamp = sample_stamp(sample);
    if (send_sample(p, sample) || show_time(p)) return p->fault;
    memmove(p->sample, sample, sizeof(double) * (SAMPLE_VALUES + 6 * (size_t)p->robot->n));
    p->sent_at = p->first_sent_at = now;
    if (stamp >= p->newest) { /* not overtaken by a newer state */
      p->newest = p->awaited = stamp;
      return 0;
    }
  }
  return 0;
}

/* Send the state again as it left; p->sample still holds it. */
static int send_again(struct fjr_plant* p, int64_t now) {
  count(p, FJR_SENT_AGAIN, 1);
  p->sent_at = now;
  if (send_message(p, FJR_STATE, message_of(p, p->sample))) return p->fault;
  return show_time(p);
}

/* Send states that have arrived; if there are none, let samples pass until one arrives. */
static int go_on(struct fjr_plant* p, int64_t now) {
  if (send_first(p, now)) return p->fault;
  for (int k = 0; k < FJR_MOST_SILENT && p->awaited == FJR_NO_TIME && is_running(p); ++k) {
    if (integrate(p, fjr_sample_times_next(p->times)) || measure(p) || send_first(p, now)) return p->fault;
    if (p->awaited == FJR_NO_TIME && show_time(p)) return p->fault;
    passed(p, stamp_of(p));
    count_sample(p);
  }
  return 0;
}

int fjr_lock_step_command(void* self, int32_t source, const uint8_t* data, size_t size, int64_t now, int64_t* next) {
  struct fjr_plant* p = self;
  (void)source, (void)next;
  if (p->fault) return p->fault;
  const int reading = fjr_read_joint_state(p->answer, data, size);
  if (reading != FJR_READ) return refuse(p, reading, data, size);
  if (p->answer->stamp != p->awaited || !is_running(p)) {
    count(p, FJR_OTHER_ANSWER, 1);
    p->other = p->answer->stamp;
    return 0;
  }
  const int first = !p->heard;
  if (first && tell(p, FJR_FIRST_ANSWER, 0)) return failed(p, FJR_REFUSED);
  take_effort(p, p->robot->time, p->answer->value[2]);
  p->awaited = FJR_NO_TIME, p->heard = 1;
  count(p, FJR_RECEIVED, 1);
  if (first) tell(p, FJR_MOVING, 0);
  return go_on(p, now);
}

int fjr_lock_step_tick(void* self, int64_t now, int64_t* next) {
  struct fjr_plant* p = self;
  *next = now + FJR_RESEND_PERIOD / 2;
  if (p->fault || !is_running(p)) return p->fault;
  if (p->awaited == FJR_NO_TIME) return go_on(p, now);
  if (p->heard && p->timeout && now - p->first_sent_at > p->timeout) return failed(p, FJR_UNANSWERED);
  return now - p->sent_at >= FJR_RESEND_PERIOD ? send_again(p, now) : 0;
}

int fjr_lock_step_restart(struct fjr_plant* p, int64_t now) {
  p->heard = p->holds = 0;
  p->awaited = p->other = FJR_NO_TIME;
  p->newest = 0;
  p->sent_at = p->first_sent_at = now;
  if (p->fault || measure(p)) return p->fault;
  return is_running(p) ? send_first(p, now) : 0;
}

int fjr_lock_step_resume(struct fjr_plant* p, int64_t now) {
  p->first_sent_at = now;
  if (p->fault) return p->fault;
  return p->awaited == FJR_NO_TIME ? go_on(p, now) : send_again(p, now);
}

int fjr_lock_step_catch_up(struct fjr_plant* p, int64_t now) {
  (void)p, (void)now; /* robot time stands still between two samples */
  return 0;
}

int fjr_lock_step_advance(struct fjr_plant* p, int64_t now) { return fjr_lock_step_resume(p, now); }
