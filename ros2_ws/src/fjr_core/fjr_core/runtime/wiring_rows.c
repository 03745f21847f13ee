/* SPDX-License-Identifier: Apache-2.0
 * The rows that the check of the wiring compares. Over the m intervals of a window both sides of each must agree:
 *
 *   link    y = M_l ddq_l + C dq_l + D_l dq_l + grad P_l   x = K (q_m - q_l)
 *   motor   y = M_m ddq_m + K (q_m - q_l) + D_m dq_m       x = B_m u
 *   speed   y = dq                                         x = slope of q              of links, then of motors
 *
 * y - x is Gaussian with mean 0 and covariance S: the noise of the sensors, estimated from the window, and the effect
 * of wrong parameters with the standard deviations below. The components of a row of torques are the m intervals, those
 * of a speed are slow motion, along polynomials of time. The mean square of the rest of its y - x is the noise of each
 * component if the slope has white noise, the position a random walk. It is more than that of a position's white noise.
 */
#define INTERVALS FJR_INTERVALS
#define MOTION FJR_MOTION
#define TOLERANCE 0.15 /* relative error of inertia, stiffness, weight and torque constant */
#define SCALE 0.08     /* relative error of a velocity */
#define LAGS 5         /* longest delay of an effort or a velocity in samples .. */
#define LAG 0.5        /* .. and weight of each earlier effort */
#define LATE 0.5       /* delay of a velocity beyond whole samples */
#define WEIGHT 0.1     /* constant torque relative to the largest weight of joints of the same kind .. */
#define OFFSET 1e-3    /* .. and offset of an encoder [rad] .. */
#define SHIFT 1e-4     /* .. or of that of a prismatic joint [m], whose springs deflect far less */
#define ROUNDING 0.01  /* error of the means over an interval, relative to both sides */
#define DOUBT 1.5      /* factor on the estimated variance of noise, which is uncertain after few samples */
#define FREEDOM 0.4    /* degrees of freedom of this estimate per fourth difference, as neighbours are correlated .. */
#define REST 0.7       /* .. and of the noise of a speed per component of the rest, if that of the position is white */

/* Signals as a hypothesis has them: encoder j of it is sign[j] times encoder from[j] as measured, likewise efforts. */
struct wires {
  int from[2 * N], effort[N];
  double sign[2 * N], effort_sign[N];
};

/* The rigid arm in a window. coupled: sum over the joints of M_jj ddq_j ddq_j', torques of motion up to M_ii^(1/2). */
struct arm {
  double M[N * N], coriolis[N], weight[2][N]; /* in the middle; at both ends */
  double coupled[INTERVALS][INTERVALS];
};

/* Both sides of a row with m components. S: upper triangle of its covariance, then of its Cholesky factor; freedom:
 * degrees of freedom of the estimate of noise. */
struct sides {
  int m;
  double freedom, y[INTERVALS], x[INTERVALS], S[INTERVALS][INTERVALS];
};

/* ---- Gaussian rows ---------------------------------------------------------------------------------------------- */

/* S += factor v v'. */
static void add_product(double (*S)[INTERVALS], int m, double factor, const double* v) {
  for (int i = 0; i < m; ++i) {
    const double a = factor * v[i];
    for (int j = i; j < m; ++j) S[i][j] += a * v[j];
  }
}

/* Add rounding and the noise of the sensors: variances of means and of differences over the intervals. */
static void add_noise(struct sides* s, int m, double mean, double change) {
  double size = 0;
  for (int k = 0; k < m; ++k) size += s->y[k] * s->y[k] + s->x[k] * s->x[k];
  const double own = mean / 2 + 2 * change + ROUNDING * ROUNDING * size / m + 1e-18, next = mean / 4 - change;
  for (int i = 0; i < m; ++i) s->S[i][i] += own;
  for (int i = 0; i + 1 < m; ++i) s->S[i][i + 1] += next;
}

/* S = R' R with R in the upper triangle; return log det S, NaN if S is not positive definite. */
static double factorised(double (*S)[INTERVALS], int m) {
  double log_det = 0;
  for (int k = 0; k < m; ++k) {
    if (!(S[k][k] > 0)) return NAN;
    const double pivot = sqrt(S[k][k]);
    log_det += 2 * log(pivot);
    S[k][k] = pivot;
    for (int j = k + 1; j < m; ++j) S[k][j] /= pivot;
    for (int i = k + 1; i < m; ++i) {
      const double a = S[k][i];
      for (int j = i; j < m; ++j) S[i][j] -= a * S[k][j];
    }
  }
  return log_det;
}

