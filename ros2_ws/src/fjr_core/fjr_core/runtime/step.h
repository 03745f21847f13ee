/* SPDX-License-Identifier: Apache-2.0
 * The control step: everything between a measured state and the effort that is sent.
 *
 *   sample -> order of the stamps -> measured state -> supervisor (wiring, reference, limits of the state)
 *          -> law or stop policy -> bumpless transfer -> effort limits -> rate limits -> u, then wiring check
 *
 * Every host calls this text: the nodes, the studies, the exported C and the ros2_control controller. C99 without
 * allocation, locks and static memory: a controller is one struct fjr_controller, which may be copied. Not thread-safe:
 * one thread calls all functions of a controller.
 *
 * Defined before: FJR_N, the number of joints, and FJR_MEMORY, the length of the controller state of the law, at least
 * 1. Arrays of links come before those of motors. Times: stamps and durations in ns unless a unit is given.
 */
#ifndef FJR_STEP_H
#define FJR_STEP_H

#include <stdint.h>

#define FJR_JETS 5 /* q_ld .. d4q_ld */
#define FJR_POWERS 10 /* coefficients of a polynomial of degree 9 */
#define FJR_EVENTS 128
#define FJR_WINDOW 21    /* states that the check of the wiring compares, at most .. */
#define FJR_INTERVALS 20 /* .. and the intervals between them */
#define FJR_MOTION 5     /* polynomials of time that describe motion in them */
#define FJR_PIECES 16    /* parabolas of a torsion curve, at most */
#define FJR_NEVER INT64_MIN /* no stamp */

/* A function in C as CasADi writes it: results in res[i], entries of arg and res may be 0; not 0: it failed. */
typedef int (*fjr_function)(const double** arg, double** res, long long int* iw, double* w, int mem);

/* ---- Reference ------------------------------------------------------------------------------------------------- */

enum fjr_reference_kind { FJR_HOLD, FJR_SINES, FJR_POLYNOMIALS, FJR_CIRCLE, FJR_FUNCTION };

/* A piecewise polynomial: entry i = 0 .. edges applies from edge i - 1 up to edge i, in s = (t - origin) rate. */
struct fjr_polynomials {
  int64_t edges;
  const double *edge, *origin, *rate; /* (edges), (edges + 1), (edges + 1) */
  const double* coefficients;         /* (edges + 1, FJR_POWERS, FJR_JETS, joints) */
};

/* A reference q_ld(t); t [s] is its own time. The arrays outlive the controller.
 *
 * FJR_HOLD: q = position. FJR_SINES: position + the sum of `terms` rows amplitude sin(frequency t + phase).
 * FJR_POLYNOMIALS: periodic if period > 0 [s], constant before 0. FJR_CIRCLE: position + radius (cos, sin) of the angle,
 * a polynomial of one joint, in the plane of the first two joints. FJR_FUNCTION: jets(context, t, .).
 * then: from the time `until` [s] on the reference is `then`, in the same time. shift [s]: its time 0 on that of the
 * reference that it continues, or on t.
 */
struct fjr_reference {
  int32_t kind;
  double shift, end; /* end [s]: constant from then on, may be infinite */
  double position[FJR_N];
  int64_t terms;
  const double *amplitude, *frequency, *phase; /* (terms, FJR_N) */
  struct fjr_polynomials polynomials;
  double period, radius;
  void (*jets)(void* context, double t, double* jets); /* (FJR_JETS, FJR_N) */
  void* context;
  double until;
  const struct fjr_reference* then;
};

/* ---- Settings and model ---------------------------------------------------------------------------------------- */

enum fjr_reaction { FJR_REPORT, FJR_STOP, FJR_YIELD };

/* Limits, durations and stop policy; a limit is infinite where there is none (runtime/safety_settings.py). */
struct fjr_settings {
  double effort[FJR_N], effort_rate[FJR_N]; /* N m, N m/s */
  double lower[6 * FJR_N], upper[6 * FJR_N]; /* of q_l, q_m, dq_l, dq_m, q_m - q_l, q_l - q_ld */
  double start_error[FJR_N];                 /* rad */
  int64_t state_timeout;
  double ramp_time, start_join_time, recovery_join_time, recovery_longest_gap; /* s */
  double acceleration[FJR_N], hold_deceleration; /* rad/s^2 */
  int32_t gravity_hold;                                  /* stop policy: 1 gravity compensation, 0 no effort */
  int32_t on_contact;                                    /* an enum fjr_reaction */
  int32_t wiring_check;                                  /* needs `dynamics` of the model, and no observer */
  double B_inverse[FJR_N * FJR_N];                       /* B_m^-1 by rows */
  double hold_damping[FJR_N * FJR_N];                    /* K_md by rows [N m s/rad] */
};

