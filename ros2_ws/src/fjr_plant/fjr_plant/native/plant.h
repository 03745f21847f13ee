/* SPDX-License-Identifier: Apache-2.0
 * Time bases of the simulated robot: commands in, states out, in real time or in lock-step.
 *
 * A host calls one function per message and per tick, and the others between them, from one thread at a time. It
 * supplies `send`. Times are of the host's clock [ns]; a sample has the stamp `offset` + robot time.
 * Functions that return int return an enum fjr_fault; after a fault the plant does nothing more.
 */
#ifndef FJR_PLANT_H
#define FJR_PLANT_H

enum fjr_constant {
  FJR_LONGEST_BACKLOG = 50000000,  /* [ns] longest time integrated at once: no controller acts meanwhile */
  FJR_LARGEST_LAG = 1000000000,    /* [ns] largest lag of the stamps behind the clock due to lost time */
  FJR_RESEND_PERIOD = 100000000,   /* [ns] a state without a command is sent again */
  FJR_MOST_SILENT = 1000           /* samples without a state to send before the host handles other events */
};

/* Counters of a plant. */
enum fjr_counter {
  FJR_PUBLISHED,
  FJR_RECEIVED,
  FJR_SKIPPED,
  FJR_NO_ANSWER,
  FJR_SENT_AGAIN,
  FJR_OTHER_ANSWER,
  FJR_TIMED_OUT,
  FJR_TIME_LOST,
  FJR_JUMPED_BACK,
  FJR_COUNTERS
};

/* Rare events of which Python is notified. */
enum fjr_event {
  FJR_COUNTED,         /* first count of an unwanted event; value: its enum fjr_counter */
  FJR_MOVING,          /* the first command since a start or a reset has arrived */
  FJR_FIRST_ANSWER,    /* lock-step: the first command is about to be accepted; a result other than 0 is a fault */
  FJR_ADVANCED,        /* the samples of an advance have passed */
  FJR_SECOND           /* a second of stamps has passed; value: stamp */
};

/* An event for which the plant does not wait. */
struct fjr_note {
  int64_t event, value;
};

/* Messages to send. */
enum fjr_output { FJR_STATE, FJR_CONTACT, FJR_CLOCK, FJR_OUTPUTS };

struct fjr_plant {
  struct fjr_robot* robot;
  struct fjr_channel *states, *commands; /* items: a sample (struct sample of time_base.c); an effort (n) */
  struct fjr_sample_times* times;
  struct fjr_joint_reader* answer;     /* reader of named commands */
  struct fjr_message* state[2];        /* without and with velocities */
  struct fjr_message* contact;         /* NULL without an obstacle */
  struct fjr_message* clock;
  double* sample;                      /* (2 + 6n) */
  double* held;                        /* (2 + 6n) lock-step: first sample, sent when the robot runs */
  double* effort;                      /* (n) */
  double* coming;                      /* (n) command that acts from the inner step at or before acts_at on */
  void* host;
  int (*send)(void* host, int32_t output, const struct fjr_message* message);
  void (*settle)(void* host, int32_t output); /* wait until subscribers have received what was sent; NULL: do not */
  int (*notify)(int32_t event, int64_t value); /* Python */
  struct fjr_ring* notes;              /* struct fjr_note: events that wait for Python, NULL: none does */

  int32_t fault;
  int32_t paused, by_stamps;           /* by_stamps: 1: notify FJR_SECOND */
  int32_t touched;                     /* the obstacle, at the last sample */
  int64_t offset;                      /* stamp of robot time 0 */
  int64_t command_timeout, last_command;
  int64_t acts_at;                     /* robot time, FJR_NO_TIME: `coming` has acted */
  int64_t left;                        /* samples of an advance */
  int64_t reported, shown;             /* stamps of the last FJR_SECOND and of the last sample */
  int64_t count[FJR_COUNTERS];
  struct fjr_refusals* refusals;       /* commands */

  /* Real time. */
  int32_t simulated;                   /* 1: the host's clock is the node's; 0: it is the steady clock */
  int32_t wait_for_command, started, waiting, answered;
  int64_t silence, quiet_until;
  int64_t origin;                      /* clock time of robot time 0, FJR_NO_TIME while that stands still */
  int64_t latest;                      /* clock time */
  int64_t lag, newest, first_tick, ticks, late_at;
  int64_t between;                     /* time at which a state leaves between two ticks, FJR_NO_TIME for none */

  /* Lock-step; stamps are FJR_NO_TIME for none. */
  int32_t heard, holds;                /* heard: a command was accepted; holds: `held` is to be sent */
  int64_t timeout;                     /* 0: none */
  int64_t awaited, other;              /* stamps of the state without a command, of the last other command */
  int64_t sent_at, first_sent_at;      /* steady clock */
  int64_t times_shown;
};

/* Real time, then the same functions in lock-step. command, tick: of struct fjr_callbacks; self: struct fjr_plant.
 * catch_up: integrate up to the present. restart: with the robot at its initial state. resume: after a pause. advance: by
 * the samples `left`. */
int fjr_real_time_command(void* self, int32_t source, const uint8_t* data, size_t size, int64_t now, int64_t* next);
int fjr_real_time_tick(void* self, int64_t now, int64_t* next);
int fjr_real_time_catch_up(struct fjr_plant* plant, int64_t now);
int fjr_real_time_restart(struct fjr_plant* plant, int64_t now);
int fjr_real_time_resume(struct fjr_plant* plant, int64_t now);
int fjr_real_time_advance(struct fjr_plant* plant, int64_t now);

int fjr_lock_step_command(void* self, int32_t source, const uint8_t* data, size_t size, int64_t now, int64_t* next);
int fjr_lock_step_tick(void* self, int64_t now, int64_t* next);
int fjr_lock_step_restart(struct fjr_plant* plant, int64_t now);
int fjr_lock_step_resume(struct fjr_plant* plant, int64_t now);
int fjr_lock_step_catch_up(struct fjr_plant* plant, int64_t now);
int fjr_lock_step_advance(struct fjr_plant* plant, int64_t now);

#endif
