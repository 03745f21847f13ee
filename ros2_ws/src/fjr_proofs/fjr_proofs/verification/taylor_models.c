/* SPDX-License-Identifier: Apache-2.0 */
/* Arithmetic of Taylor models: polynomials with a bound of what they leave out.
 *
 *   a(t, y) = a_0 + a_1 t + .. + a_(K-1) t^(K-1) + sum of t^l y_j b_lj for l < L +- r,   |t| <= 1, |y_j| <= 1
 *
 * A model is an array of K + L M coefficients and r; M deviations y. Products of higher degree go into r, as do all
 * roundings: a sum of products in double precision has an error of at most (number of terms) 2^-53 times the sum of their
 * absolute values. K. Makino, M. Berz, Taylor models and other validated functional inclusion methods, Int. J. Pure
 * Appl. Math. 6 (2003).
 *
 * Models of LANES boxes are computed together: `lanes` has one number of each.
 */

enum { R = K + L * M, WIDTH = R + 1 };
enum { ADD, SUB, MUL, DIV, NEG, SQ, TWICE, INV, SIN, COS, ASSIGN, CONSTANT, INPUT, OUTPUT };

typedef double lanes __attribute__((vector_size(8 * LANES), aligned(8)));
typedef int64_t lane_bits __attribute__((vector_size(8 * LANES), aligned(8)));

static const double U = 0x1p-53, TINY = 0x1p-1000;
static const double UP = 1 + 0x1p-43; /* covers the rounding of a radius: sums of up to 500 terms */
static const double LIBRARY = 0x1p-50; /* bound of the error of sin and cos */

/* Sums of absolute values: of the coefficients of t^k, k > 0; of those of t^l y_j, each l; of these; of all. */
struct size {
  lanes t, y[L], deviations, all;
};

static lanes each(double value) { return value - (lanes){0}; }

static lanes magnitude(lanes a) { return (lanes)((lane_bits)a & ~((lane_bits){0} + INT64_MIN)); }

static lanes sum_of(const lanes *a, int first, int last) {
  lanes sum = {0};
  for (int j = first; j < last; j++) sum += magnitude(a[j]);
  return sum;
}

static struct size size_of(const lanes *a) {
  struct size s = {.t = sum_of(a, 1, K)};
  for (int l = 0; l < L; l++) s.deviations += s.y[l] = sum_of(a, K + l * M, K + (l + 1) * M);
  s.all = magnitude(a[0]) + s.t + s.deviations;
  return s;
}

static void constant(lanes *c, lanes value) {
  memset(c, 0, WIDTH * sizeof(lanes));
  c[0] = value;
}

static void add(lanes *c, const lanes *a, const lanes *b, double sign) {
  lanes rest = a[R] + b[R];
  for (int k = 0; k < R; k++) c[k] = a[k] + sign * b[k];
  c[R] = UP * (rest + U * sum_of(c, 0, R));
}

static void scale(lanes *c, const lanes *a, lanes factor) {
  lanes rest = magnitude(factor) * a[R];
  for (int k = 0; k < R; k++) c[k] = factor * a[k];
  c[R] = UP * (rest + U * sum_of(c, 0, R)) + TINY;
}

/* c = a b; c must be neither a nor b. */
static void multiply(lanes *restrict c, const lanes *restrict a, const lanes *restrict b) {
  const struct size s = size_of(a), r = size_of(b);
  lanes cut = s.deviations * r.deviations;
  for (int k = 0; k < K; k++) {
    lanes sum = {0};
    for (int i = 0; i <= k; i++) sum += a[i] * b[k - i];
    c[k] = sum;
    for (int i = K - k; i < K; i++) cut += magnitude(a[k] * b[i]);
    for (int l = L - k > 0 ? L - k : 0; l < L; l++) cut += magnitude(a[k]) * r.y[l] + magnitude(b[k]) * s.y[l];
  }
  for (int l = 0; l < L; l++) {
    lanes *restrict d = c + K + l * M;
    for (int j = 0; j < M; j++) d[j] = (lanes){0};
    for (int i = 0; i <= l; i++) {
      const lanes *e = a + K + (l - i) * M, *f = b + K + (l - i) * M;
      for (int j = 0; j < M; j++) d[j] += a[i] * f[j] + b[i] * e[j];
    }
  }
  c[R] = UP * (cut + s.all * b[R] + a[R] * (r.all + b[R]) + (K + 2 * L + 4) * U * s.all * r.all) + TINY;
}