/* What does not change while the controller runs, with the work space of the functions. */
struct fjr_model {
  fjr_function law;      /* (position, velocity, jets, gains, memory, sent, dt) -> u, V, next */
  fjr_function gravity;  /* q_l -> grad P_l */
  fjr_function observer; /* (x_hat, y, u, dt, gain) -> x_hat; 0: the velocities are measured */
  fjr_function dynamics; /* (q_l, dq_l) -> M_l, C dq_l; of the check of the wiring, 0: none */
  int32_t has_memory;    /* the law has a controller state */
  int32_t simulated;     /* simulated time: stamps are the time, see stamps.c */
  int64_t lead;          /* the reference is evaluated this long after the stamp */
  double bandwidth;      /* of the observer [rad/s] */
  double memory[FJR_MEMORY]; /* the first controller state of the law */
  double gear_ratio[FJR_N];  /* motor angle of a sample / q_m */
  int32_t torque;                      /* the motor side of a sample is the joint torque [N m], q_m = q_l + K^-1 tau */
  double compliance[FJR_N * FJR_N];    /* K^-1 by rows [rad/(N m)] */
  double K[FJR_N * FJR_N], M_m[FJR_N * FJR_N], B_m[FJR_N * FJR_N]; /* by rows, of the check of the wiring */
  double D_l[FJR_N * FJR_N], D_m[FJR_N * FJR_N];
  int32_t slides[FJR_N];                                     /* 1: a prismatic joint, in m and N */
  double cubic[FJR_N]; /* of springs K zeta + cubic zeta^3, whose K is diagonal [N m/rad^3] */
  int32_t pieces; /* of torsion curves (model/springs.py), 0: none; fields of these pieces by rows: */
  double edge[FJR_PIECES * FJR_N], torsion[FJR_PIECES * FJR_N]; /* rad, N m */
  double tangent[FJR_PIECES * FJR_N], bend[FJR_PIECES * FJR_N]; /* N m/rad, N m/rad^2 */
  const double** arg; /* work space of the functions */
  double** res;
  long long int* iw;
  double* w;
};

/* ---- Sample and command ---------------------------------------------------------------------------------------- */

/* A measured state as it arrives. stamp: between -2^61 and 2^61 ns (73 years), as differences of stamps are counted in 64
 * bits. motor: angle before the gear, or joint torque. velocity: not read with an observer. */
struct fjr_sample {
  int64_t stamp;
  double link[FJR_N], motor[FJR_N];
  double velocity[2 * FJR_N]; /* dq_l, dq_m times the gear ratio */
};

enum fjr_state { FJR_WAITING, FJR_JOINING, FJR_TRACKING, FJR_STOPPED };

/* The command for a sample; see runtime/control_step.py. */
struct fjr_command {
  double u[FJR_N], V;
  double jets[FJR_JETS * FJR_N];
  double position[2 * FJR_N], velocity[2 * FJR_N]; /* at which the law was evaluated */
  int32_t state, restarted;
  int64_t bound_start; /* stamp from which the bound on V holds; FJR_NEVER: no bound */
};

/* ---- Events and counters --------------------------------------------------------------------------------------- */

