/* SPDX-License-Identifier: Apache-2.0
 * Declarations of shooting.c, read by cffi, too.
 */
typedef int (*fjr_function)(const double** arg, double** res, long long* iw, double* w, int mem);

/* Accelerations (x, u, parameters) -> dv (2 N), nonzeros of d dv / d(x, free, u), and the memory that they need. */
struct fjr_arm {
  fjr_function f;
  const double** arg;
  double** res;
  long long* iw;
  double* w;
  double* nonzeros;
  const int32_t *row, *column, *joint; /* of each nonzero: column of S, -1: none; joint of an effort, else -1 */
  int64_t count;
};

/* Integrate one segment. u, du (samples, parts, 2, N): mean effort of each part of a sample period and half of its
 * increment, and their derivatives by the delay. X (samples + 1, 4 N), S (samples + 1, 4 N, M): their first entries are given. work: 12 N (M + 1) numbers.
 * Return 1 if the state does not stay finite. */
int fjr_shoot(const struct fjr_arm* m, const double* u, const double* du, const double* parameters, int64_t samples,
              int64_t parts, double dt, double* X, double* S, double* work);
