/* SPDX-License-Identifier: Apache-2.0
 * Contact: external torques on the links that the stated errors of the model do not explain, see ContactObserver.
 *
 *   e = r + Z d,  S = Z P Z' + N        contact: e' S^-1 e > limit, until it stays below a quarter of that for QUIET
 *
 * N contains the error of the trapezoidal rule that r is computed by, so that a late state is no contact: dt^2 / 12 |f''|,
 * |f''| at most L times the largest |f'| of the last 1 / L, as for motions up to the bandwidth L. It also contains the
 * rounding of encoders with the step a, which the springs turn into torque: K^2 a^2 / 12 for each, as if it stayed.
 */
#define QUIET 200000000   /* ns; without torque until a contact has ended */
#define SIGNIFICANT 4.0   /* standard deviations from which a joint of a contact is named */
#define NEGLIGIBLE 0.05   /* of the largest torque, up to which it is not */
#define FINEST 1e-6       /* rad, m; a smaller change of an encoder shows no step, but rounding of its numbers */

/* Add the error of the trapezoidal rule from `kept` to `next`, dt [s] later; r forgets it. Where r restarts from 0, after
 * a jump of the stamps, a gap or values that are not finite, it has none. */
static void add_integration_error(struct fjr_torque_observer* o, double dt) {
  const double *before = o->kept + N * (1 + o->errors), *f = o->next + N * (1 + o->errors);
  const double stay = exp(-o->bandwidth * dt);
  const int restarts = dt < 0 || dt > LONGEST_GAP;
  for (int i = 0; i < N && dt != 0; ++i) {
    const double rate = fabs(f[i] - before[i]) / dt, error = o->bandwidth * dt * dt / 12 * fmax(rate, o->rate[i]);
    o->integration[i] = !restarts && isfinite(error) ? stay * o->integration[i] + (1 - stay) * error : 0;
    o->rate[i] = !restarts && isfinite(rate) ? fmax(rate, stay * o->rate[i]) : 0;
  }
}

/* Improve the steps of the encoders: first and second differences of their positions are multiples of the step. */
static void find_steps(struct fjr_torque_observer* o, const double* position) {
  for (int i = 0; i < 2 * N; ++i) {
    const double change = position[i] - o->seen[0][i], bend = change - (o->seen[0][i] - o->seen[1][i]);
    const double differences[2] = {fabs(change), fabs(bend)};
    for (int k = 0; k < 2; ++k)
      if (differences[k] > FINEST) o->step[i] = fmin(o->step[i], differences[k]);
    if (change != 0 && fabs(change) <= FINEST) o->step[i] = fmin(o->step[i], FINEST);
  }
}

/* Return the variance of r of joint i in an exact model [(N m)^2]. */
static double variance(const struct fjr_torque_observer* o, int i) {
  double rounding = 0;
  for (int k = 0; k < 2 * N; ++k) {
    const double K = o->K[i * N + k % N], a = o->step[k];
    rounding += K == 0 ? 0 : K * K * a * a / 12;
  }
  return o->noise[i] + o->integration[i] * o->integration[i] + rounding;
}

/* Write S, e and the thresholds; Z (N, errors) by columns. */
static void explain(struct fjr_torque_observer* o, const double* r) {
  const double* Z = r + N;
  double *e = o->compared, *threshold = e + N;
  const int m = o->errors;
  for (int i = 0; i < N; ++i) {
    double *W = o->W, s[N] = {0}, unexplained = r[i];
    fill(W, 0, m);
    s[i] = variance(o, i);
    for (int j = 0; j < m; ++j) {
      const double z = Z[j * N + i];
      unexplained += z * o->d[j];
      for (int k = 0; k < m && z != 0; ++k) W[k] += z * o->P[j * m + k];
    }
    for (int k = 0; k < m; ++k)
      for (int l = 0; l < N; ++l) s[l] += W[k] * Z[k * N + l];
    copy(o->S + i * N, s, N);
    e[i] = unexplained;
    threshold[i] = sqrt(o->limit * s[i]);
  }
}

/* Return e' S^-1 e = |A^-1 e|^2, S = A A', A lower triangular. */
static double squared_distance(const struct fjr_torque_observer* o) {
  double A[N * N], y[N], sum = 0;
  for (int i = 0; i < N; ++i) {
    for (int j = 0; j <= i; ++j) {
      double s = o->S[i * N + j];
      for (int k = 0; k < j; ++k) s -= A[i * N + k] * A[j * N + k];
      A[i * N + j] = i == j ? sqrt(s) : s / A[j * N + j];
    }
    y[i] = o->compared[i];
    for (int k = 0; k < i; ++k) y[i] -= A[i * N + k] * y[k];
    y[i] /= A[i * N + i];
    sum += y[i] * y[i];
  }
  return sum;
}

/* Improve d and P by one joint after the other, after a time in which the errors drift to the share 1 - stay. */
static void learn(struct fjr_torque_observer* o, const double* r) {
  const double *Z = r + N, stay = o->stay;
  const int m = o->errors;
  double* w = o->W;
  for (int k = 0; k < m * m; ++k) o->P[k] = stay * stay * o->P[k] + (k % (m + 1) ? 0 : 1 - stay * stay);
  for (int j = 0; j < m; ++j) o->d[j] *= stay;
  for (int i = 0; i < N; ++i) {
    double s = variance(o, i), e = r[i];
    fill(w, 0, m);
    for (int j = 0; j < m; ++j)
      for (int k = 0; k < m; ++k) w[k] += Z[j * N + i] * o->P[j * m + k];
    for (int j = 0; j < m; ++j) s += w[j] * Z[j * N + i], e += Z[j * N + i] * o->d[j];
    for (int j = 0; j < m; ++j) o->d[j] -= w[j] * e / s;
    for (int j = 0; j < m; ++j)
      for (int k = 0; k < m; ++k) o->P[j * m + k] -= w[j] * w[k] / s;
  }
}

/* Add the joints with a significant torque to those of the contact; the one furthest beyond its threshold is named. */
static void name_joints(const struct fjr_torque_observer* o, struct fjr_contact* c) {
  const double *e = o->compared, *threshold = e + N, deviations = sqrt(o->limit);
  double most = 0, furthest = 0;
  for (int i = 0; i < N; ++i) most = fmax(most, fabs(e[i]));
  for (int i = 0; i < N; ++i) {
    const double size = fabs(e[i]) / threshold[i];
    if (size * deviations > SIGNIFICANT && fabs(e[i]) > NEGLIGIBLE * most) c->joints |= 1 << i % 31;
    if (size <= furthest) continue;
    furthest = size;
    if (!c->acting) c->joint = i, c->value = e[i], c->limit = threshold[i];
  }
  c->joints |= 1 << c->joint % 31;
}

/* Tell whether there is contact at the sample with this stamp; r: of the observer, with Z. */
static void watch_contact(struct fjr_torque_observer* o, struct fjr_contact* c, const double* r, int64_t stamp) {
  explain(o, r);
  const double D = squared_distance(o);
  if (!(D <= (c->acting ? o->limit / 4 : o->limit))) { /* also if rounding has left no distance */
    if (!c->acting) c->joints = 0;
    name_joints(o, c);
    c->acting = 1, c->stamp = stamp;
  } else if (c->acting) {
    c->acting = stamp >= c->stamp && stamp - c->stamp < QUIET;
  } else if (stamp < o->learned || stamp - o->learned >= o->period) {
    learn(o, r);
    o->learned = stamp;
  }
}
