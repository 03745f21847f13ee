/* SPDX-License-Identifier: Apache-2.0
 * The command loop: JointState -> struct fjr_sample -> fjr_step -> both command topics.
 *
 * A host calls one function per message, per tick and per request, from one thread at a time: a native thread (loop.h),
 * or rclpy's executor. It supplies `publish` and `pause`.
 * The controller belongs to the loop while it runs. Python changes it by requests, and reads a copy.
 */
#ifndef FJR_CONTROLLER_LOOP_H
#define FJR_CONTROLLER_LOOP_H


/* Functions of the control step (step.h). */
struct fjr_step_functions {
  int (*step)(const struct fjr_model*, struct fjr_controller*, const struct fjr_sample*, int64_t, struct fjr_command*);
  void (*check_wiring)(const struct fjr_model*, struct fjr_controller*);
  int (*silence)(const struct fjr_model*, struct fjr_controller*, int64_t, double*);
  void (*stop_effort)(const struct fjr_model*, struct fjr_controller*, double*);
  void (*start)(struct fjr_controller*, const struct fjr_reference*);
  void (*apply)(struct fjr_controller*, const struct fjr_settings*);
  void (*use_gains)(struct fjr_controller*, const double*, const double*);
  void (*follow)(struct fjr_controller*, const struct fjr_reference*, int64_t);
  void (*hold)(struct fjr_controller*);
  void (*resume)(struct fjr_controller*);
  int (*certify)(struct fjr_certificate*, const struct fjr_command*, int64_t, struct fjr_certified*);
  void (*certificate_restart)(struct fjr_certificate*);
  int (*observe_torque)(struct fjr_torque_observer*, const struct fjr_model*, struct fjr_controller*,
                        const struct fjr_sample*, double*);
  int (*is_due)(struct fjr_auxiliary_rate*, int64_t);
  int64_t (*waits_until)(const struct fjr_controller*);
};

/* Messages to publish. */
enum fjr_controller_output {
  FJR_EFFORTS, FJR_COMMANDS, FJR_REFERENCES, FJR_ERRORS, FJR_TORQUES, FJR_CONTACT_TORQUES, FJR_CERTIFICATES,
  FJR_OUTPUTS
};

/* Requests, with an argument of type struct fjr_arguments; after each the copy of the controller is up to date.
 * FJR_DO_CHECK_SILENCE: `time` is of the clock of the stamps. FJR_DO_SEND_STOP: the stop effort, if a command was sent.
 * FJR_DO_RECERTIFY: `second` is beta; `first` are gains with which the certificate starts again, 0: it goes on. */
enum fjr_controller_request {
  FJR_DO_COPY, FJR_DO_START, FJR_DO_APPLY, FJR_DO_USE_GAINS, FJR_DO_FOLLOW, FJR_DO_HOLD, FJR_DO_RESUME,
  FJR_DO_CHECK_SILENCE, FJR_DO_SEND_STOP, FJR_DO_RECERTIFY
};

struct fjr_arguments {
  const void *first, *second;
  int64_t time;
};

/* Whether nobody else commands the robot. At the first state the loop looks for publishers on the command topics that
 * Python does not know; if there are some, it answers nothing until Python, which listens to them, is sure. */
enum fjr_alone { FJR_UNASKED, FJR_NOT_ALONE, FJR_ALONE };

/* A sample that was answered. sent: when its command had been published (steady clock). */
struct fjr_record {
  int64_t arrival, sent;
  struct fjr_sample sample;
  struct fjr_command command;
  struct fjr_certified certified; /* only if the loop has a certificate */
};

struct fjr_controller_loop {
  /* Of the host; an enum fjr_outcome. pause: wait for Python to take records. */
  void* host;
  int (*publish)(void* host, int32_t output, const struct fjr_message* message);
  int (*pause)(void* host);
  int (*has_others)(void* known); /* 1 if unknown publishers command the robot, or may do so */
  void* known;
  const char* reason; /* of FJR_FAILED, 0 if it is the host's */
  struct fjr_step_functions step;
  const struct fjr_model* model;
  struct fjr_controller *controller, *copy;
  struct fjr_joint_reader* reader; /* links, then motors; links only if the motor side is measured by torque */
  struct fjr_ring* records;
  struct fjr_refusals* refusals;
  struct fjr_certificate* certificate; /* 0: none */
  struct fjr_torque_observer* observer;
  struct fjr_message *effort, *command, *reference, *error, *torque, *contact, *certified;
  int32_t alone;                        /* atomic, an enum fjr_alone */
  int32_t simulated, sends;             /* sends: a command was sent, and no last one after a failure */
  int64_t silence_period, since; /* ns; since: arrival of the first state that is answered (steady clock) */
  int64_t silence_check;         /* time of the next one (steady clock) */
  int32_t postponed;             /* the last check was put off */
  struct fjr_auxiliary_rate auxiliary;
  int64_t received, answered, last_stamp;
  struct fjr_sample sample;
  struct fjr_command result;
  uint64_t waiting;         /* samples in the queue that are not certified and handed over yet */
  struct fjr_record spare;  /* of a sample that has no place in the queue */
};

/* Those of struct fjr_callbacks; self: struct fjr_controller_loop. */
int fjr_controller_message(void* self, int32_t source, const uint8_t* data, size_t size, int64_t arrival,
                           int64_t* next);
int fjr_controller_tick(void* self, int64_t now, int64_t* next);
int fjr_controller_request(void* self, int32_t kind, void* argument);
void fjr_controller_end(void* self, int32_t outcome);

#endif