/* What is counted; an event has the kind of its counter. The names stand in events.py, in this order. */
enum fjr_kind {
  FJR_STATES_OLDER, FJR_STATES_STALE, FJR_STATES_LATE, FJR_STATES_REPEATED, FJR_STATES_FROZEN, FJR_JUMPS_DOUBTED,
  FJR_REFERENCE_RESTARTS, FJR_SILENCES, FJR_FORWARD_JUMPS,
  FJR_OBSERVER_RESTARTS, FJR_RECOVERIES, FJR_STARTS_REFUSED, FJR_STOPS, FJR_STOPS_WIRING, FJR_STOPS_LINK_POSITION,
  FJR_STOPS_MOTOR_POSITION, FJR_STOPS_LINK_VELOCITY, FJR_STOPS_MOTOR_VELOCITY, FJR_STOPS_DEFLECTION,
  FJR_STOPS_TRACKING_ERROR, FJR_STOPS_POSITION_JUMP, FJR_STOPS_CONTACT, FJR_STOPS_NO_MOTION,
  FJR_STOPS_SILENCE, FJR_STOPS_LAW, FJR_RESUMES, FJR_EFFORTS_NOT_FINITE, FJR_EFFORTS_SATURATED,
  FJR_EFFORTS_RATE_LIMITED, FJR_GAINS_CHANGED, FJR_SETTINGS_CHANGED, FJR_REFERENCES_CHANGED, FJR_HOLDS, FJR_CONTACTS,
  FJR_KINDS
};

/* detail: of a stop the counter of its cause, FJR_STOPS_WIRING .. FJR_STOPS_LAW; of a saturation, a contact or frozen
 * states the joints as bits. joint: -1 for none. value, limit: NaN for none; of a recovery and of a silence `value` is
 * the duration [s]. below: value < limit was found. */
struct fjr_event {
  int32_t kind, detail, joint, below;
  int64_t stamp;
  double value, limit;
};

enum fjr_wiring_kind {
  FJR_EFFORT_SIGN, FJR_EFFORTS_EXCHANGED, FJR_ENCODER_SIGN, FJR_ENCODERS_EXCHANGED, FJR_VELOCITY_SIGN,
  FJR_VELOCITY_OF_ANOTHER
};

/* A fault of the wiring; its sentence is in runtime/events.py. count: number of joints, 0 for no fault. The velocity of
 * the first joint may be that of the second. */
struct fjr_wiring_fault {
  int32_t kind, side, count; /* side: 0 link, 1 motor */
  int32_t joint[FJR_N + 1];
};

struct fjr_journal {
  int64_t count[FJR_KINDS], saturated[FJR_N];
  int64_t events; /* written so far; event k is at event[k % FJR_EVENTS] */
  struct fjr_event event[FJR_EVENTS];
  struct fjr_wiring_fault wiring; /* of the last stop for the wiring */
  int32_t saturation, not_finite, frozen, late; /* an episode is on */
};

/* ---- Controller ------------------------------------------------------------------------------------------------ */

/* Order of a sample relative to the last accepted one; see stamps.c. */
enum fjr_order {
  FJR_FIRST, FJR_NEXT, FJR_REPEATED, FJR_OLDER, FJR_BACK, FJR_FORWARD, FJR_LATE, FJR_DOUBTED, FJR_GAP, FJR_STALE
};

struct fjr_stamps {
  int64_t last, arrival, unconfirmed; /* FJR_NEVER for none */
  int64_t interval;                   /* between the last two, 0: unknown */
  int64_t waiting, waiting_since;     /* stamp, FJR_NEVER for none, and arrival of a sample that waits for a newer one */
  int64_t usual_age;                  /* arrival - stamp of samples that did not wait */
  int64_t least_age;                  /* of the time line, but for a drift of the clocks */
  int64_t falling_since, age;         /* arrival and age of the sample with which the look at the age began */
  int64_t gap, gap_end;               /* length of the last gap; stamp of its end, FJR_NEVER for none */
  int64_t timeout;
  int32_t silent;
};

/* values: q_l, q_m, dq_l, dq_m, q_m - q_l, q_l - q_ld. */
struct fjr_measured {
  double values[6 * FJR_N];
  double link[FJR_N], change[FJR_N]; /* link positions of the sample; what they have changed by since the last one */
  double x_hat[4 * FJR_N]; /* of the observer */
  int64_t stamp;           /* of the observer, FJR_NEVER: it starts with the next sample */
  int32_t k;               /* samples since the observer started */
};

/* One polynomial of degree 9 from t0 to t1 [s], each half about its own end, as fjr_polynomials. */
struct fjr_segment {
  double t0, t1;
  double edge[3], origin[4], rate[4];
  double coefficients[4 * FJR_POWERS * FJR_JETS * FJR_N];
};

/* Standstill from position and speed at t0 [s], each joint over its own duration; until t1 it is the reference. */
struct fjr_brake {
  double t0, t1;
  double position[FJR_N], speed[FJR_N], duration[FJR_N];
};

