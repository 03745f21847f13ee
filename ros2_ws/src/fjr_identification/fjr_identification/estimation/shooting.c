/* SPDX-License-Identifier: Apache-2.0
 * Integrate an elastic arm and its sensitivities over one segment of a record, Runge-Kutta 4 with piecewise linear efforts.
 * N joints, M columns of sensitivities: the initial state (4 N), then parameters, then zeros up to a multiple of 8 L.
 */

/* Columns of sensitivities are integrated in blocks of L vectors, which stay in the cache during a step. */
typedef double vector __attribute__((vector_size(8 * sizeof(double)), aligned(sizeof(double)), may_alias));
typedef vector block[4 * N][L];
enum { BLOCKS = M / (8 * L) };

static const double node[4] = {0, 0.5, 0.5, 1}, weight[4] = {1. / 6, 1. / 3, 1. / 3, 1. / 6};

/* The velocities' part of A S + P at a stage; d: nonzeros of A and P there, du (2 N): derivatives of the efforts. */
static void slopes(const struct fjr_arm* m, int b, const double* d, const double* du, block S, vector (*slope)[L]) {
  memset(slope, 0, 2 * N * sizeof *slope);
  for (int32_t e = m->forced_start[b]; e < m->forced_start[b + 1]; ++e) {
    const int32_t joint = m->forced_joint[e], column = m->forced_column[e] - b * 8 * L;
    slope[m->forced_row[e]][column / 8][column % 8] += d[m->forced_entry[e]] * (joint < 0 ? 1 : du[joint]);
  }
  for (int i = 0; i < 2 * N; ++i) {
    vector sum[L];
    for (int l = 0; l < L; ++l) sum[l] = slope[i][l];
    for (int32_t e = m->row_start[i]; e < m->row_start[i + 1]; ++e) {
      const vector* source = S[m->column[e]];
      for (int l = 0; l < L; ++l) sum[l] += d[m->entry[e]] * source[l];
    }
    for (int l = 0; l < L; ++l) slope[i][l] = sum[l];
  }
}

/* One step of length h of block b of S (4 N, M), with what the state's step has left in m. */
static void step_block(const struct fjr_arm* m, int b, double (*du)[2 * N], double h, double* S) {
  block at = {0}, sum;
  vector slope[2 * N][L] = {0};
  for (int i = 0; i < 4 * N; ++i) memcpy(sum[i], S + i * M + b * 8 * L, sizeof sum[i]);
  for (int stage = 0; stage < 4; ++stage) {
    for (int i = 0; i < 2 * N; ++i) {
      const vector *position = (vector*)(S + i * M) + b * L, *velocity = (vector*)(S + (2 * N + i) * M) + b * L;
      for (int l = 0; l < L; ++l) {
        at[i][l] = position[l] + h * node[stage] * at[2 * N + i][l];
        at[2 * N + i][l] = velocity[l] + h * node[stage] * slope[i][l];
      }
    }
    slopes(m, b, m->nonzeros + stage * m->count, du[stage], at, slope);
    for (int i = 0; i < 2 * N; ++i)
      for (int l = 0; l < L; ++l) {
        sum[i][l] += h * weight[stage] * at[2 * N + i][l];
        sum[2 * N + i][l] += h * weight[stage] * slope[i][l];
      }
  }
  for (int i = 0; i < 4 * N; ++i) memcpy(S + i * M + b * 8 * L, sum[i], sizeof sum[i]);
}

static void advance(const double* a, const double* b, double h, double* sum, int n) {
  for (int i = 0; i < n; ++i) sum[i] = a[i] + h * b[i];
}

/* One step of length h of the state (q_l, q_m, v_l, v_m) and of S; u, du as fjr_line returns them. a: accelerations at
 * the end. */
static int step(const struct fjr_arm* m, double* x, double* S, const double* u, const double* du,
                const double* parameters, double h, double* a) {
  double effort[N], d_effort[4][2 * N], at[4 * N], slope[4 * N] = {0}, sum[4 * N];
  memcpy(sum, x, sizeof sum);
  m->arg[0] = at, m->arg[1] = effort, m->arg[2] = parameters, m->res[0] = slope + 2 * N;
  for (int stage = 0; stage < 4; ++stage) {
    advance(x, slope, h * node[stage], at, 4 * N);
    advance(u, u + N, 2 * node[stage] - 1, effort, N);
    advance(du, du + 2 * N, 2 * node[stage] - 1, d_effort[stage], 2 * N);
    m->res[1] = m->nonzeros + stage * m->count;
    if (m->f(m->arg, m->res, m->iw, m->w, 0)) return 1;
    memcpy(slope, at + 2 * N, 2 * N * sizeof *slope);
    advance(sum, slope, h * weight[stage], sum, 4 * N);
  }
  memcpy(x, sum, sizeof sum);
  memcpy(a, slope + 2 * N, 2 * N * sizeof *a);
  for (int b = 0; b < BLOCKS; ++b) step_block(m, b, d_effort, h, S);
  return 0;
}

