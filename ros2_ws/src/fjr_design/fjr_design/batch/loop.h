/* SPDX-License-Identifier: Apache-2.0
 * Many runs of a closed loop with drawn parameters; needs step.h.
 */
#ifndef FJR_LOOP_H
#define FJR_LOOP_H

/* Functions of a plant with drawn parameters, see parametric_robot.py. */
struct fjr_plant {
  fjr_function step;     /* (x with sliders, u, parameters, dt) -> x with sliders */
  fjr_function velocity; /* (x, parameters) -> dq_l, dq_m */
  fjr_function state;    /* (position, velocity, parameters) -> x */
  fjr_function torque;   /* (position with sliders, parameters) -> torque of the springs */
};

/* Sample k has the stamp k period. A trace row is x, u and the sample: link, motor, velocity. */
struct fjr_batch {
  int64_t samples, first, last_second, ring, width; /* width: of the drawn parameters */
  double period;                                    /* s */
  const double *lost, *band;                        /* of each joint (N), rad or m */
  const struct fjr_settings* settings;
  const struct fjr_reference* reference;
  const double *gains, *position, *velocity; /* at the start (2 N) */
  const double* B_m;                         /* of the plants, by rows */
  struct fjr_plant plain, full;
  const double *parameters, *sensing, *limit; /* of each run (width), (3), (N) */
  const uint8_t* is_full;                     /* true: the plant of a run is `full` */
  const int64_t* segments;                    /* of each run (2, 2): age of the effort in samples, steps */
  const double* dt;                           /* of each run (2), of the steps in each segment [s] */
  const uint64_t* seeds;
  double *rows, *trace;       /* results of each run (6 N + 6); (samples + 1, 9 N), or 0 */
  volatile int32_t cancelled; /* set by another thread: return soon, with incomplete results */
};

/* Run begin .. end - 1. rings (LANES, ring, N): memory for the last efforts. No state is shared between calls. */
void fjr_run_batch(const struct fjr_model* m, const struct fjr_batch* b, int64_t begin, int64_t end, double* rings);

/* For tests: normal numbers z (joints, 4) at a sample. */
void fjr_noise(uint64_t seed, uint64_t sample, int64_t joints, double* z);

#endif
