/* @{title}: law, reference and plant of a robot with flexible joints, as plain C99 without dependencies.
 * Made by `fjr export-c`; do not edit. It does what the Python of fjr_core does, to rounding.
 *
 * n = @{n} joints, in this order everywhere: @{joint_list}
 * Units: rad, rad/s, N m, s, J; momenta N m s. All arrays are contiguous doubles.
 *   position (2n): q_l of all joints (links), then q_m of all joints (motors, seen through the gear)
 *   velocity (2n): dq_l, then dq_m
 *   jets (5n):     q_ld (n), dq_ld (n), ddq_ld (n), d3q_ld (n), d4q_ld (n): what is tracked and four derivatives
 *   x (4n):        state of the plant: q_l, q_m, p_l = M_l(q_l) dq_l, p_m = M_m dq_m, each (n)
 *
 * No global state, no allocation, no system call. What a call needs is in its arguments and in *work, whose content
 * before and after a call does not matter: give each thread one of its own. An output may not overlap an input, but
 * `next` may be `memory`, and `x_next` may be `x`.
 * Each function returns 0; another value says that there is no result (a step of the plant that did not converge).
 * Nothing is limited, and no argument is checked: what keeps a robot safe is the caller's.
 */
#ifndef @{PREFIX}_H
#define @{PREFIX}_H

#ifdef __cplusplus
extern "C" {
#endif

#define @{PREFIX}_JOINTS @{n} /* n */
#define @{PREFIX}_JETS 5 /* rows of jets */
#define @{PREFIX}_GAINS @{gains} /* length of `gains` */
#define @{PREFIX}_MEMORY @{memory} /* length of `memory`; 0: a law without memory */
#define @{PREFIX}_SAMPLE_PERIOD @{sample_period} /* s, which the gains are checked for */
#define @{PREFIX}_LEAD @{lead} /* s: the law takes the reference so long after the sample */
#define @{PREFIX}_INNER_STEPS @{inner_steps} /* steps of the plant in a sample */

typedef struct @{prefix}_work {
  double w[@{w}];
  long long int iw[@{iw}];
  const double *arg[@{arg}];
  double *res[@{res}];
  double next[@{kept}];
} @{prefix}_work;

extern const char *const @{prefix}_scenario; /* name of the scenario */
extern const char *const @{prefix}_joint_names[@{PREFIX}_JOINTS];
extern const double @{prefix}_x0[4 * @{PREFIX}_JOINTS]; /* the scenario's first state of the plant */

/* The scenario's gains@{gain_words} */
extern const double @{prefix}_gains[@{gains_length}];

/* The law's memory before its first sample@{memory_words} */
extern const double @{prefix}_first_memory[@{memory_length}];

/* The reference at time t, t = 0 being the first sample; where the law has a lead, ask for time + @{PREFIX}_LEAD.
 * t [s] -> jets (5n)
 */
int @{prefix}_reference(double t, double *jets, @{prefix}_work *work);

/* One sample of the law; the effort is to be held until the next sample.
 * position (2n), velocity (2n), jets (5n)
 * gains (@{PREFIX}_GAINS): NULL for @{prefix}_gains
 * memory (@{PREFIX}_MEMORY): `next` of the last sample; NULL at the first sample, and for a law without memory
 * sent (n): the effort that acted since the last sample, after all limits; NULL at the first (zeros)
 * dt: time since the last sample [s]; 0 at the first
 * -> u (n) [N m], V [J] the storage (nan where the law has none), next (@{PREFIX}_MEMORY); V and next may be NULL
 */
int @{prefix}_law(const double *position, const double *velocity, const double *jets, const double *gains,
@{indent}const double *memory, const double *sent, double dt, double *u, double *V, double *next,
@{indent}@{prefix}_work *work);

/* What sensors of the plant see: x (4n) -> position (2n), velocity (2n) */
int @{prefix}_plant_measure(const double *x, double *position, double *velocity, @{prefix}_work *work);

/* One step of the plant (@{integrator}) under a held effort: x (4n), u (n), dt [s] -> x_next (4n) */
int @{prefix}_plant_step(const double *x, const double *u, double dt, double *x_next, @{prefix}_work *work);

#ifdef __cplusplus
}
#endif

#endif /* @{PREFIX}_H */
