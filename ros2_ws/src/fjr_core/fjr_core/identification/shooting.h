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

/* Efforts u (count, N) of a record, held for a sample period, of which one starts a segment at index `first`.
 * delay (N): in samples. parts (1 + 2 N): integration steps of a sample period: always, and where the velocity of a link
 * or motor is below slow (2 N). */
struct fjr_input {
  const double* u;
  int64_t count, first;
  const double* delay;
  const int32_t* parts;
  const double* slow;
  double dt;
};

/* Integrate one segment. X (samples + 1, 4 N), S (samples + 1, 4 N, M): their first entries are given. work: 12 N (M + 1)
 * numbers. Return 1 if the state does not stay finite. */
int fjr_shoot(const struct fjr_arm* m, const struct fjr_input* input, const double* parameters, int64_t samples,
              double* X, double* S, double* work);

/* Effort over a part of sample period k: u (2, N), mean and half of its increment, and du, their derivatives by the
 * delay. */
void fjr_line(const struct fjr_input* input, int64_t k, int64_t part, int64_t parts, double* u, double* du);