/* c = sum of d^k f_k for k < K, plus or minus rest: a function of d by its Taylor series. */
static void series(lanes *c, const lanes *d, const lanes *f, lanes rest) {
  lanes power[WIDTH];
  constant(c, f[K - 1]);
  for (int k = K - 2; k >= 0; k--) {
    multiply(power, c, d);
    memcpy(c, power, sizeof power);
    c[0] += f[k];
    c[R] = UP * (c[R] + U * magnitude(c[0]));
  }
  c[R] = UP * (c[R] + rest);
}

/* Split a = a_0 + d; return a bound of |d|. */
static lanes deviation(lanes *d, const lanes *a) {
  struct size s = size_of(a);
  memcpy(d, a, WIDTH * sizeof(lanes));
  d[0] = (lanes){0};
  return UP * (s.t + s.deviations + a[R]);
}

/* Sine of a, or cosine with shift = 1: derivative k is that of order k + shift. */
static void sine(lanes *c, const lanes *a, int shift) {
  lanes d[WIDTH], f[K], rest = each(1), size = deviation(d, a), inexact = each(LIBRARY), power = each(1), values[4];
  double factorial = 1;
  for (int i = 0; i < LANES; i++) values[0][i] = sin(a[0][i]), values[1][i] = cos(a[0][i]);
  values[2] = -values[0], values[3] = -values[1];
  for (int k = 0; k < K; k++) {
    f[k] = values[(k + shift) & 3] / factorial;
    inexact += (LIBRARY + 2 * U) * (power *= size);
    factorial *= k + 1;
    rest *= size;
  }
  series(c, d, f, UP * (rest / factorial + inexact));
}

/* c = 1 / a; return 1 if a may be zero. */
static int inverse(lanes *c, const lanes *a) {
  lanes d[WIDTH], f[K], e[WIDTH], inverse = 1 / a[0], size = deviation(d, a), least = magnitude(a[0]) - size;
  for (int i = 0; i < LANES; i++)
    if (!(least[i] > 0) || !isfinite(inverse[i])) return 1;
  scale(e, d, -inverse);
  e[R] = UP * (e[R] + 2 * U * size * magnitude(inverse)); /* of the rounding of 1 / a_0 */
  lanes rest = UP * size / magnitude(a[0]), last = each(1), sum = {0};
  for (int k = 0; k < K; k++) {
    f[k] = inverse;
    sum += last;
    last *= rest;
  }
  series(c, e, f, UP * UP * magnitude(inverse) * (last * magnitude(a[0]) / least + 4 * U * sum));
  return 0;
}

/* Read the models of an input of all lanes; without a box a lane repeats the last. */
static void gather(lanes *c, const double *models, int64_t apart, int boxes) {
  for (int i = 0; i < LANES; i++)
    for (int k = 0; k < WIDTH; k++) c[k][i] = models[apart * (i < boxes ? i : boxes - 1) + k];
}

static void scatter(double *models, int64_t apart, int boxes, const lanes *a) {
  for (int i = 0; i < boxes; i++)
    for (int k = 0; k < WIDTH; k++) models[apart * i + k] = a[k][i];
}

static int evaluate(const struct fjr_tape *tape, const double *inputs, double *results, lanes *memory, int boxes) {
  lanes kept[WIDTH];
  for (int64_t i = 0; i < tape->count; i++) {
    const lanes *a = memory + (int64_t)WIDTH * tape->left[i], *b = memory + (int64_t)WIDTH * tape->right[i];
    lanes *c = memory + (int64_t)WIDTH * tape->out[i];
    switch (tape->op[i]) {
      case ADD: add(c, a, b, 1.0); continue;
      case SUB: add(c, a, b, -1.0); continue;
      case NEG: scale(c, a, each(-1.0)); continue;
      case TWICE: scale(c, a, each(2.0)); continue;
      case ASSIGN: memmove(c, a, sizeof kept); continue;
      case CONSTANT: constant(c, each(tape->number[i])); continue;
      case INPUT: gather(c, inputs + (int64_t)WIDTH * tape->left[i], WIDTH * tape->inputs, boxes); continue;
      case OUTPUT: scatter(results + (int64_t)WIDTH * tape->out[i], WIDTH * tape->outputs, boxes, a); continue;
      case MUL: multiply(kept, a, b); break;
      case SQ: multiply(kept, a, a); break;
      case SIN: sine(kept, a, 0); break;
      case COS: sine(kept, a, 1); break;
      case INV:
        if (inverse(kept, a)) return 1;
        break;
      case DIV: {
        lanes one_by_b[WIDTH];
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
  for (int64_t i = 0; i < boxes; i += LANES) {
    const int now = boxes - i < LANES ? (int)(boxes - i) : LANES;
    const double *from = inputs + i * tape->inputs * WIDTH;
    if (evaluate(tape, from, results + i * tape->outputs * WIDTH, (lanes *)memory, now)) return 1;
  }
  return 0;
}
