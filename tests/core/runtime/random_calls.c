/* SPDX-License-Identifier: Apache-2.0
 * Call the control step at random, as a program behind its text: print a digest of all commands, or abort at an effort
 * that is not finite, beyond its limit or changes faster than its limit. Argument: the number of controllers.
 */
#include <stdio.h>
#include <stdlib.h>

enum { CALLS = 2000 };
#define MILLISECOND INT64_C(1000000)

static uint64_t state;
static uint64_t digest = UINT64_C(14695981039346656037);

static uint64_t number(uint64_t below) {
  state ^= state << 13, state ^= state >> 7, state ^= state << 17;
  return (state >> 20) % below;
}

static int rarely(uint64_t times) { return number(times) == 0; }

static double uniform(double low, double high) { return low + (high - low) * (double)number(1 << 24) / (1 << 24); }

/* Mostly small, sometimes anything that a double can be. */
static double wild(void) {
  const double values[] = {0, -0.0, NAN, INFINITY, -INFINITY, 1e308, -1e308, 1e160, 1e100, 1e9, 5e-324};
  return rarely(400) ? values[number(11)] : uniform(-0.6, 0.6);
}

static double maybe(double otherwise, double low, double high) { return rarely(2) ? otherwise : uniform(low, high); }

static void add(double value) {
  uint64_t bits;
  if (isnan(value)) value = 0.123;
  memcpy(&bits, &value, sizeof bits);
  digest = (digest ^ bits) * UINT64_C(1099511628211);
}

/* ---- Model ------------------------------------------------------------------------------------------------------ */

static int law(const double** arg, double** res, long long int* iw, double* w, int mem) {
  const double *q = arg[0], *dq = arg[1], *jets = arg[2], *gains = arg[3], *memory = arg[4], *sent = arg[5];
  (void)iw, (void)w, (void)mem;
  if (q[0] > 0.599) return 1;
  *res[1] = 0;
  for (int i = 0; i < N; ++i) {
    const double e = q[i] - jets[i];
    res[0][i] = jets[2 * N + i] - gains[0] * e - gains[1] * (dq[i] - jets[N + i]) + 0.1 * memory[0];
    *res[1] += e * e;
  }
  for (int k = 0; k < FJR_MEMORY; ++k) res[2][k] = memory[k] + *arg[6] * (sent[0] - memory[k]);
  return 0;
}

static int gravity(const double** arg, double** res, long long int* iw, double* w, int mem) {
  (void)iw, (void)w, (void)mem;
  for (int i = 0; i < N; ++i) res[0][i] = sin(arg[0][i]);
  return 0;
}

static int observer(const double** arg, double** res, long long int* iw, double* w, int mem) {
  const double *x = arg[0], *y = arg[1], *gain = arg[4], dt = *arg[3];
  (void)iw, (void)w, (void)mem;
  for (int i = 0; i < 2 * N; ++i) {
    const double q = x[i] + dt * x[2 * N + i], dq = x[2 * N + i] + dt * arg[2][i % N];
    res[0][i] = q + gain[0] * (y[i] - q);
    res[0][2 * N + i] = dq + gain[1] * (y[i] - q);
  }
  return 0;
}

static int dynamics(const double** arg, double** res, long long int* iw, double* w, int mem) {
  (void)iw, (void)w, (void)mem;
  for (int i = 0; i < N; ++i) {
    for (int j = 0; j < N; ++j) res[0][i * N + j] = i == j ? 0.3 : 0.1 * cos(arg[0][i] - arg[0][j]);
    res[1][i] = 0.1 * sin(arg[0][i]) * arg[1][i] * arg[1][i];
  }
  return arg[0][0] > 0.5999;
}

static void random_model(struct fjr_model* m) {
  static const double *arg[8];
  static double *res[4], w[1];
  static long long int iw[1];
  memset(m, 0, sizeof *m);
  m->law = law, m->gravity = gravity, m->observer = rarely(2) ? observer : 0, m->dynamics = rarely(2) ? dynamics : 0;
  m->has_memory = rarely(2), m->simulated = rarely(2), m->lead = rarely(2) ? 3 * MILLISECOND : 0;
  m->bandwidth = uniform(10, 300), m->torque = rarely(4);
  for (int i = 0; i < N; ++i) m->gear_ratio[i] = maybe(1, 0.5, 2), m->compliance[i * N + i] = uniform(0, 1);
  for (int i = 0; i < N * N; ++i) {
    const int own = i % (N + 1) == 0;
    m->K[i] = own ? uniform(1, 30) : maybe(0, -0.1, 0.1), m->M_m[i] = own ? uniform(0.001, 1) : 0;
    m->B_m[i] = own ? uniform(0.5, 2) : maybe(0, -0.1, 0.1), m->D_l[i] = m->D_m[i] = own ? 0.1 : 0;
  }
  m->arg = arg, m->res = res, m->iw = iw, m->w = w;
}