/* The reference that is tracked, on the time line of the stamps. */
struct fjr_active {
  struct fjr_reference held;              /* where the controller holds a position of its own */
  const struct fjr_reference* target;     /* 0: `held` */
  const struct fjr_reference* pending;    /* 0: none */
  int64_t zero, pending_start;            /* stamps of time 0; FJR_NEVER: not begun, at the next sample */
  int64_t transition_end;
  struct fjr_brake brake;                 /* before the transition */
  int32_t joins;                          /* `segment` leads to the target: 1 instead of it, 2 added to it */
  struct fjr_segment segment;
};

struct fjr_transfer {
  int32_t active, ramp, begun;
  int64_t start;
  double duration; /* s */
  double initial[FJR_N];
};

struct fjr_supervisor {
  struct fjr_active reference;
  struct fjr_transfer transfer;
  int64_t bound_start;
  int32_t stopped; /* 0, FJR_STARTS_REFUSED or the counter of the cause, FJR_STOPS_WIRING .. */
  int32_t settling, starting, joining, resuming, holding;
  int32_t yielding, returning; /* to a contact; from it, at the next sample */
};

struct fjr_law_state {
  double memory[FJR_MEMORY], next[FJR_MEMORY], sent[FJR_N], dt;
  int32_t evaluated, continues;
};

/* left: last effort sent. sent: the same within the present limits, from which the rate counts. */
struct fjr_effort_limits {
  double sent[FJR_N], left[FJR_N], seconds[FJR_N], seconds_any; /* s in saturation */
  int32_t saturated[FJR_N], clipped, slowed;
  int64_t stamp;
};

/* q_l: of the last valid sample. The motors at it, and how their velocities agree with the slopes, see stop_policy.c. */
struct fjr_stop_policy {
  double q_l[FJR_N], q_m[FJR_N], dq_m[FJR_N], agreed[FJR_N], size[FJR_N];
  int32_t known, released;
};

/* Comparison of a window with each hypothesis on the wiring, see wiring.c. Signals: encoders of links, then motors. */
struct fjr_comparison {
  double q[2 * FJR_N][FJR_INTERVALS], dq[2 * FJR_N][FJR_INTERVALS]; /* means over the intervals */
  double slope[2 * FJR_N][FJR_INTERVALS], ddq[2 * FJR_N][FJR_INTERVALS], change[2 * FJR_N][FJR_INTERVALS];
  double u[FJR_N][FJR_INTERVALS], ends[2][FJR_N];                      /* q_l of the first and of the last state */
  double motion[FJR_MOTION][FJR_INTERVALS];                            /* orthonormal polynomials of time */
  double q_noise[2 * FJR_N], dq_noise[2 * FJR_N], rate, constant[FJR_N]; /* variances, 1 / h^2, deviation */
  double misfit[2 * FJR_N], deviance[2 * FJR_N], squares[2 * FJR_N];     /* of links, then motors, as measured */
  double evidence, effort_evidence, other_evidence;
  struct fjr_wiring_fault best, best_effort;
  int32_t intervals, full, next; /* next hypothesis */
  int32_t suspected[2 * FJR_N];  /* encoders, then efforts, of each joint */
  int32_t agrees[4 * FJR_N];
};

/* Check of the wiring. A ring of states, and the comparison that goes on; waiting: a state was not compared yet. */
struct fjr_wiring {
  int64_t first, count, due; /* stamp of the first state; states so far, and at the next comparison */
  double t[FJR_WINDOW], q[FJR_WINDOW][2 * FJR_N], dq[FJR_WINDOW][2 * FJR_N], u[FJR_WINDOW][FJR_N];
  double constant[FJR_N]; /* standard deviation of constant torques [N m] */
  int32_t right[4 * FJR_N];
  struct fjr_wiring_fault fault; /* of the last comparison */
  int32_t has_constant, agreed, waiting, comparing, found, reported;
  struct fjr_comparison comparison;
};

/* Contact as the observer of external torques sees it. acting: at the last sample; heeded: the controller has reacted.
 * joints: as bits; joint, value, limit: of the one furthest beyond its threshold when it began; stamp: last seen. */
struct fjr_contact {
  int32_t acting, heeded, joints, joint;
  double value, limit;
  int64_t stamp;
};

