/* SPDX-License-Identifier: Apache-2.0
 * The closed loop of many runs, round what CasADi wrote before it: law, and of each kind of plant step, velocity and
 * state. N: joints; PARAMETERS, GAINS, MEMORY: lengths; W, IW, ARG, RES: work space. python_loop.py is the same loop.
 */
#define JETS 5
#define ROW (5 * N + 4)

struct batch {
  long long samples, first, last_second, ring;
  double period, lost, band;
  const double *jets, *target;                  /* (samples + 1, JETS, N) at the lead of the law, (samples + 1, N) */
  const double *gains, *memory;                 /* (GAINS), (MEMORY) */
  const double *position, *velocity;            /* (2 N) at the start */
  const double *parameters, *sensing, *limit;   /* of each run (PARAMETERS), (3), (N) */
  const unsigned char* full;                    /* true if a run has friction or a payload */
  const long long* segments;                    /* (2, 2): age of the effort in samples, steps */
  const double* dt;                             /* (2) of the steps in each */
  const uint64_t* seeds;
  double *rows, *trace;                         /* (ROW) of each run; (samples + 1, 5 N) x and u of each run, or 0 */
};

struct work {
  const double* arg[ARG];
  double* res[RES];
  casadi_int iw[IW];
  double w[W];
};

static void plant_step(struct work* k, int full, const double* x, const double* u, const double* parameters, double dt,
                       double* next) {
  k->arg[0] = x, k->arg[1] = u, k->arg[2] = parameters, k->arg[3] = &dt, k->res[0] = next;
  (full ? full_step : plain_step)(k->arg, k->res, k->iw, k->w, 0);
}

static void plant_velocity(struct work* k, int full, const double* x, const double* parameters, double* velocity) {
  k->arg[0] = x, k->arg[1] = parameters, k->res[0] = velocity;
  (full ? full_velocity : plain_velocity)(k->arg, k->res, k->iw, k->w, 0);
}

static void plant_state(struct work* k, int full, const double* position, const double* velocity,
                        const double* parameters, double* x) {
  k->arg[0] = position, k->arg[1] = velocity, k->arg[2] = parameters, k->res[0] = x;
  (full ? full_state : plain_state)(k->arg, k->res, k->iw, k->w, 0);
}

