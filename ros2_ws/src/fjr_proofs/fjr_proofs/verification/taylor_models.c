/* SPDX-License-Identifier: Apache-2.0 */
/* Arithmetic of Taylor models: polynomials with a bound of what they leave out.
 *
 *   a(t, y) = a_0 + a_1 t + .. + a_(K-1) t^(K-1) + sum of t^l y_j b_lj for l < L +- r,   |t| <= 1, |y_j| <= 1
 *
 * A model is an array of K + L M coefficients and r; M deviations y. Products of higher degree go into r, as do all
 * roundings: a sum of products in double precision has an error of at most (number of terms) 2^-53 times the sum of their
 * absolute values. K. Makino, M. Berz, Taylor models and other validated functional inclusion methods, Int. J. Pure
 * Appl. Math. 6 (2003).
 */

enum { R = K + L * M, WIDTH = R + 1 };
enum { ADD, SUB, MUL, DIV, NEG, SQ, TWICE, INV, SIN, COS, ASSIGN, CONSTANT, INPUT, OUTPUT };

static const double U = 0x1p-53, TINY = 0x1p-1000;
static const double UP = 1 + 0x1p-43; /* covers the rounding of a radius: sums of up to 500 terms */
static const double LIBRARY = 0x1p-50; /* bound of the error of sin and cos */

/* Sums of absolute values: of the coefficients of t^k, k > 0; of those of t^l y_j, each l; of these; of all. */
struct size {
  double t, y[L], deviations, all;
};

static double sum_of(const double *a, int first, int last) {
  double sum = 0;
#pragma omp simd reduction(+ : sum)
  for (int j = first; j < last; j++) sum += fabs(a[j]);
  return sum;
}

static struct size size_of(const double *a) {
  struct size s = {.t = sum_of(a, 1, K)};
  for (int l = 0; l < L; l++) s.deviations += s.y[l] = sum_of(a, K + l * M, K + (l + 1) * M);
  s.all = fabs(a[0]) + s.t + s.deviations;
  return s;
}

static void constant(double *c, double value) {
  memset(c, 0, WIDTH * sizeof(double));
  c[0] = value;
}

static void add(double *c, const double *a, const double *b, double sign) {
  double rest = a[R] + b[R];
  for (int k = 0; k < R; k++) c[k] = a[k] + sign * b[k];
  c[R] = UP * (rest + U * sum_of(c, 0, R));
}

static void scale(double *c, const double *a, double factor) {
  double rest = fabs(factor) * a[R];
  for (int k = 0; k < R; k++) c[k] = factor * a[k];
  c[R] = UP * (rest + U * sum_of(c, 0, R)) + TINY;
}

/* c = a b; c must be neither a nor b. */
static void multiply(double *restrict c, const double *restrict a, const double *restrict b) {
  const struct size s = size_of(a), r = size_of(b);
  double cut = s.deviations * r.deviations;
  for (int k = 0; k < K; k++) {
    double sum = 0;
    for (int i = 0; i <= k; i++) sum += a[i] * b[k - i];
    c[k] = sum;
    for (int i = K - k; i < K; i++) cut += fabs(a[k] * b[i]);
    for (int l = L - k > 0 ? L - k : 0; l < L; l++) cut += fabs(a[k]) * r.y[l] + fabs(b[k]) * s.y[l];
  }
  for (int l = 0; l < L; l++) {
    double *restrict d = c + K + l * M;
    for (int j = 0; j < M; j++) d[j] = 0;
    for (int i = 0; i <= l; i++) {
      const double *e = a + K + (l - i) * M, *f = b + K + (l - i) * M;
      for (int j = 0; j < M; j++) d[j] += a[i] * f[j] + b[i] * e[j];
    }
  }
  c[R] = UP * (cut + s.all * b[R] + a[R] * (r.all + b[R]) + (K + 2 * L + 4) * U * s.all * r.all) + TINY;
}