struct fjr_controller {
  struct fjr_settings settings;
  const double* gains;
  const struct fjr_reference* start_reference;
  struct fjr_stamps stamps;
  struct fjr_measured measured;
  struct fjr_sample seen;  /* the last one, answered or not */
  int64_t changed[FJR_N];  /* stamp since which it has these values, for each joint */
  double driven[3][FJR_N]; /* then: torque of the effort; since then: speed and way of the motor by the model */
  struct fjr_supervisor supervisor;
  struct fjr_law_state law;
  struct fjr_effort_limits limits;
  struct fjr_stop_policy policy;
  struct fjr_contact contact;
  struct fjr_journal journal;
  int64_t stopped_time; /* time stopped */
  struct fjr_wiring wiring;
};

/* ---- Certificate ----------------------------------------------------------------------------------------------- */

/* Certificate of a sample and, if it follows another one within `longest`, the innovation of the interval between them.
 * V, H [J]; dV: rate of V under the effort that was sent, rate: its mean over the interval, supplied, dissipated [W];
 * bound on V [J], -1 for none. V0, law, older: storage, effort of the law and effort before the last at the start of
 * the interval. predicted: V at the state that the model predicts; error: measured minus predicted positions and
 * velocities. valid: it follows another sample, and its values are finite. */
struct fjr_certified {
  int32_t follows, valid;
  double dt, V, dV, rate, bound, H, supplied, dissipated;
  double V0, predicted;
  double sent[FJR_N], law[FJR_N], older[FJR_N], error[4 * FJR_N], slope[4 * FJR_N];
};

struct fjr_certificate {
  fjr_function certify; /* (position, velocity, jets, gains) -> V, H, dissipation, dissipated, u_law, drive, slope */
  fjr_function predict; /* (position, velocity, u, dt) -> next position, next velocity; 0: no innovations */
  fjr_function law;     /* (position, velocity, jets, gains) -> u, V; only called with `predict` */
  const double* gains;
  double B_m[FJR_N * FJR_N]; /* by rows */
  double longest;            /* s; two samples further apart are not compared */
  double beta;               /* [1/s] of the bound */
  int32_t bounded;           /* 0: V has no bound */
  const double** arg;        /* work space of the functions */
  double** res;
  long long int* iw;
  double* w;
  int32_t follows; /* the last sample may have a successor */
  int64_t stamp, bound_start;
  double V, dissipation, u_law[FJR_N], drive[FJR_N];
  double position[2 * FJR_N], velocity[2 * FJR_N], u[FJR_N], older[FJR_N], bound;
};

/* ---- External torque ------------------------------------------------------------------------------------------- */

/* kept, next (3, 1 + errors, FJR_N): momenta of the links, their rates and the estimated torques at the last sample, each
 * with its derivatives by the stated errors of the model; NaN: none. d (errors), P (errors, errors): mean and covariance
 * of the errors. compared: torques that these do not explain, and thresholds; S: covariance of the former;
 * integration: error of r by the time between samples [N m]; rate: largest |f'| within 1 / bandwidth [N m/s]; step: of
 * the encoders, infinite before it is known [rad]; seen: the last two positions, and the last velocities. See contact.c. */
struct fjr_torque_observer {
  fjr_function update; /* (kept, position, velocity, bandwidth, dt) -> kept */
  double bandwidth;    /* 1/s */
  int64_t stamp;
  int32_t errors;
  double limit, stay, noise[FJR_N]; /* noise: variances [(N m)^2] */
  double K[FJR_N * FJR_N], step[2 * FJR_N], seen[3][2 * FJR_N]; /* K by rows */
  int64_t period, learned;          /* between two updates of d and P; stamp of the last one */
  double *kept, *next, *d, *P, *W;  /* W (errors): work space */
  double compared[2 * FJR_N], S[FJR_N * FJR_N], integration[FJR_N], rate[FJR_N];
  const double** arg; /* work space of the function */
  double** res;
  long long int* iw;
  double* w;
};

/* The grid of messages that observers read; period [ns], 0: every sample. */
struct fjr_auxiliary_rate {
  int64_t period, next;
};

/* ---- Functions ------------------------------------------------------------------------------------------------- */

/* Initialise a controller; it waits for its first sample. */
void fjr_init(struct fjr_controller* c, const struct fjr_settings* settings, const double* gains,
              const struct fjr_reference* reference);

