/* SPDX-License-Identifier: Apache-2.0 */
/* Sums of the responses of a sampled loop, of which linear_loop.py bounds the rest. */

/* C = A B, A (rows, inner); four products at a time, so that the sums stay in registers longer. */
static void multiply(double *restrict C, const double *restrict A, const double *restrict B, int rows, int inner, int width) {
  for (int i = 0; i < rows; i++, C += width, A += inner) {
    int k = 0;
    for (int j = 0; j < width; j++) C[j] = 0;
    for (; k + 4 <= inner; k += 4) {
      const double *restrict b = B + (int64_t)k * width;
      for (int j = 0; j < width; j++)
        C[j] += (A[k] * b[j] + A[k + 1] * b[j + width]) + (A[k + 2] * b[j + 2 * width] + A[k + 3] * b[j + 3 * width]);
    }
    for (; k < inner; k++)
      for (int j = 0; j < width; j++) C[j] += A[k] * B[(int64_t)k * width + j];
  }
}

static void add_absolute(double *restrict sums, const double *restrict values, int count, double factor) {
  for (int j = 0; j < count; j++) sums[j] += factor * fabs(values[j]);
}

void fjr_chain_sums(
    const struct fjr_chain *chain, const int64_t *cells, int64_t blocks, int64_t rows, double *X, double *sums,
    double *product) {
  const int S = chain->states, m = chain->torques, n = chain->efforts, width = chain->samples * (2 * m + n) + S;
  double absolute[S], row_of_bent[m];
  for (int64_t block = 0; block < blocks; block++) {
    const double *bent = chain->bent + cells[block] * S * m;
    multiply(product, X, chain->maps + cells[block] * S * width, rows, S, width);
    for (int64_t i = 0; i < rows; i++) {
      const double *row = product + i * width, *x = X + i * S;
      double *sum = sums + i * (m + n);
      for (int sample = 0; sample < chain->samples; sample++, row += 2 * m + n) {
        add_absolute(sum, row, m, chain->half);
        add_absolute(sum, row + m, m, chain->half);
        add_absolute(sum + m, row + 2 * m, n, 1.0);
      }
      for (int k = 0; k < S; k++) absolute[k] = fabs(x[k]);
      multiply(row_of_bent, absolute, bent, 1, S, m);
      add_absolute(sum, row_of_bent, m, 1.0);
    }
    for (int64_t i = 0; i < rows; i++) memcpy(X + i * S, product + (i + 1) * width - S, S * sizeof(double));
  }
}