static void random_settings(struct fjr_settings* s) {
  memset(s, 0, sizeof *s);
  for (int i = 0; i < N; ++i) {
    s->effort[i] = maybe(INFINITY, 0.1, 9), s->effort_rate[i] = maybe(INFINITY, 1, 1e4);
    s->start_error[i] = maybe(INFINITY, 0.2, 2);
    s->acceleration[i] = maybe(INFINITY, 0, 20);
    s->B_inverse[i * N + i] = 1, s->hold_damping[i * N + i] = uniform(0, 9);
  }
  for (int i = 0; i < 6 * N; ++i) {
    const double limit = rarely(6) ? uniform(0.5, 1.5) : (double)INFINITY;
    s->lower[i] = -limit, s->upper[i] = limit;
  }
  s->state_timeout = (int64_t)(1 + number(500)) * MILLISECOND;
  s->ramp_time = maybe(0, 0.001, 0.05), s->start_join_time = maybe(0, 0.001, 0.5);
  s->recovery_join_time = maybe(0, 0.001, 0.5), s->hold_deceleration = uniform(0.1, 9), s->gravity_hold = rarely(2);
  s->wiring_check = !rarely(4);
}

static void own_jets(void* context, double t, double* jets) {
  (void)context;
  for (int k = 0; k < FJR_JETS * N; ++k) jets[k] = t > 1e6 ? (double)NAN : 0.1 * sin(t);
}

/* One reference of each kind; the fourth continues the second from 0.1 s on. */
static void make_references(struct fjr_reference* r) {
  static double amplitude[2 * N], frequency[2 * N], phase[2 * N], from[FJR_JETS * N], to[FJR_JETS * N];
  static struct fjr_segment joint, angle;
  static const double rest[FJR_JETS] = {0}, turned[FJR_JETS] = {1};
  for (int i = 0; i < 2 * N; ++i) amplitude[i] = 0.1 * (i + 1), frequency[i] = i + 1, phase[i] = 0.2 * i;
  for (int i = 0; i < N; ++i) from[i] = 0.1, to[i] = 0.4;
  if (!make_segment(&joint, from, to, 0, 0.2)) abort();
  memset(r, 0, 5 * sizeof *r);
  for (int kind = 0; kind < 5; ++kind) r[kind].kind = kind, r[kind].end = INFINITY;
  r[FJR_SINES].terms = 2, r[FJR_SINES].amplitude = amplitude;
  r[FJR_SINES].frequency = frequency, r[FJR_SINES].phase = phase;
  const struct fjr_polynomials p = {3, joint.edge, joint.origin, joint.rate, joint.coefficients};
  r[FJR_POLYNOMIALS].polynomials = p, r[FJR_POLYNOMIALS].period = 0.3;
  r[FJR_FUNCTION].jets = own_jets;
  r[FJR_CIRCLE].radius = 0.2, r[FJR_CIRCLE].until = 0.1, r[FJR_CIRCLE].then = &r[FJR_SINES];
  if (N == 1 && make_segment(&angle, rest, turned, 0, 0.2)) {
    const struct fjr_polynomials turn = {3, angle.edge, angle.origin, angle.rate, angle.coefficients};
    r[FJR_CIRCLE].polynomials = turn;
  } else {
    r[FJR_CIRCLE].kind = FJR_HOLD;
  }
}

/* ---- Calls ------------------------------------------------------------------------------------------------------ */

static double sent[N]; /* last effort; at first zero */
static int64_t sent_at;
static int rates_apply; /* not before the sample after another limit */

