/* SPDX-License-Identifier: Apache-2.0
 * What real time and lock-step share: integration with commands in transit, samples, counters.
 *
 * An effort acts until the next one, at most for command_timeout of robot time; then the effort is zero.
 */
#define PERIOD_OF_REPORTS 1000000000

/* A sample: stamp, 1 for measured velocities, then `measured` of the robot. */
#define SAMPLE_STAMP 0
#define SAMPLE_VELOCITIES 1
#define SAMPLE_VALUES 2

static int failed(struct fjr_plant* p, int fault) {
  if (fault && !p->fault) p->fault = fault;
  return p->fault;
}

/* Keep an event for Python, or call it if the plant needs the result or the time stands still. */
static int tell(struct fjr_plant* p, int32_t event, int64_t value) {
  if (!p->notes || event == FJR_FIRST_ANSWER || event == FJR_ADVANCED || event == FJR_SECOND)
    return p->notify(event, value);
  struct fjr_note* note = fjr_ring_free(p->notes, 0);
  if (!note) return 0;
  note->event = event, note->value = value;
  fjr_ring_commit(p->notes);
  return 0;
}

/* Python reads counters, and the stamp that was shown last, while the thread of a host writes them. */
static void count(struct fjr_plant* p, int32_t counter, int64_t more) {
  __atomic_store_n(&p->count[counter], p->count[counter] + more, __ATOMIC_RELAXED);
}

static void show(struct fjr_plant* p, int64_t stamp) { __atomic_store_n(&p->shown, stamp, __ATOMIC_RELAXED); }

/* Count an unwanted event, and notify Python of the first one. */
static void unwanted(struct fjr_plant* p, int32_t counter) {
  count(p, counter, 1);
  if (p->count[counter] == 1) tell(p, FJR_COUNTED, counter);
}

static int refuse(struct fjr_plant* p, int reading, const uint8_t* data, size_t size) {
  fjr_refuse(p->refusals, reading, data, size);
  return p->fault;
}

static int64_t stamp_of(const struct fjr_plant* p) { return p->offset + p->robot->time; }

static int is_running(const struct fjr_plant* p) { return !p->paused || p->left > 0; }

/* Report once per second of stamps. */
static void passed(struct fjr_plant* p, int64_t stamp) {
  const int64_t since = stamp - p->reported;
  show(p, stamp);
  if (p->by_stamps && (since < 0 || since >= PERIOD_OF_REPORTS)) {
    p->reported = stamp;
    tell(p, FJR_SECOND, stamp);
  }
}

/* Count one sample of an advance. */
static void count_sample(struct fjr_plant* p) {
  if (p->left && --p->left == 0) tell(p, FJR_ADVANCED, 0);
}

/* Apply an effort from the present robot time on. */
static void apply(struct fjr_plant* p, const double* effort) {
  memcpy(p->robot->u, effort, (size_t)p->robot->n * sizeof(double));
  p->last_command = p->robot->time;
}

/* Take a command, which acts from the last inner step at or before a robot time on, later by its channel delay. A newer
 * one replaces it if it has not acted by then. */
static void take_effort(struct fjr_plant* p, int64_t time, const double* effort) {
  if (p->commands->on) {
    fjr_channel_push(p->commands, time, effort);
  } else if (time - p->robot->time < p->robot->inner_step) {
    apply(p, effort);
    p->acts_at = FJR_NO_TIME;
  } else {
    memcpy(p->coming, effort, (size_t)p->robot->n * sizeof(double));
    p->acts_at = time;
  }
}

static int advance(struct fjr_plant* p, int64_t time) { return failed(p, fjr_robot_advance(p->robot, time)); }

/* Advance the robot without a new command. */
static int integrate_held(struct fjr_plant* p, int64_t time) {
  struct fjr_robot* r = p->robot;
  const int64_t expiry = p->last_command + p->command_timeout;
  if (time > expiry && any(r->u, r->n)) {
    if (advance(p, expiry)) return p->fault;
    memset(r->u, 0, (size_t)r->n * sizeof(double));
    unwanted(p, FJR_TIMED_OUT);
  }
  return advance(p, time);
}

/* Advance the robot; commands in transit take effect at their instants. */
static int integrate(struct fjr_plant* p, int64_t time) {
  const double* effort;
  if (p->acts_at <= time) {
    if (integrate_held(p, p->acts_at)) return p->fault;
    apply(p, p->coming);
    p->acts_at = FJR_NO_TIME;
  }
  while (p->commands->on && fjr_channel_next(p->commands) <= time && p->commands->count) {
    const int64_t instant = fjr_channel_next(p->commands);
    if (integrate_held(p, instant)) return p->fault;
    while ((effort = fjr_channel_pop(p->commands, instant))) apply(p, effort);
  }
  return integrate_held(p, time);
}

static int send_message(struct fjr_plant* p, int32_t output, const struct fjr_message* message) {
  return failed(p, p->send(p->host, output, message) ? FJR_NOT_SENT : FJR_NO_FAULT);
}

/* Show what the obstacle does to the arm while they touch, and once zero. */
static int show_contact(struct fjr_plant* p, int64_t stamp) {
  const int touched = p->touched;
  if (!p->contact) return 0;
  p->touched = any(p->robot->contact, p->robot->n + 6);
  if (!touched && !p->touched) return 0;
  fjr_put_stamp(p->contact, stamp);
  fjr_put_numbers(p->contact, FJR_FIELDS - 1, p->robot->contact);
  return send_message(p, FJR_CONTACT, p->contact);
}

/* Measure into p->sample. */
static int take_sample(struct fjr_plant* p) {
  const int64_t stamp = stamp_of(p);
  if (failed(p, fjr_robot_measure(p->robot))) return p->fault;
  memcpy(&p->sample[SAMPLE_STAMP], &stamp, sizeof stamp);
  p->sample[SAMPLE_VELOCITIES] = p->robot->sensors->velocities;
  memcpy(p->sample + SAMPLE_VALUES, p->robot->measured, 6 * (size_t)p->robot->n * sizeof(double));
  return show_contact(p, stamp);
}

static int64_t sample_stamp(const double* sample) {
  int64_t stamp;
  memcpy(&stamp, &sample[SAMPLE_STAMP], sizeof stamp);
  return stamp;
}

static struct fjr_message* message_of(const struct fjr_plant* p, const double* sample) {
  return p->state[sample[SAMPLE_VELOCITIES] != 0.0];
}

static int send_sample(struct fjr_plant* p, const double* sample) {
  struct fjr_message* message = message_of(p, sample);
  const int32_t n = p->robot->n;
  fjr_put_stamp(message, sample_stamp(sample));
  for (int32_t field = 0; field < FJR_FIELDS; ++field)
    if (message->length[field]) fjr_put_numbers(message, field, sample + SAMPLE_VALUES + 2 * n * field);
  count(p, FJR_PUBLISHED, 1);
  return send_message(p, FJR_STATE, message);
}