/* Return the squared norm of y - factor x in units of S = R' R. */
static double distance(double (*R)[INTERVALS], int m, const double* y, double factor, const double* x) {
  double d[INTERVALS], sum = 0;
  for (int k = 0; k < m; ++k) d[k] = y[k] - factor * x[k];
  for (int k = 0; k < m; ++k) {
    d[k] /= R[k][k];
    for (int j = k + 1; j < m; ++j) d[j] -= R[k][j] * d[k];
    sum += d[k] * d[k];
  }
  return sum;
}

static double squares(const struct sides* s) {
  double sum = 0;
  for (int k = 0; k < s->m; ++k) sum += (s->y[k] - s->x[k]) * (s->y[k] - s->x[k]);
  return sum / s->m;
}

/* x delayed by `late` intervals; `before` it is another value. */
static void delayed(double* to, const double* x, int m, int late, double before) {
  for (int k = 0; k < m; ++k) to[k] = k < late ? before : x[k - late];
}

/* x through a low-pass of first order with a time constant in intervals; `before` it rests at another value. */
static void filtered(double* to, const double* x, int m, double constant, double before) {
  for (int k = 0; k < m; ++k) to[k] = before += (x[k] - before) / (1 + constant);
}

/* ---- Signals ---------------------------------------------------------------------------------------------------- */

/* Variance of the noise of a smooth signal, from its differences of fourth order. */
static double noise_of(const double* values, int states) {
  double d[FJR_WINDOW], sum = 0;
  copy(d, values, states);
  for (int order = 1; order <= 4; ++order)
    for (int k = 0; k < states - order; ++k) d[k] = d[k + 1] - d[k];
  for (int k = 0; k < states - 4; ++k) sum += d[k] * d[k];
  return DOUBT * (sum / (states - 4)) / 70;
}

/* Write orthonormal polynomials of time (Gram) by their recurrence. */
static void take_polynomials(struct fjr_comparison* c) {
  const double m = c->intervals;
  double before = 0;
  fill(c->motion[0], 1 / sqrt(m), c->intervals);
  for (int order = 1; order < MOTION; ++order) {
    const double *last = c->motion[order - 1], *older = c->motion[order > 1 ? order - 2 : 0];
    const double norm = order / 2.0 * sqrt((m * m - order * order) / (4.0 * order * order - 1));
    for (int k = 0; k < c->intervals; ++k)
      c->motion[order][k] = ((k - (m - 1) / 2) * last[k] - before * older[k]) / norm;
    before = norm;
  }
}

/* Write the components of x along the polynomials. */
static void slow_motion(const struct fjr_comparison* c, const double* x, double* to) {
  fill(to, 0, MOTION);
  for (int order = 0; order < MOTION; ++order)
    for (int k = 0; k < c->intervals; ++k) to[order] += c->motion[order][k] * x[k];
}

/* Means and slopes of the latest states. */
static void take_signals(const struct fjr_wiring* w, struct fjr_comparison* c) {
  const int states = w->count < FJR_WINDOW ? (int)w->count : FJR_WINDOW, m = states - 1;
  double h[INTERVALS], total = 0;
  int at[FJR_WINDOW];
  for (int k = 0; k < states; ++k) at[k] = (int)((w->count - states + k) % FJR_WINDOW);
  for (int k = 0; k < m; ++k) h[k] = w->t[at[k + 1]] - w->t[at[k]], total += h[k];
  c->intervals = m;
  take_polynomials(c);
  c->rate = 1 / (total / m * (total / m));
  for (int i = 0; i < 2 * N; ++i) {
    double q[FJR_WINDOW], dq[FJR_WINDOW];
    for (int k = 0; k < states; ++k) q[k] = w->q[at[k]][i], dq[k] = w->dq[at[k]][i];
    for (int k = 0; k < m; ++k) {
      c->q[i][k] = (q[k + 1] + q[k]) / 2, c->slope[i][k] = (q[k + 1] - q[k]) / h[k];
      c->dq[i][k] = (dq[k + 1] + dq[k]) / 2, c->change[i][k] = dq[k + 1] - dq[k];
      c->ddq[i][k] = c->change[i][k] / h[k];
    }
    c->q_noise[i] = noise_of(q, states), c->dq_noise[i] = noise_of(dq, states);
  }
  for (int i = 0; i < N; ++i) {
    c->ends[0][i] = w->q[at[0]][i], c->ends[1][i] = w->q[at[m]][i];
    for (int k = 0; k < m; ++k) c->u[i][k] = w->u[at[k]][i];
  }
}

