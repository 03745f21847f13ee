/* SPDX-License-Identifier: Apache-2.0
 * Real time: robot time follows the clock. A command acts from the first inner step at or after its arrival, a state
 * leaves at every tick.
 *
 * A stamp is the node time at which robot time started or resumed, plus the time integrated since. While waiting for
 * the first command, a state is stamped with the node time, and integration starts from the last such state. Stamps
 * never decrease. Robot time stands still while waiting, while paused, and while the clock stands still or is 0. After
 * a reset or a pause no state leaves for `silence`, so that a controller recovers instead of receiving a jump. If the
 * clock jumps forward or is too fast, or the process was paused, a backlog of more than FJR_LONGEST_BACKLOG is skipped:
 * the robot stood still meanwhile, instead of moving on under an old effort, and the stamps lag behind by that time, at
 * most FJR_LARGEST_LAG. If the clock jumps back, stamps continue from its new time and the motion
 * continues unchanged.
 */
#include <time.h>

static int64_t larger(int64_t a, int64_t b) { return a > b ? a : b; }
static int64_t smaller(int64_t a, int64_t b) { return a < b ? a : b; }

static int64_t node_time(const struct fjr_plant* p) {
  struct timespec now;
  if (p->simulated) return p->latest;
  clock_gettime(CLOCK_REALTIME, &now);
  return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

/* Restart the stamps from the node's clock; they never decrease. */
static void stamp_from_now(struct fjr_plant* p) {
  p->offset = larger(node_time(p), p->newest) - p->robot->time;
  p->lag = 0;
}

static void restart_ticks(struct fjr_plant* p, int64_t now) { p->first_tick = now, p->ticks = 0; }

/* Start, pause and resume. */

/* Restart the stamps, and robot time unless it waits for a command. */
static void start_motion(struct fjr_plant* p, int64_t now) {
  p->quiet_until = 0;
  restart_ticks(p, now);
  stamp_from_now(p);
  if (!p->waiting) p->origin = now - p->robot->time;
}

/* Resume states and robot time, after the silence if states left before. */
static void resume(struct fjr_plant* p, int64_t now) {
  p->origin = FJR_NO_TIME;
  p->quiet_until = p->newest && p->silence ? now + p->silence : 0;
  if (!p->paused && !p->quiet_until) start_motion(p, now);
}

static void restart(struct fjr_plant* p, int64_t now) {
  if (!p->started) return;
  p->answered = 1;
  p->waiting = p->wait_for_command;
  stamp_from_now(p);
  resume(p, now);
}

static void jump_back(struct fjr_plant* p, int64_t now) {
  const int64_t jump = now - p->latest;
  if (p->quiet_until) p->quiet_until = larger(p->quiet_until + jump, 1);
  if (p->late_at != FJR_NO_TIME) p->late_at += jump;
  p->offset = now - p->robot->time, p->newest = p->lag = 0;
  restart_ticks(p, now);
  if (p->origin != FJR_NO_TIME) p->origin = p->offset;
  unwanted(p, FJR_JUMPED_BACK);
}

/* Return the clock time; 0 before the first one, constant while the clock is 0 later. */
static int64_t read_clock(struct fjr_plant* p, int64_t now) {
  if (now <= 0) return p->latest;
  if (p->started && now < p->latest) jump_back(p, now);
  p->latest = now;
  if (!p->started) {
    p->started = 1;
    restart(p, now);
  }
  return now;
}

/* Return whether states leave and commands are applied; end an elapsed silence. */
static int is_active(struct fjr_plant* p, int64_t now) {
  if (p->fault || p->paused || !p->started || now < p->quiet_until) return 0;
  if (p->quiet_until) start_motion(p, now);
  return 1;
}

/* Integrate up to the present. */
static int catch_up(struct fjr_plant* p, int64_t now) {
  if (p->fault || p->origin == FJR_NO_TIME || p->paused || !p->started) return p->fault;
  int64_t elapsed = now - p->origin;
  const int64_t lost = elapsed - p->robot->time - FJR_LONGEST_BACKLOG;
  if (lost > 0) { /* too slow for the clock: skip the rest */
    p->origin += lost, p->lag += lost, elapsed -= lost;
    unwanted(p, FJR_TIME_LOST);
  }
  if (integrate(p, elapsed)) return p->fault;
  if (p->lag > FJR_LARGEST_LAG) stamp_from_now(p);
  return 0;
}

/* States out. */

static int send_state(struct fjr_plant* p, const double* sample) {
  if (!p->answered) count(p, FJR_NO_ANSWER, 1);
  p->answered = p->waiting;
  if (send_sample(p, sample)) return p->fault;
  passed(p, sample_stamp(sample));
  return 0;
}

/* Send the states that have arrived by `elapsed` of robot time. */
static int send_arrived(struct fjr_plant* p, int64_t elapsed) {
  const double* sample;
  while (p->states->on && (sample = fjr_channel_pop(p->states, elapsed)))
    if (send_state(p, sample)) return p->fault;
  return 0;
}

static int publish_sample(struct fjr_plant* p) {
  if (p->origin == FJR_NO_TIME && !p->paused) stamp_from_now(p);
  if (take_sample(p)) return p->fault;
  p->newest = larger(sample_stamp(p->sample), p->newest);
  if (!p->states->on || p->waiting) return send_state(p, p->sample); /* without errors until the first command */
  fjr_channel_push(p->states, p->robot->time, p->sample);
  return send_arrived(p, p->robot->time);
}

static int late_sample(struct fjr_plant* p, int64_t now) {
  p->late_at = FJR_NO_TIME;
  return is_active(p, now) && !catch_up(p, now) ? publish_sample(p) : p->fault;
}

static int tick(struct fjr_plant* p, int64_t now, int64_t due) {
  count(p, FJR_SKIPPED, larger(0, due - p->ticks - 1));
  p->ticks = larger(due, p->ticks);
  const int64_t late = p->times->jitter > 0.0 ? fjr_sample_times_next(p->times) % p->times->period : 0;
  if (!late) return late_sample(p, now);
  p->late_at = now + late;
  return 0;
}

/* Return the number of ticks up to now; a tick may come early or late by half a period. */
static int64_t ticks_due(const struct fjr_plant* p, int64_t now) {
  return (now - p->first_tick + p->times->period / 2) / p->times->period;
}

static int64_t next_tick(const struct fjr_plant* p) { return p->first_tick + (p->ticks + 1) * p->times->period; }

/* Return the clock time at which the next state in transit arrives. */
static int64_t next_arrival(const struct fjr_plant* p) {
  const int64_t due = p->states->on ? fjr_channel_next(p->states) : FJR_NO_TIME;
  return due == FJR_NO_TIME || p->origin == FJR_NO_TIME || p->paused ? FJR_NO_TIME : p->origin + due;
}

int fjr_real_time_tick(void* self, int64_t time, int64_t* next) {
  struct fjr_plant* p = self;
  const int64_t now = read_clock(p, time);
  *next = now + p->times->period, p->between = FJR_NO_TIME;
  if (!is_active(p, now)) return p->fault;
  if (p->late_at <= now && late_sample(p, now)) return p->fault;
  const int64_t due = ticks_due(p, now);
  if ((due > p->ticks || now == p->first_tick) && tick(p, now, due)) return p->fault;
  if (next_arrival(p) <= now && send_arrived(p, now - p->origin)) return p->fault;
  p->between = smaller(p->late_at, next_arrival(p));
  *next = smaller(next_tick(p), p->between);
  return 0;
}

/* Commands in. */

int fjr_real_time_command(void* self, int32_t source, const uint8_t* data, size_t size, int64_t time, int64_t* next) {
  struct fjr_plant* p = self;
  (void)source, (void)next;
  const int reading = fjr_read_array(p->effort, p->robot->n, data, size);
  if (reading != FJR_READ) return refuse(p, reading, data, size);
  count(p, FJR_RECEIVED, 1);
  const int64_t now = read_clock(p, time);
  if (!is_active(p, now)) return p->fault;
  p->answered = 1;
  if (!p->waiting) {
    if (catch_up(p, now)) return p->fault;
    take_effort(p, now - p->origin + p->robot->inner_step - 1, p->effort); /* no inner step that began before acts */
    return 0;
  }
  p->waiting = 0, p->origin = now - p->robot->time; /* the last published state is that of the present robot time */
  take_effort(p, p->robot->time, p->effort);        /* acts from the first instant of motion */
  tell(p, FJR_MOVING, 0);
  return 0;
}

/* Requests of the host. */

int fjr_real_time_catch_up(struct fjr_plant* p, int64_t time) { return catch_up(p, read_clock(p, time)); }

int fjr_real_time_restart(struct fjr_plant* p, int64_t time) {
  restart(p, read_clock(p, time));
  return p->fault;
}

int fjr_real_time_resume(struct fjr_plant* p, int64_t time) {
  const int64_t now = read_clock(p, time);
  resume(p, now);
  return p->fault;
}

int fjr_real_time_advance(struct fjr_plant* p, int64_t time) {
  (void)time; /* all samples at once, under the held effort */
  while (p->left && !p->fault) {
    if (integrate(p, p->robot->time + p->times->period) || publish_sample(p)) return p->fault;
    count_sample(p);
  }
  return p->fault;
}
