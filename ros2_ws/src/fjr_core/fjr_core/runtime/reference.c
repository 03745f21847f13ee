/* SPDX-License-Identifier: Apache-2.0
 * Jets q_ld .. d4q_ld of the references, and the polynomial that joins two of them. Part of the control step; needs
 * step.h.
 */
#include <math.h>

/* ---- Piecewise polynomials -------------------------------------------------------------------------------------- */

/* Return the number of edges <= t. */
static int64_t edges_until(const double* edge, int64_t edges, double t) {
  int64_t low = 0, high = edges;
  while (low < high) {
    const int64_t middle = low + (high - low) / 2;
    if (t < edge[middle])
      high = middle;
    else
      low = middle + 1;
  }
  return low;
}

/* Write the jets (FJR_JETS, joints) of a piecewise polynomial at t, by Horner's rule. */
static void polynomials_jets(const struct fjr_polynomials* p, int joints, double t, double* jets) {
  const int64_t i = edges_until(p->edge, p->edges, t), width = (int64_t)FJR_JETS * joints;
  const double s = (t - p->origin[i]) * p->rate[i];
  const double* c = p->coefficients + ((i + 1) * FJR_POWERS - 1) * width; /* of the highest power */
  for (int64_t k = 0; k < width; ++k) jets[k] = c[k];
  for (int power = FJR_POWERS - 2; power >= 0; --power) {
    c -= width;
    for (int64_t k = 0; k < width; ++k) jets[k] = jets[k] * s + c[k];
  }
}

/* ---- Polynomial of degree 9 between two jets -------------------------------------------------------------------- */

/* Write the Taylor coefficients (FJR_JETS, FJR_N) in s = t / h: c_k = jets_k h^k / k!. */
static void taylor(const double* jets, double h, double* c) {
  double factor = 1;
  for (int order = 0; order < FJR_JETS; ++order) {
    for (int i = 0; i < FJR_N; ++i) c[order * FJR_N + i] = factor * jets[order * FJR_N + i];
    factor *= h / (order + 1);
  }
}

/* Write the polynomial c (FJR_POWERS, FJR_N) in s with the Taylor coefficients near at s = 0 and far at s = 1. */
static void interpolate(const double* near, const double* far, double* c) {
  /* Taylor coefficients at 1 of the lower powers by order, and the inverse of those of the higher powers. */
  static const double lower[FJR_JETS][FJR_JETS] = {
      {1, 1, 1, 1, 1}, {0, 1, 2, 3, 4}, {0, 0, 1, 3, 6}, {0, 0, 0, 1, 4}, {0, 0, 0, 0, 1}};
  static const double higher[FJR_JETS][FJR_JETS] = {{126, -56, 21, -6, 1},
                                                    {-420, 196, -77, 23, -4},
                                                    {540, -260, 106, -33, 6},
                                                    {-315, 155, -65, 21, -4},
                                                    {70, -35, 15, -5, 1}};
  for (int i = 0; i < FJR_N; ++i) {
    double remainder[FJR_JETS];
    for (int order = 0; order < FJR_JETS; ++order) {
      remainder[order] = far[order * FJR_N + i];
      for (int k = order; k < FJR_JETS; ++k) remainder[order] -= lower[order][k] * near[k * FJR_N + i];
    }
    for (int k = 0; k < FJR_JETS; ++k) {
      double sum = 0;
      for (int order = 0; order < FJR_JETS; ++order) sum += higher[k][order] * remainder[order];
      c[k * FJR_N + i] = near[k * FJR_N + i];
      c[(FJR_JETS + k) * FJR_N + i] = sum;
    }
  }
}

/* Write the coefficients (FJR_POWERS, FJR_JETS, FJR_N) of all jets for the position c (FJR_POWERS, FJR_N) in s. */
static void differentiate(const double* c, double rate, double* table) {
  for (int power = 0; power < FJR_POWERS; ++power) {
    double factor = 1; /* (power + order)! / power! rate^order */
    for (int order = 0; order < FJR_JETS; ++order) {
      const int from = power + order;
      double* row = table + (power * FJR_JETS + order) * FJR_N;
      for (int i = 0; i < FJR_N; ++i) row[i] = from < FJR_POWERS ? factor * c[from * FJR_N + i] : 0;
      factor *= (from + 1) * rate;
    }
  }
}

/* Write the entry of a segment's table for the half that begins at `near` and ends, after h [s], at `far`. */
static void half_segment(const double* near, const double* far, double h, double* table) {
  double start[FJR_JETS * FJR_N], end[FJR_JETS * FJR_N], c[FJR_POWERS * FJR_N];
  taylor(near, h, start);
  taylor(far, h, end);
  interpolate(start, end, c);
  differentiate(c, 1 / h, table);
}

