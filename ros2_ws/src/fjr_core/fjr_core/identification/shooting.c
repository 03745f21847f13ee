/* SPDX-License-Identifier: Apache-2.0
 * Integrate an elastic arm and its sensitivities over one segment of a record, Runge-Kutta 4 with piecewise linear efforts.
 * N joints, M columns of sensitivities: the initial state (4 N), then parameters.
 */

/* dS = (S_v, A S + P); x and S are states in the order (q_l, q_m, v_l, v_m). */
static int derivative(const struct fjr_arm* m, const double* x, const double* S, const double* u, const double* du,
                      const double* parameters, double* dx, double* dS) {
  m->arg[0] = x, m->arg[1] = u, m->arg[2] = parameters;
  m->res[0] = dx + 2 * N, m->res[1] = m->nonzeros;
  if (m->f(m->arg, m->res, m->iw, m->w, 0)) return 1;
  memcpy(dx, x + 2 * N, 2 * N * sizeof *dx);
  memcpy(dS, S + 2 * N * M, 2 * N * M * sizeof *dS);
  memset(dS + 2 * N * M, 0, 2 * N * M * sizeof *dS);
  for (int64_t k = 0; k < m->count; ++k) {
    const double d = m->nonzeros[k];
    const int32_t column = m->column[k], joint = m->joint[k];
    double* target = dS + (2 * N + m->row[k]) * M;
    if (column < 0) continue;
    if (joint >= 0) {
      target[column] += d * du[joint];
    } else if (column < 4 * N) {
      const double* source = S + column * M;
      for (int c = 0; c < M; ++c) target[c] += d * source[c];
    } else {
      target[column] += d;
    }
  }
  return 0;
}

static void advance(const double* a, const double* b, double h, double* sum, int n) {
  for (int i = 0; i < n; ++i) sum[i] = a[i] + h * b[i];
}

/* One step of length h; work: 12 N (M + 1) numbers. */
static int step(const struct fjr_arm* m, double* x, double* S, const double* u, const double* du,
                const double* parameters, double h, double* work) {
  static const double node[4] = {0, 0.5, 0.5, 1}, weight[4] = {1. / 6, 1. / 3, 1. / 3, 1. / 6};
  double effort[N], d_effort[N], *at = work, *slope = at + 4 * N * (M + 1), *sum = slope + 4 * N * (M + 1);
  memcpy(sum, x, 4 * N * sizeof *x);
  memcpy(sum + 4 * N, S, 4 * N * M * sizeof *S);
  memset(slope, 0, 4 * N * (M + 1) * sizeof *slope);
  for (int stage = 0; stage < 4; ++stage) {
    advance(x, slope, h * node[stage], at, 4 * N);
    advance(S, slope + 4 * N, h * node[stage], at + 4 * N, 4 * N * M);
    advance(u, u + N, 2 * node[stage] - 1, effort, N);
    advance(du, du + N, 2 * node[stage] - 1, d_effort, N);
    if (derivative(m, at, at + 4 * N, effort, d_effort, parameters, slope, slope + 4 * N)) return 1;
    advance(sum, slope, h * weight[stage], sum, 4 * N * (M + 1));
  }
  memcpy(x, sum, 4 * N * sizeof *x);
  memcpy(S, sum + 4 * N, 4 * N * M * sizeof *S);
  return 0;
}

static double held(const struct fjr_input* input, double k, int joint) {
  const double last = (double)(input->count - 1);
  return input->u[(int64_t)(k < 0 ? 0 : k > last ? last : k) * N + joint];
}

/* The effort switches once at most in a part. The line has its mean and its first moment, so that velocities and
 * positions are exact where nothing else acts; unlike a sample of u it is continuous in the delay. */
void fjr_line(const struct fjr_input* input, int64_t k, int64_t part, int64_t parts, double* u, double* du) {
  for (int j = 0; j < N; ++j) {
    const double start = (double)(input->first + k) + (double)part / (double)parts - input->delay[j];
    const double index = floor(start), until = (index + 1 - start) * (double)parts, share = until < 1 ? until : 1;
    const double before = held(input, index, j), jump = until > 1 ? 0 : held(input, index + 1, j) - before;
    const double rate = jump * (double)parts / input->dt;
    u[j] = before + (1 - share) * jump, u[N + j] = 3 * share * (1 - share) * jump;
    du[j] = -rate, du[N + j] = 3 * (1 - 2 * share) * rate;
  }
}

static int64_t parts_at(const struct fjr_input* input, const double* x) {
  int32_t most = input->parts[0];
  for (int i = 0; i < 2 * N; ++i)
    if (input->parts[1 + i] > most && fabs(x[2 * N + i]) < input->slow[i]) most = input->parts[1 + i];
  return most;
}

int fjr_shoot(const struct fjr_arm* m, const struct fjr_input* input, const double* parameters, int64_t samples,
              double* X, double* S, double* work) {
  for (int64_t k = 0; k < samples; ++k) {
    double *x = X + (k + 1) * 4 * N, *s = S + (k + 1) * 4 * N * M, u[2 * N], du[2 * N];
    memcpy(x, x - 4 * N, 4 * N * sizeof *x);
    memcpy(s, s - 4 * N * M, 4 * N * M * sizeof *s);
    const int64_t parts = parts_at(input, x);
    for (int64_t part = 0; part < parts; ++part) {
      fjr_line(input, k, part, parts, u, du);
      if (step(m, x, s, u, du, parameters, input->dt / (double)parts, work)) return 1;
    }
    for (int i = 0; i < 4 * N; ++i)
      if (!isfinite(x[i])) return 1;
  }
  return 0;
}
