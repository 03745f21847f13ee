/* SPDX-License-Identifier: Apache-2.0
 * Declarations of shooting.c, read by cffi, too.
 */
typedef int (*fjr_function)(const double** arg, double** res, long long* iw, double* w, int mem);

/* Accelerations (x, u, parameters) -> dv (2 N), nonzeros of d dv / d(x, free, u), and the memory that they need.
 * dS = (S_v, A S + P): row i of A has nonzeros row_start[i] .. row_start[i + 1] - 1; P has those of block b of columns from
 * forced_start[b] on. entry: where the function puts a nonzero. forced_joint: j of a derivative by the delay of an effort,
 * N + j by the square of its lag, else -1. */
struct fjr_arm {
  fjr_function f;
  const double** arg;
  double** res;
  long long* iw;
  double* w;
  double* nonzeros; /* (4, count), of the stages of a step */
  int64_t count;
  const int32_t *row_start, *entry, *column;
  const int32_t *forced_start, *forced_entry, *forced_row, *forced_column, *forced_joint;
};

/* Efforts u (count, N) of a record behind their lag, held for a sample period, of which one starts a segment at index
 * `first`, and du, their derivatives by the square of the lag.
 * delay (N): in samples, of which the lag is a part. parts: integration steps of a sample period, halved where the
 * velocity of a link or motor (2 N) may come below slow: to `rest` [s], and to a change of velocity of `passage` unless
 * the step is `harmless` [s]. */
struct fjr_input {
  const double *u, *du;
  int64_t count, first, parts;
  const double *delay, *lag, *slow, *rest, *passage, *harmless;
  double dt;
};

/* Efforts behind lags T (N), in samples, and their derivatives by T^2, out (2, count, N), of u (count, N):
 *     w_k = (1 - a) u_k + a w_{k-1},    mean delay m = a / (1 - a), variance m + m^2 = T^2 */
void fjr_behind(const double* u, const double* lag, int64_t count, double* out);

/* Integrate one segment. X (samples + 1, 4 N), S (samples + 1, 4 N, M): their first entries are given. Return 1 if the
 * state does not stay finite. */
int fjr_shoot(const struct fjr_arm* m, const struct fjr_input* input, const double* parameters, int64_t samples,
              double* X, double* S);

/* Effort over a part of sample period k: u (2, N), mean and half of its increment, and du (2, 2 N), their derivatives by
 * the delay and by the square of the lag. */
void fjr_line(const struct fjr_input* input, int64_t k, int64_t part, int64_t parts, double* u, double* du);

/* Add J'J to H (columns, columns) and J'r to g (columns), which are 0 before; J (rows, columns), r (rows). */
void fjr_normal_equations(const double* J, const double* r, int64_t rows, int64_t columns, double* H, double* g);