/* Make the segment with jets0 at t0 and jets1 at t1 > t0; constant outside. Return 0 if it is too short to be finite. */
static int make_segment(struct fjr_segment* s, const double* jets0, const double* jets1, double t0, double t1) {
  enum { ENTRY = FJR_POWERS * FJR_JETS * FJR_N };
  const double h = t1 - t0;
  s->t0 = t0, s->t1 = t1;
  s->edge[0] = t0, s->edge[1] = t0 + h / 2, s->edge[2] = nextafter(t1, INFINITY);
  s->origin[0] = s->origin[1] = t0, s->origin[2] = s->origin[3] = t1;
  s->rate[0] = s->rate[3] = 0, s->rate[1] = 1 / h, s->rate[2] = -1 / h;
  for (int k = 0; k < 4 * ENTRY; ++k) s->coefficients[k] = 0;
  for (int i = 0; i < FJR_N; ++i) s->coefficients[i] = jets0[i], s->coefficients[3 * ENTRY + i] = jets1[i];
  half_segment(jets0, jets1, h, s->coefficients + ENTRY);
  half_segment(jets1, jets0, -h, s->coefficients + 2 * ENTRY);
  int finite = 1;
  for (int k = 0; k < 4 * ENTRY; ++k) finite = finite && isfinite(s->coefficients[k]);
  return finite;
}

static void segment_jets(const struct fjr_segment* s, double t, double* jets) {
  const struct fjr_polynomials p = {3, s->edge, s->origin, s->rate, s->coefficients};
  polynomials_jets(&p, FJR_N, t, jets);
}

/* ---- References ------------------------------------------------------------------------------------------------- */

static void constant_jets(const double* position, double* jets) {
  for (int k = 0; k < FJR_JETS * FJR_N; ++k) jets[k] = k < FJR_N ? position[k] : 0;
}

static void sines_jets(const struct fjr_reference* r, double t, double* jets) {
  for (int k = 0; k < FJR_JETS * FJR_N; ++k) jets[k] = 0;
  for (int64_t term = 0; term < r->terms; ++term)
    for (int i = 0; i < FJR_N; ++i) {
      const int64_t k = term * FJR_N + i;
      const double w = r->frequency[k], angle = w * t + r->phase[k];
      const double sine = r->amplitude[k] * sin(angle), cosine = r->amplitude[k] * cos(angle);
      jets[i] += sine;
      jets[FJR_N + i] += w * cosine;
      jets[2 * FJR_N + i] -= w * w * sine;
      jets[3 * FJR_N + i] -= w * w * w * cosine;
      jets[4 * FJR_N + i] += w * w * w * w * sine;
    }
  for (int i = 0; i < FJR_N; ++i) jets[i] += r->position[i];
}

/* With z = x + j y = radius exp(j angle) and w the rate of the angle: dz = j w z, and its derivatives. */
static void circle_jets(const struct fjr_reference* r, double t, double* jets) {
  double angle[FJR_JETS], x[FJR_JETS], y[FJR_JETS];
  polynomials_jets(&r->polynomials, 1, t, angle);
  const double w = angle[1], dw = angle[2], ddw = angle[3], d3w = angle[4];
  x[0] = r->radius * cos(angle[0]), y[0] = r->radius * sin(angle[0]);
  x[1] = -w * y[0], y[1] = w * x[0];
  x[2] = -(dw * y[0] + w * y[1]), y[2] = dw * x[0] + w * x[1];
  x[3] = -(ddw * y[0] + 2 * dw * y[1] + w * y[2]), y[3] = ddw * x[0] + 2 * dw * x[1] + w * x[2];
  x[4] = -(d3w * y[0] + 3 * ddw * y[1] + 3 * dw * y[2] + w * y[3]);
  y[4] = d3w * x[0] + 3 * ddw * x[1] + 3 * dw * x[2] + w * x[3];
  constant_jets(r->position, jets);
  for (int order = 0; order < FJR_JETS; ++order) {
    jets[order * FJR_N] += x[order];
    if (FJR_N > 1) jets[order * FJR_N + 1] += y[order];
  }
}

void fjr_reference_jets(const struct fjr_reference* r, double t, double* jets) {
  t -= r->shift;
  while (r->then && t >= r->until) {
    r = r->then;
    t -= r->shift;
  }
  if (r->period > 0) t = fmod(t, r->period); /* stays negative before 0 */
  switch (r->kind) {
    case FJR_SINES: sines_jets(r, t, jets); break;
    case FJR_POLYNOMIALS: polynomials_jets(&r->polynomials, FJR_N, t, jets); break;
    case FJR_CIRCLE: circle_jets(r, t, jets); break;
    case FJR_FUNCTION: r->jets(r->context, t, jets); break;
    default: constant_jets(r->position, jets);
  }
}