/* c = sum of d^k f_k for k < K, plus or minus rest: a function of d by its Taylor series. */
static void series(double *c, const double *d, const double *f, double rest) {
  double power[WIDTH];
  constant(c, f[K - 1]);
  for (int k = K - 2; k >= 0; k--) {
    multiply(power, c, d);
    memcpy(c, power, sizeof power);
    c[0] += f[k];
    c[R] = UP * (c[R] + U * fabs(c[0]));
  }
  c[R] = UP * (c[R] + rest);
}

/* Split a = a_0 + d; return a bound of |d|. */
static double deviation(double *d, const double *a) {
  struct size s = size_of(a);
  memcpy(d, a, WIDTH * sizeof(double));
  d[0] = 0;
  return UP * (s.t + s.deviations + a[R]);
}

/* Sine of a, or cosine with shift = 1: derivative k is that of order k + shift. */
static void sine(double *c, const double *a, int shift) {
  double d[WIDTH], f[K], rest = 1, factorial = 1, size = deviation(d, a);
  const double values[4] = {sin(a[0]), cos(a[0]), -sin(a[0]), -cos(a[0])};
  double inexact = LIBRARY, power = 1;
  for (int k = 0; k < K; k++) {
    f[k] = values[(k + shift) & 3] / factorial;
    inexact += (LIBRARY + 2 * U) * (power *= size);
    factorial *= k + 1;
    rest *= size;
  }
  series(c, d, f, UP * (rest / factorial + inexact));
}

/* c = 1 / a; return 1 if a may be zero. */
static int inverse(double *c, const double *a) {
  double d[WIDTH], f[K], e[WIDTH], rest, inverse = 1 / a[0], size = deviation(d, a), least = fabs(a[0]) - size;
  if (!(least > 0) || !isfinite(inverse)) return 1;
  scale(e, d, -inverse);
  e[R] = UP * (e[R] + 2 * U * size * fabs(inverse)); /* of the rounding of 1 / a_0 */
  rest = UP * size / fabs(a[0]);
  double last = 1, sum = 0;
  for (int k = 0; k < K; k++) {
    f[k] = inverse;
    sum += last;
    last *= rest;
  }
  series(c, e, f, UP * UP * fabs(inverse) * (last * fabs(a[0]) / least + 4 * U * sum));
  return 0;
}

static int evaluate(const struct fjr_tape *tape, const double *inputs, double *results, double *memory) {
  double kept[WIDTH];
  for (int64_t i = 0; i < tape->count; i++) {
    const double *a = memory + (int64_t)WIDTH * tape->left[i], *b = memory + (int64_t)WIDTH * tape->right[i];
    double *c = memory + (int64_t)WIDTH * tape->out[i];
    switch (tape->op[i]) {
      case ADD: add(c, a, b, 1.0); continue;
      case SUB: add(c, a, b, -1.0); continue;
      case NEG: scale(c, a, -1.0); continue;
      case TWICE: scale(c, a, 2.0); continue;
      case ASSIGN: memmove(c, a, sizeof kept); continue;
      case CONSTANT: constant(c, tape->number[i]); continue;
      case INPUT: memcpy(c, inputs + (int64_t)WIDTH * tape->left[i], sizeof kept); continue;
      case OUTPUT: memcpy(results + (int64_t)WIDTH * tape->out[i], a, sizeof kept); continue;
      case MUL: multiply(kept, a, b); break;
      case SQ: multiply(kept, a, a); break;
      case SIN: sine(kept, a, 0); break;
      case COS: sine(kept, a, 1); break;
      case INV:
        if (inverse(kept, a)) return 1;
        break;
      case DIV: {
        double one_by_b[WIDTH];
        if (inverse(one_by_b, b)) return 1;
        multiply(kept, a, one_by_b);
      }
    }
    memcpy(c, kept, sizeof kept);
  }
  return 0;
}

int fjr_taylor_evaluate(
    const struct fjr_tape *tape, const double *inputs, int64_t boxes, double *results, double *memory) {
  for (int64_t i = 0; i < boxes; i++)
    if (evaluate(tape, inputs + i * tape->inputs * WIDTH, results + i * tape->outputs * WIDTH, memory)) return 1;
  return 0;
}