static struct wires as_measured(void) {
  struct wires v;
  for (int i = 0; i < 2 * N; ++i) v.from[i] = i, v.sign[i] = 1;
  for (int i = 0; i < N; ++i) v.effort[i] = i, v.effort_sign[i] = 1;
  return v;
}

/* Evaluate the functions of the rigid arm; return 0 if one of them failed. */
static int evaluate_arm(const struct fjr_model* m, const struct fjr_comparison* c, const struct wires* v,
                        struct arm* arm) {
  const int middle = c->intervals / 2;
  double q[N], dq[N];
  for (int i = 0; i < N; ++i) q[i] = v->sign[i] * c->q[v->from[i]][middle];
  for (int i = 0; i < N; ++i) dq[i] = v->sign[i] * c->dq[v->from[i]][middle];
  m->arg[0] = q, m->arg[1] = dq, m->res[0] = arm->M, m->res[1] = arm->coriolis;
  if (m->dynamics(m->arg, m->res, m->iw, m->w, 0)) return 0;
  for (int end = 0; end < 2; ++end) {
    for (int i = 0; i < N; ++i) q[i] = v->sign[i] * c->ends[end][v->from[i]];
    m->arg[0] = q, m->res[0] = arm->weight[end];
    if (m->gravity(m->arg, m->res, m->iw, m->w, 0)) return 0;
  }
  fill(arm->coupled[0], 0, INTERVALS * INTERVALS);
  for (int i = 0; i < N; ++i) add_product(arm->coupled, c->intervals, arm->M[i * N + i], c->ddq[v->from[i]]);
  return 1;
}

/* Return the torque of the torsion curve of joint i at a deflection, and write its tangent. */
static double on_curve(const struct fjr_model* m, int i, double zeta, double* tangent) {
  int at = i;
  while (at / N + 1 < m->pieces && fabs(zeta) >= m->edge[at + N]) at += N;
  const double x = fabs(zeta) - m->edge[at];
  *tangent = m->tangent[at] + m->bend[at] * x;
  return copysign(m->torsion[at] + x * (m->tangent[at] + m->bend[at] * x / 2), zeta);
}

/* Write K (q_m - q_l) of joint i, or the torque on its curve. */
static void spring_torque(const struct fjr_model* m, const struct fjr_comparison* c, const struct wires* v, int i,
                          double* torque) {
  fill(torque, 0, c->intervals);
  for (int j = 0; j < N; ++j) {
    const double K = m->K[j * N + i], *q_l = c->q[v->from[j]], *q_m = c->q[v->from[N + j]];
    if (K == 0) continue;
    for (int k = 0; k < c->intervals; ++k) torque[k] += (v->sign[N + j] * q_m[k] - v->sign[j] * q_l[k]) * K;
  }
  if (m->cubic[i] == 0 && m->pieces == 0) return;
  for (int k = 0; k < c->intervals; ++k) {
    const double zeta = torque[k] / m->K[i * N + i];
    double tangent;
    torque[k] = m->pieces ? on_curve(m, i, zeta, &tangent) : torque[k] + m->cubic[i] * zeta * zeta * zeta;
  }
}

/* Add D dq + M ddq of joint i; first: 0 for links, N for motors. D, M: by rows. */
static void add_motion(const struct fjr_comparison* c, const struct wires* v, int first, int i, const double* M,
                       const double* D, double* motion, double* damping) {
  for (int j = 0; j < N; ++j) {
    const double sign = v->sign[first + j], inertia = sign * M[j * N + i], friction = sign * D[j * N + i];
    const double *ddq = c->ddq[v->from[first + j]], *dq = c->dq[v->from[first + j]];
    for (int k = 0; k < c->intervals; ++k) motion[k] += ddq[k] * inertia, damping[k] += dq[k] * friction;
  }
}

/* Add to S the noise that a row of torques has with the inertia M by rows. */
static void add_torque_noise(const struct fjr_model* m, const struct fjr_comparison* c, const struct wires* v,
                             int first, int i, const double* M, struct sides* s) {
  double mean = 0, change = 0;
  for (int j = 0; j < N; ++j) {
    const int middle = c->intervals / 2;
    const double zeta = v->sign[N + j] * c->q[v->from[N + j]][middle] - v->sign[j] * c->q[v->from[j]][middle];
    const double inertia = M[i * N + j];
    double K = m->K[i * N + j];
    if (i == j && m->pieces)
      on_curve(m, i, zeta, &K);
    else if (i == j)
      K += 3 * m->cubic[i] * zeta * zeta;
    mean += K * K * (c->q_noise[v->from[j]] + c->q_noise[v->from[N + j]]);
    change += c->rate * (inertia * inertia) * c->dq_noise[v->from[first + j]];
  }
  add_noise(s, c->intervals, mean, change);
}