/* Measure: add noise, then quantise. sensing: position noise, velocity noise, resolution. */
static void measure(const double* sensing, uint64_t seed, long long sample, double* position, double* velocity) {
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

/* Fields of a row of results. */
struct sums {
  double *stable, *lost_at, *rms, *peak, *final, *settling, *effort_rms, *effort_peak, *power;
};

static struct sums sums_of(double* row) {
  struct sums s = {row, row + 1, row + 2, row + 2 + N, row + 2 + 2 * N, row + 2 + 3 * N};
  s.effort_rms = s.settling + 1, s.effort_peak = s.effort_rms + N, s.power = s.effort_peak + N;
  return s;
}

/* Add the errors at a sample; return 0 if the run is lost. */
static int add_errors(const struct batch* c, long long sample, const double* x, struct sums* s) {
  double size = 0;
  int inside = 1;
  for (int i = 0; i < 4 * N; ++i) size += x[i] * x[i];
  for (int i = 0; i < N; ++i) {
    const double e = fabs(x[i] - c->target[sample * N + i]);
    inside &= e <= c->lost;
    if (e > c->band) *s->settling = (double)(sample + 1);
    if (sample >= c->first) s->rms[i] += e * e, s->peak[i] = fmax(s->peak[i], e);
    if (sample >= c->last_second) s->final[i] += e;
  }
  return inside && size < INFINITY;
}

static void add_efforts(const double* u, const double* velocity, struct sums* s) {
  double power = 0;
  for (int i = 0; i < N; ++i) {
    s->effort_rms[i] += u[i] * u[i];
    s->effort_peak[i] = fmax(s->effort_peak[i], fabs(u[i]));
    power += u[i] * velocity[N + i];
  }
  *s->power += fabs(power);
}

/* Convert sums to means; sample: number of efforts sent. */
static void finish(const struct batch* c, long long sample, struct sums* s) {
  const int stable = sample > c->samples;
  const double count = sample > 0 ? (double)sample : 1;
  *s->stable = stable;
  *s->lost_at = stable ? INFINITY : c->period * (double)sample;
  for (int i = 0; i < N; ++i) {
    s->rms[i] = stable ? sqrt(s->rms[i] / (double)(c->samples + 1 - c->first)) : INFINITY;
    s->peak[i] = stable ? s->peak[i] : INFINITY;
    s->final[i] = stable ? s->final[i] / (double)(c->samples + 1 - c->last_second) : INFINITY;
    s->effort_rms[i] = sqrt(s->effort_rms[i] / count);
  }
  *s->settling = stable && *s->settling <= (double)c->samples ? c->period * *s->settling : INFINITY;
  *s->power /= count;
}

/* Evaluate the law, saturate u and update its state; return 0 if u is not finite. */
static int command(struct work* k, const struct batch* c, const double* limit, const double* position,
                   const double* velocity, const double* jets, double dt, double* memory, double* u) {
  double next[MEMORY + 1], wanted[N], size = 0;
  k->arg[0] = position, k->arg[1] = velocity, k->arg[2] = jets, k->arg[3] = c->gains;
  k->arg[4] = memory, k->arg[5] = u, k->arg[6] = &dt;
  k->res[0] = wanted, k->res[1] = next;
  law(k->arg, k->res, k->iw, k->w, 0);
  for (int i = 0; i < MEMORY; ++i) memory[i] = next[i];
  for (int i = 0; i < N; ++i) {
    size += wanted[i] * wanted[i];
    u[i] = wanted[i] < -limit[i] ? -limit[i] : wanted[i] > limit[i] ? limit[i] : wanted[i];
  }
  return size < INFINITY;
}

/* State of a run. */
struct run {
  long long number, sample;
  int going;
  double x[4 * N], u[N], memory[MEMORY + 1];
  double* ring; /* (ring, N): the efforts sent last */
  struct sums sums;
};

static void start(struct work* k, const struct batch* c, struct run* r, long long number, double* ring) {
  double* row = c->rows + ROW * number;
  r->number = number, r->sample = 0, r->going = 1, r->ring = ring, r->sums = sums_of(row);
  for (int i = 0; i < ROW; ++i) row[i] = 0;
  for (int i = 0; i < N; ++i) r->u[i] = 0;
  for (int i = 0; i < MEMORY; ++i) r->memory[i] = c->memory[i];
  plant_state(k, c->full[number], c->position, c->velocity, c->parameters + PARAMETERS * number, r->x);
}

static void record(const struct batch* c, const struct run* r) {
  double* at = c->trace + ((c->samples + 1) * r->number + r->sample) * 5 * N;
  for (int i = 0; i < 4 * N; ++i) at[i] = r->x[i];
  for (int i = 0; i < N; ++i) at[4 * N + i] = r->u[i];
}

/* Evaluate errors, measurement and law at a sample; return 0 if the run is lost. */
static int sample_law(struct work* k, const struct batch* c, struct run* r) {
  const double* jets = c->jets + r->sample * JETS * N;
  double position[2 * N], exact[2 * N], velocity[2 * N];
  if (!add_errors(c, r->sample, r->x, &r->sums)) return 0;
  plant_velocity(k, c->full[r->number], r->x, c->parameters + PARAMETERS * r->number, exact);
  for (int i = 0; i < 2 * N; ++i) position[i] = r->x[i], velocity[i] = exact[i];
  measure(c->sensing + 3 * r->number, c->seeds[r->number], r->sample, position, velocity);
  if (!command(k, c, c->limit + N * r->number, position, velocity, jets, r->sample ? c->period : 0, r->memory, r->u))
    return 0;
  add_efforts(r->u, exact, &r->sums);
  for (int i = 0; i < N; ++i) r->ring[r->sample % c->ring * N + i] = r->u[i];
  if (c->trace) record(c, r);
  return 1;
}

/* Integrate step `step` of a part of the sample period, if the run has one. */
static void integrate(struct work* k, const struct batch* c, struct run* r, int part, long long step) {
  static const double none[N] = {0};
  const long long *segment = c->segments + 4 * r->number + 2 * part, age = segment[0];
  const double* u = r->sample >= age ? r->ring + (r->sample - age) % c->ring * N : none;
  double next[4 * N];
  if (!r->going || step >= segment[1]) return;
  plant_step(k, c->full[r->number], r->x, u, c->parameters + PARAMETERS * r->number, c->dt[2 * r->number + part], next);
  for (int i = 0; i < 4 * N; ++i) r->x[i] = next[i];
}

/* Interleave LANES runs: the processor continues with the next one during a sine or division of another. */
static void run_some(struct work* k, const struct batch* c, struct run* runs, int lanes) {
  long long steps[2] = {0, 0};
  int going = lanes;
  for (int i = 0; i < lanes; ++i)
    for (int part = 0; part < 2; ++part) {
      const long long own = c->segments[4 * runs[i].number + 2 * part + 1];
      steps[part] = own > steps[part] ? own : steps[part];
    }
  for (long long sample = 0; going && sample <= c->samples; ++sample) {
    for (int i = 0; i < lanes; ++i)
      if (runs[i].going && !(runs[i].going = sample_law(k, c, runs + i))) --going;
    for (int part = 0; part < 2 && sample < c->samples; ++part)
      for (long long step = 0; step < steps[part]; ++step)
        for (int i = 0; i < lanes; ++i) integrate(k, c, runs + i, part, step);
    for (int i = 0; i < lanes; ++i) runs[i].sample += runs[i].going;
  }
}

/* Run begin .. end. rings (LANES, ring, N): buffers of the last efforts. No state is shared between calls. */
void run_batch(const struct batch* c, long long begin, long long end, double* rings) {
  struct work k;
  struct run runs[LANES];
  for (; begin < end; begin += LANES) {
    const int lanes = end - begin < LANES ? (int)(end - begin) : LANES;
    for (int i = 0; i < lanes; ++i) start(&k, c, runs + i, begin + i, rings + i * c->ring * N);
    run_some(&k, c, runs, lanes);
    for (int i = 0; i < lanes; ++i) finish(c, runs[i].sample, &runs[i].sums);
  }
}

/* For tests: normal numbers (n, 4) of n joints at a sample. */
void noise_of(uint64_t seed, uint64_t sample, long long joints, double* z) {
  for (long long i = 0; i < joints; ++i) normals(seed, sample, (uint64_t)i, z + 4 * i);
}
