/* SPDX-License-Identifier: Apache-2.0
 * The certificate of each answered sample, evaluated after its command was sent (fjr_core/monitoring/certificate.py).
 */
#ifndef FJR_CERTIFICATE_H
#define FJR_CERTIFICATE_H

/* Certificate of a sample and, if it follows another one within `longest`, the innovation of the interval between them.
 * V0, law, older: storage, effort of the law and effort before the last at the start of the interval. predicted: V at
 * the state that the model predicts; error: measured minus predicted positions and velocities. */
struct fjr_certified {
  int32_t follows;
  double dt, V, dV, rate, bound, H, supplied, dissipated;
  double V0, predicted;
  double sent[FJR_N], law[FJR_N], older[FJR_N], error[4 * FJR_N], slope[4 * FJR_N];
};

struct fjr_certificate {
  fjr_function certify; /* (position, velocity, jets, gains) -> V, H, dissipation, dissipated, u_law, drive, slope */
  fjr_function predict; /* (position, velocity, u, dt) -> next position, next velocity */
  fjr_function law;     /* (position, velocity, jets, gains) -> u, V */
  const double* gains;
  double B_m[FJR_N * FJR_N]; /* by rows */
  double longest;            /* s; two samples further apart are not compared */
  double beta;               /* [1/s] of the bound; Python may change it at any time */
  int32_t bounded;           /* 0: V has no bound */
  const double** arg;        /* work space of the functions */
  double** res;
  long long int* iw;
  double* w;
  int32_t follows; /* the last sample may have a successor */
  int64_t stamp, bound_start;
  double V, dissipation, u_law[FJR_N], drive[FJR_N], slope[4 * FJR_N];
  double position[2 * FJR_N], velocity[2 * FJR_N], u[FJR_N], older[FJR_N], bound;
};

/* Let the next sample have no predecessor, and the bound begin again. */
void fjr_certificate_restart(struct fjr_certificate* c);

/* Evaluate the certificate of a command; return 0 if a function failed. */
int fjr_certify(struct fjr_certificate* c, const struct fjr_command* command, int64_t stamp, struct fjr_certified* found);

#endif