/* ---- Rows ------------------------------------------------------------------------------------------------------- */

/* Write both sides of the link equation of joint i, with S unless it is not needed. */
static void link_row(const struct fjr_model* m, const struct fjr_comparison* c, const struct wires* v,
                     const struct arm* arm, int i, int needs_S, struct sides* s) {
  const int count = c->intervals;
  const double tolerance = TOLERANCE * TOLERANCE, first = arm->weight[0][i], step = arm->weight[1][i] - first;
  double weight[INTERVALS], damping[INTERVALS];
  spring_torque(m, c, v, i, s->x);
  fill(s->y, 0, count), fill(damping, 0, count);
  add_motion(c, v, 0, i, arm->M, m->D_l, s->y, damping);
  for (int k = 0; k < count; ++k) weight[k] = first + k / (count - 1.0) * step;
  for (int k = 0; k < count; ++k) s->y[k] += damping[k] + arm->coriolis[i] + weight[k];
  if (!needs_S) return;
  for (int a = 0; a < count; ++a)
    for (int b = a; b < count; ++b)
      s->S[a][b] = c->constant[i] * c->constant[i] + tolerance * arm->M[i * N + i] * arm->coupled[a][b];
  add_product(s->S, count, tolerance, s->x);
  add_product(s->S, count, tolerance, weight);
  add_torque_noise(m, c, v, 0, i, arm->M, s);
}

/* Write both sides of the motor equation of joint i, with S unless it is not needed. */
static void motor_row(const struct fjr_model* m, const struct fjr_comparison* c, const struct wires* v, int i,
                      int needs_S, struct sides* s) {
  const int count = c->intervals;
  const double tolerance = TOLERANCE * TOLERANCE;
  double spring[INTERVALS], motion[INTERVALS], damping[INTERVALS], late[INTERVALS];
  fill(s->x, 0, count), fill(motion, 0, count), fill(damping, 0, count);
  spring_torque(m, c, v, i, spring);
  add_motion(c, v, N, i, m->M_m, m->D_m, motion, damping);
  for (int k = 0; k < count; ++k) s->y[k] = motion[k] + spring[k] + damping[k];
  for (int j = 0; j < N; ++j) {
    const double B = v->effort_sign[j] * m->B_m[i * N + j], *u = c->u[v->effort[j]];
    for (int k = 0; k < count && B != 0; ++k) s->x[k] += u[k] * B;
  }
  if (!needs_S) return;
  for (int a = 0; a < count; ++a)
    for (int b = a; b < count; ++b) s->S[a][b] = c->constant[i] * c->constant[i];
  add_product(s->S, count, tolerance, spring);
  add_product(s->S, count, tolerance, motion);
  add_product(s->S, count, tolerance, s->x);
  for (int lag = 1; lag <= LAGS; ++lag) {
    delayed(late, s->x, count, lag, 0);
    for (int k = 0; k < count; ++k) late[k] -= s->x[k];
    add_product(s->S, count, LAG * LAG, late);
  }
  add_torque_noise(m, c, v, N, i, m->M_m, s);
}

static void torque_row(const struct fjr_model* m, const struct fjr_comparison* c, const struct wires* v,
                       const struct arm* arm, int row, int needs_S, struct sides* s) {
  s->m = c->intervals, s->freedom = FREEDOM * (s->m - 3);
  if (row < N)
    link_row(m, c, v, arm, row, needs_S, s);
  else
    motor_row(m, c, v, row - N, needs_S, s);
}

/* Write slow motion of encoder i by velocity and by slope with S, whose error of scale is relative to the slope. */
static void speed_row(const struct fjr_comparison* c, int i, struct sides* s) {
  const double *y = c->dq[i], *x = c->slope[i], rounding = ROUNDING * ROUNDING / c->intervals;
  double change[MOTION], left = 0, noise = 1e-18;
  s->m = MOTION, s->freedom = REST * (c->intervals - MOTION);
  slow_motion(c, y, s->y), slow_motion(c, x, s->x), slow_motion(c, c->change[i], change);
  for (int k = 0; k < c->intervals; ++k) {
    left += (y[k] - x[k]) * (y[k] - x[k]);
    noise += rounding * (y[k] * y[k] + x[k] * x[k]);
  }
  noise += (left - MOTION * squares(s)) / (c->intervals - MOTION);
  for (int a = 0; a < MOTION; ++a) fill(s->S[a], 0, MOTION), s->S[a][a] = noise;
  add_product(s->S, MOTION, SCALE * SCALE, s->x);
  add_product(s->S, MOTION, LATE * LATE, change);
}
