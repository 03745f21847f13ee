/* SPDX-License-Identifier: Apache-2.0
 * The closed loop of many runs: the control step that the node runs, with a simulated plant, sensors and delay.
 */

#define ROW (6 * N + 6)
#define TRACE (9 * N)

/* Fields of a row of results. */
struct sums {
  double *stable, *lost_at, *rms, *peak, *final, *settling, *effort_rms, *effort_peak;
  double *effort_noise, *power, *stopped, *cause;
};

struct run {
  int64_t number, sample;
  int going;
  const struct fjr_plant* plant;
  const double* parameters;
  double x[5 * N]; /* q_l, q_m, p_l, p_m, sliders of hysteresis */
  double* ring; /* (ring, N): the efforts sent last */
  struct sums sums;
  struct fjr_controller controller;
};

/* ---- Plant and sensors ------------------------------------------------------------------------------------------ */

/* A function that fails gives results that are not finite, which ends the run. */
static void evaluate(const struct fjr_model* m, fjr_function f, double* result, int n) {
  m->res[0] = result;
  if (f(m->arg, m->res, m->iw, m->w, 0)) fill(result, NAN, n);
}

static void plant_step(const struct fjr_model* m, struct run* r, const double* u, double dt) {
  double next[5 * N];
  m->arg[0] = r->x, m->arg[1] = u, m->arg[2] = r->parameters, m->arg[3] = &dt;
  evaluate(m, r->plant->step, next, 5 * N);
  copy(r->x, next, 5 * N);
}

static void plant_velocity(const struct fjr_model* m, const struct run* r, double* velocity) {
  m->arg[0] = r->x, m->arg[1] = r->parameters;
  evaluate(m, r->plant->velocity, velocity, 2 * N);
}

/* Add noise to positions and velocities, then quantise. sensing: position noise, velocity noise, resolution. */
static void disturb(const double* sensing, uint64_t seed, int64_t sample, double* position, double* velocity) {
  if (sensing[0] > 0 || sensing[1] > 0) {
    for (int i = 0; i < N; ++i) {
      double z[4];
      normals(seed, (uint64_t)sample, (uint64_t)i, z);
      for (int side = 0; side < 2; ++side) {
        position[side * N + i] += sensing[0] * z[side];
        velocity[side * N + i] += sensing[1] * z[2 + side];
      }
    }
  }
  if (sensing[2] > 0)
    for (int i = 0; i < 2 * N; ++i) position[i] = sensing[2] * rint(position[i] / sensing[2]);
}

/* Measure the plant as the measurement model of the controller expects it: motors behind the gear, or joint torques. */
static void take_sample(const struct fjr_model* m, const struct fjr_batch* b, const struct run* r,
                        const double* velocity, struct fjr_sample* sample) {
  double position[3 * N];
  copy(position, r->x, 2 * N);
  copy(position + 2 * N, r->x + 4 * N, N);
  copy(sample->velocity, velocity, 2 * N);
  disturb(b->sensing + 3 * r->number, b->seeds[r->number], r->sample, position, sample->velocity);
  copy(sample->link, position, N);
  for (int i = 0; i < N; ++i) {
    sample->motor[i] = position[N + i] * m->gear_ratio[i];
    sample->velocity[N + i] *= m->gear_ratio[i];
  }
  m->arg[0] = position, m->arg[1] = r->parameters;
  if (m->torque) evaluate(m, r->plant->torque, sample->motor, N);
}

/* ---- Results ---------------------------------------------------------------------------------------------------- */

static struct sums sums_of(double* row) {
  double* p = row;
  struct sums s;
  s.stable = p++, s.lost_at = p++;
  s.rms = p, s.peak = p += N, s.final = p += N, p += N;
  s.settling = p++, s.effort_rms = p, s.effort_peak = p += N, s.effort_noise = p += N, p += N;
  s.power = p++, s.stopped = p++, s.cause = p;
  return s;
}

/* Add the errors at a sample; return 0 if the run is lost. An arm that was stopped need not follow q_ld. */
static int add_errors(const struct fjr_batch* b, struct run* r, const double* q_ld) {
  struct sums* s = &r->sums;
  int inside = 1;
  for (int i = 0; i < N; ++i) {
    const double e = fabs(r->x[i] - q_ld[i]);
    inside &= e <= b->lost[i];
    if (e > b->band[i]) *s->settling = (double)(r->sample + 1);
    if (r->sample >= b->first) s->rms[i] += e * e, s->peak[i] = fmax(s->peak[i], e);
    if (r->sample >= b->last_second) s->final[i] += e;
  }
  return (inside || r->controller.supervisor.stopped) && all_finite(r->x, 4 * N);
}