/* Check the rates since the last effort, over the time between the stamps, at most the timeout. */
static void check_rates(const struct fjr_controller* c, const double* u, int64_t stamp) {
  const int64_t since = sent_at == FJR_NEVER || stamp < sent_at ? 0 : stamp - sent_at;
  const double dt = 1e-9 * (double)(since < c->stamps.timeout ? since : c->stamps.timeout);
  for (int i = 0; i < N; ++i) {
    const double rate = c->settings.effort_rate[i], most = rate < (double)INFINITY ? rate * dt : rate;
    if (rates_apply && fabs(u[i] - sent[i]) > most * (1 + 1e-9) + 1e-12) abort();
  }
  sent_at = stamp, rates_apply = 1;
}

static void check_effort(const struct fjr_controller* c, const double* u) {
  for (int i = 0; i < N; ++i) {
    if (!isfinite(u[i]) || fabs(u[i]) > c->settings.effort[i]) abort();
    add(u[i]);
  }
}

static void stop_sent(const struct fjr_controller* c, const double* u) {
  check_effort(c, u), memcpy(sent, u, sizeof sent);
}

static int64_t next_stamp(int64_t stamp) {
  const int64_t far[] = {0, -1, 5, 400, 700, 10000, -300, -2000, INT64_C(1000000000000)};
  stamp += (rarely(30) ? far[number(9)] : 1) * MILLISECOND;
  return stamp > INT64_C(2000000000000000000) ? 0 : stamp;
}

static void sample_once(const struct fjr_model* m, struct fjr_controller* c, int64_t stamp, int64_t arrival) {
  struct fjr_sample sample;
  struct fjr_command command;
  sample.stamp = stamp;
  for (int i = 0; i < N; ++i) sample.link[i] = wild(), sample.motor[i] = wild();
  for (int i = 0; i < 2 * N; ++i) sample.velocity[i] = wild();
  memset(&command, 0, sizeof command);
  if (!fjr_step(m, c, &sample, arrival, &command)) return;
  check_effort(c, command.u), check_rates(c, command.u, stamp);
  memcpy(sent, command.u, sizeof sent);
  for (int k = 0; k < FJR_JETS * N; ++k) add(command.jets[k]);
  add(command.V), add(command.state), add((double)command.bound_start);
}

static void act(const struct fjr_model* m, struct fjr_controller* c, const struct fjr_reference* references,
                int64_t stamp, int64_t arrival) {
  static const double gains[] = {9, 3, 4, 1}, damping[N * N];
  double u[N], jets[FJR_JETS * N];
  const struct fjr_reference* reference = &references[number(5)];
  struct fjr_settings settings;
  switch (number(10)) {
    case 0: if (fjr_silence(m, c, arrival, u)) stop_sent(c, u); break;
    case 1: fjr_stop_effort(m, c, u), stop_sent(c, u); break;
    case 2: fjr_start(c, rarely(2) ? 0 : reference); break;
    case 3: random_settings(&settings), fjr_apply(c, &settings), rates_apply = 0; break;
    case 4: fjr_use_gains(c, gains + 2 * number(2), damping); break;
    case 5: fjr_follow(c, reference, rarely(2) ? FJR_NEVER : stamp + 3 * MILLISECOND); break;
    case 6: fjr_hold(c); break;
    case 7: fjr_resume(c); break;
    case 8: fjr_check_wiring(m, c); break;
    default: fjr_jets_at(c, stamp, jets), add(jets[0]), add(fjr_state_of(c));
  }
}

int main(int argc, char** argv) {
  static const double gains[] = {4, 1};
  static struct fjr_model m;
  static struct fjr_controller c;
  static struct fjr_reference references[5];
  struct fjr_settings settings;
  make_references(references);
  for (int64_t k = 0; k < (argc > 1 ? atol(argv[1]) : 1); ++k) {
    int64_t stamp = 0, arrival = 0;
    state = UINT64_C(88172645463325252) + (uint64_t)k;
    for (int i = 0; i < 9; ++i) number(2);
    random_model(&m), random_settings(&settings);
    fjr_init(&c, &settings, gains, &references[number(5)]);
    memset(sent, 0, sizeof sent), sent_at = FJR_NEVER, rates_apply = 1;
    for (int call = 0; call < CALLS; ++call) {
      stamp = next_stamp(stamp), arrival += (rarely(50) ? 700 : 1) * MILLISECOND;
      if (rarely(10)) act(&m, &c, references, stamp, arrival);
      sample_once(&m, &c, stamp, arrival);
    }
    for (int kind = 0; kind < FJR_KINDS; ++kind) add((double)c.journal.count[kind]);
  }
  printf("%016llx\n", (unsigned long long)digest);
  return 0;
}