/* Compute the command for a sample that arrived at `arrival` (steady clock); return 0 if nothing is to be sent.
 * A sample that waits for a newer one (fjr_waits_until) is not answered. */
int fjr_step(const struct fjr_model* m, struct fjr_controller* c, const struct fjr_sample* sample, int64_t arrival,
             struct fjr_command* command);

/* Check the wiring with the last sample, after its command was sent; a fault stops the next one. Without this call the
 * next fjr_step does it first: the results are the same, only that command is later. */
void fjr_check_wiring(const struct fjr_model* m, struct fjr_controller* c);

/* Return until when (steady clock) the last sample waits for a newer one; FJR_NEVER if it does not. If none has come by
 * then, call fjr_step again with it and the present time. */
int64_t fjr_waits_until(const struct fjr_controller* c);

/* If no sample was accepted for state_timeout, write the stop effort to u and return 1, once per silence.
 * now: of the clock of the arrivals; with simulated time, of that of the stamps. */
int fjr_silence(const struct fjr_model* m, struct fjr_controller* c, int64_t now, double* u);

/* Write the stop policy's effort without a sample to u; it counts as sent. */
void fjr_stop_effort(const struct fjr_model* m, struct fjr_controller* c, double* u);

/* Start again at the next sample; reference: 0 for that of the last start. */
void fjr_start(struct fjr_controller* c, const struct fjr_reference* reference);

/* Requests for the next sample. start: stamp of the reference's time 0; FJR_NEVER: that sample's. */
void fjr_apply(struct fjr_controller* c, const struct fjr_settings* settings);
void fjr_use_gains(struct fjr_controller* c, const double* gains, const double* hold_damping);
void fjr_follow(struct fjr_controller* c, const struct fjr_reference* reference, int64_t start);
void fjr_hold(struct fjr_controller* c);
void fjr_resume(struct fjr_controller* c);

/* Return 1 if a resume would stop at once: the last state violates a limit, or is in a contact that stops. Write which as
 * that stop would. */
int fjr_is_outside(const struct fjr_controller* c, struct fjr_event* found);

enum fjr_state fjr_state_of(const struct fjr_controller* c);

/* Write the jets (FJR_JETS, FJR_N) of a reference at t [s], and of the active one at a stamp. */
void fjr_reference_jets(const struct fjr_reference* r, double t, double* jets);
void fjr_jets_at(const struct fjr_controller* c, int64_t stamp, double* jets);

/* The check of the wiring by itself, for recorded states. start: again with all rows; skip: the next state does not
 * follow the last one. see: a state at t [s]; sent: the effort for it. compare: what fjr_check_wiring does; return the
 * number of operations. is_right: all rows are known to be right, and the check ends. */
void fjr_wiring_start(struct fjr_wiring* w);
void fjr_wiring_skip(struct fjr_wiring* w);
void fjr_wiring_see(struct fjr_wiring* w, double t, const double* position, const double* velocity);
void fjr_wiring_sent(struct fjr_wiring* w, const double* u);
int fjr_wiring_compare(const struct fjr_model* m, struct fjr_wiring* w);
int fjr_wiring_is_right(const struct fjr_wiring* w);

/* Let the next sample have no predecessor, and the bound begin again. */
void fjr_certificate_restart(struct fjr_certificate* c);

/* Evaluate the certificate of a command; return 0 if a function failed. */
int fjr_certify(struct fjr_certificate* c, const struct fjr_command* command, int64_t stamp, struct fjr_certified* found);

/* Write the external torques on the links [N m] at the sample that was answered last; return 1 if they are known. The
 * next sample reacts to a contact. */
int fjr_observe_torque(struct fjr_torque_observer* o, const struct fjr_model* m, struct fjr_controller* c,
                       const struct fjr_sample* sample, double* torque);

/* The same without a controller, for recorded states: positions and velocities (2, FJR_N) of links and motors. */
int fjr_watch_torque(struct fjr_torque_observer* o, struct fjr_contact* c, const double* position,
                     const double* velocity, int64_t stamp);

/* Return 1 if the messages for observers are due at the sample with this stamp. */
int fjr_is_due(struct fjr_auxiliary_rate* r, int64_t stamp);

#endif