static double held(const struct fjr_input* input, const double* u, double k, int joint) {
  const double last = (double)(input->count - 1);
  return u[(int64_t)(k < 0 ? 0 : k > last ? last : k) * N + joint];
}

static double mean_delay(double lag) { return (sqrt(1 + 4 * lag * lag) - 1) / 2; }

void fjr_behind(const double* u, const double* lag, int64_t count, double* out) {
  for (int j = 0; j < N; ++j) {
    const double m = mean_delay(lag[j]), a = m / (1 + m), slope = 1 / (1 + 2 * m) / (1 + m) / (1 + m);
    double w = u[j], dw = 0;
    for (int64_t k = j; k < count * N; k += N) {
      dw = slope * (w - u[k]) + a * dw;
      w = (1 - a) * u[k] + a * w;
      out[k] = w, out[count * N + k] = dw;
    }
  }
}

/* The effort switches once at most in a part. The line has its mean and its first moment, so that velocities and
 * positions are exact where nothing else acts; unlike a sample of u it is continuous in the delay. */
void fjr_line(const struct fjr_input* input, int64_t k, int64_t part, int64_t parts, double* u, double* du) {
  for (int j = 0; j < N; ++j) {
    const double m = mean_delay(input->lag[j]), by_square = 1 / input->dt / input->dt, slope = by_square / (1 + 2 * m);
    const double start = (double)(input->first + k) + (double)part / (double)parts - (input->delay[j] - m);
    const double index = floor(start), until = (index + 1 - start) * (double)parts, share = until < 1 ? until : 1;
    const double next = until > 1 ? index : index + 1, first = 3 * share * (1 - share);
    const double before = held(input, input->u, index, j), jump = held(input, input->u, next, j) - before;
    const double d_before = held(input, input->du, index, j), d_jump = held(input, input->du, next, j) - d_before;
    const double rate = jump * (double)parts / input->dt;
    u[j] = before + (1 - share) * jump, u[N + j] = first * jump;
    du[j] = -rate, du[2 * N + j] = 3 * (1 - 2 * share) * rate;
    du[N + j] = by_square * (d_before + (1 - share) * d_jump) - slope * input->dt * du[j];
    du[3 * N + j] = by_square * first * d_jump - slope * input->dt * du[2 * N + j];
  }
}

enum { HALVINGS = 10 }; /* of an integration step where friction turns over */

/* Whether a step of length h from velocities v, under accelerations a, stays away from turns of friction or follows them. */
static int follows(const struct fjr_input* input, const double* v, const double* a, double h) {
  for (int i = 0; i < 2 * N; ++i)
    if (h > input->rest[i] || (h > input->harmless[i] && fabs(a[i]) * h > input->passage[i]))
      if (fabs(v[i]) < input->slow[i] + 1.5 * fabs(a[i]) * h) return 0;
  return 1;
}

int fjr_shoot(const struct fjr_arm* m, const struct fjr_input* input, const double* parameters, int64_t samples,
              double* X, double* S) {
  const int64_t finest = (int64_t)input->parts << HALVINGS;
  double a[2 * N] = {0};
  for (int64_t k = 0; k < samples; ++k) {
    double *x = X + (k + 1) * 4 * N, *s = S + (k + 1) * 4 * N * M, u[2 * N], du[4 * N];
    memcpy(x, x - 4 * N, 4 * N * sizeof *x);
    memcpy(s, s - 4 * N * M, 4 * N * M * sizeof *s);
    for (int64_t at = 0, size; at < finest; at += size) {
      for (size = 1 << HALVINGS; at % size; size /= 2) continue;
      while (size > 1 && !follows(input, x + 2 * N, a, input->dt * (double)size / (double)finest)) size /= 2;
      fjr_line(input, k, at / size, finest / size, u, du);
      if (step(m, x, s, u, du, parameters, input->dt * (double)size / (double)finest, a)) return 1;
    }
    for (int i = 0; i < 4 * N; ++i)
      if (!isfinite(x[i])) return 1;
  }
  return 0;
}

void fjr_normal_equations(const double* J, const double* r, int64_t rows, int64_t columns, double* H, double* g) {
  enum { TOGETHER = 8 };
  for (int64_t first = 0; first < rows; first += TOGETHER) {
    const double* row[TOGETHER];
    for (int k = 0; k < TOGETHER; ++k) row[k] = J + (first + k < rows ? first + k : rows - 1) * columns;
    for (int64_t i = 0; i < columns; ++i) {
      double factor[TOGETHER];
      for (int k = 0; k < TOGETHER; ++k) factor[k] = first + k < rows ? row[k][i] : 0;
      for (int k = 0; k < TOGETHER; ++k) g[i] += factor[k] * r[first + k < rows ? first + k : rows - 1];
      for (int64_t j = i; j < columns; ++j) {
        double sum = 0;
        for (int k = 0; k < TOGETHER; ++k) sum += factor[k] * row[k][j];
        H[i * columns + j] += sum;
      }
    }
  }
  for (int64_t i = 0; i < columns; ++i)
    for (int64_t j = 0; j < i; ++j) H[i * columns + j] = H[j * columns + i];
}