static void add_efforts(const struct fjr_batch* b, struct run* r, const double* u, const double* velocity) {
  struct sums* s = &r->sums;
  const double* last = r->sample > 0 && r->sample >= b->first ? r->ring + (r->sample - 1) % b->ring * N : u;
  double drive[N], power = 0;
  multiply(drive, b->B_m, u);
  for (int i = 0; i < N; ++i) {
    s->effort_rms[i] += u[i] * u[i];
    s->effort_peak[i] = fmax(s->effort_peak[i], fabs(u[i]));
    s->effort_noise[i] += (u[i] - last[i]) * (u[i] - last[i]) / 2;
    power += drive[i] * velocity[N + i];
  }
  *s->power += fabs(power);
}

static void note_stop(const struct fjr_batch* b, struct run* r) {
  const int32_t cause = r->controller.supervisor.stopped;
  if (!cause || *r->sums.cause > 0) return;
  *r->sums.cause = cause;
  *r->sums.stopped = b->period * (double)r->sample;
}

static void record(const struct fjr_batch* b, const struct run* r, const double* u, const struct fjr_sample* sample) {
  double* at = b->trace + ((b->samples + 1) * r->number + r->sample) * TRACE;
  copy(at, r->x, 4 * N);
  copy(at + 4 * N, u, N);
  copy(at + 5 * N, sample->link, N);
  copy(at + 6 * N, sample->motor, N);
  copy(at + 7 * N, sample->velocity, 2 * N);
}

/* Convert sums to means; r->sample: number of efforts sent. */
static void finish(const struct fjr_batch* b, struct run* r) {
  struct sums* s = &r->sums;
  const int stable = r->sample > b->samples;
  const double count = r->sample > 0 ? (double)r->sample : 1;
  const int64_t begin = b->first > 0 ? b->first : 1; /* of the first change of the effort */
  const double changes = r->sample > begin ? (double)(r->sample - begin) : 1;
  *s->stable = stable;
  *s->lost_at = stable ? INFINITY : b->period * (double)r->sample;
  for (int i = 0; i < N; ++i) {
    s->rms[i] = stable ? sqrt(s->rms[i] / (double)(b->samples + 1 - b->first)) : INFINITY;
    s->peak[i] = stable ? s->peak[i] : INFINITY;
    s->final[i] = stable ? s->final[i] / (double)(b->samples + 1 - b->last_second) : INFINITY;
    s->effort_rms[i] = sqrt(s->effort_rms[i] / count);
    s->effort_noise[i] = sqrt(s->effort_noise[i] / changes);
  }
  *s->settling = stable && *s->settling <= (double)b->samples ? b->period * *s->settling : INFINITY;
  *s->power /= count;
}

/* ---- Reference -------------------------------------------------------------------------------------------------- */

/* The jets at the last two times, those of the sample and of the law's lead, which are the same for all runs. */
struct memo {
  const struct fjr_reference* reference;
  double t[2], jets[2][FJR_JETS * N];
  int next;
};

static void remembered_jets(void* context, double t, double* jets) {
  struct memo* memo = context;
  int k = memo->t[0] == t ? 0 : memo->t[1] == t ? 1 : -1;
  if (k < 0) {
    k = memo->next, memo->next = !k;
    memo->t[k] = t;
    fjr_reference_jets(memo->reference, t, memo->jets[k]);
  }
  copy(jets, memo->jets[k], FJR_JETS * N);
}

/* ---- Loop ------------------------------------------------------------------------------------------------------- */

static void start_run(const struct fjr_model* m, const struct fjr_batch* b, const struct fjr_reference* reference,
                      struct run* r, int64_t number, double* ring) {
  double* row = b->rows + ROW * number;
  r->number = number, r->sample = 0, r->going = 1, r->ring = ring, r->sums = sums_of(row);
  r->plant = b->is_full[number] ? &b->full : &b->plain;
  r->parameters = b->parameters + b->width * number;
  fill(row, 0, ROW);
  *r->sums.stopped = INFINITY;
  m->arg[0] = b->position, m->arg[1] = b->velocity, m->arg[2] = r->parameters;
  evaluate(m, r->plant->state, r->x, 4 * N);
  for (int i = 0; i < N; ++i) r->x[4 * N + i] = r->x[N + i] - r->x[i];
  fjr_init(&r->controller, b->settings, b->gains, reference);
  for (int i = 0; i < N; ++i)
    r->controller.settings.effort[i] = fmin(b->settings->effort[i], b->limit[N * number + i]);
}

/* Measure, control and account for a sample; return 0 if the run is lost. */
static int answer(const struct fjr_model* m, const struct fjr_batch* b, struct run* r, int64_t stamp,
                  const double* q_ld) {
  struct fjr_controller* c = &r->controller;
  struct fjr_sample sample = {.stamp = stamp};
  struct fjr_command command;
  double velocity[2 * N];
  if (!add_errors(b, r, q_ld)) return 0;
  plant_velocity(m, r, velocity);
  take_sample(m, b, r, velocity, &sample);
  fjr_step(m, c, &sample, stamp, &command);
  if (c->journal.not_finite) return 0;
  note_stop(b, r);
  add_efforts(b, r, c->limits.left, velocity);
  copy(r->ring + r->sample % b->ring * N, c->limits.left, N);
  if (b->trace) record(b, r, c->limits.left, &sample);
  return 1;
}

/* Integrate step `step` of a part of the sample period, if the run has one. */
static void integrate(const struct fjr_model* m, const struct fjr_batch* b, struct run* r, int part, int64_t step) {
  static const double none[N] = {0};
  const int64_t *segment = b->segments + 4 * r->number + 2 * part, age = segment[0];
  if (!r->going || step >= segment[1]) return;
  plant_step(m, r, r->sample >= age ? r->ring + (r->sample - age) % b->ring * N : none, b->dt[2 * r->number + part]);
}

/* Interleave LANES runs: the processor continues with the next one during a sine or division of another. */
static void run_some(const struct fjr_model* m, const struct fjr_batch* b, const struct fjr_reference* reference,
                     struct run* runs, int lanes) {
  int64_t steps[2] = {0, 0};
  int going = lanes;
  for (int i = 0; i < lanes; ++i)
    for (int part = 0; part < 2; ++part) {
      const int64_t own = b->segments[4 * runs[i].number + 2 * part + 1];
      steps[part] = own > steps[part] ? own : steps[part];
    }
  for (int64_t sample = 0; going && sample <= b->samples && !b->cancelled; ++sample) {
    const int64_t stamp = (int64_t)rint(1e9 * b->period * (double)sample);
    double jets[FJR_JETS * N];
    fjr_reference_jets(reference, (double)stamp * 1e-9, jets);
    for (int i = 0; i < lanes; ++i)
      if (runs[i].going && !(runs[i].going = answer(m, b, runs + i, stamp, jets))) --going;
    for (int part = 0; part < 2 && sample < b->samples; ++part)
      for (int64_t step = 0; step < steps[part]; ++step)
        for (int i = 0; i < lanes; ++i) integrate(m, b, runs + i, part, step);
    for (int i = 0; i < lanes; ++i) runs[i].sample += runs[i].going;
  }
}

void fjr_run_batch(const struct fjr_model* m, const struct fjr_batch* b, int64_t begin, int64_t end, double* rings) {
  struct run runs[LANES];
  struct memo memo = {.reference = b->reference, .t = {NAN, NAN}};
  const struct fjr_reference reference = {.kind = FJR_FUNCTION, .jets = remembered_jets, .context = &memo};
  for (; begin < end && !b->cancelled; begin += LANES) {
    const int lanes = end - begin < LANES ? (int)(end - begin) : LANES;
    for (int i = 0; i < lanes; ++i) start_run(m, b, &reference, runs + i, begin + i, rings + i * b->ring * N);
    run_some(m, b, &reference, runs, lanes);
    for (int i = 0; i < lanes; ++i) finish(b, runs + i);
  }
}

void fjr_noise(uint64_t seed, uint64_t sample, int64_t joints, double* z) {
  for (int64_t i = 0; i < joints; ++i) normals(seed, sample, (uint64_t)i, z + 4 * i);
}
