/* SPDX-License-Identifier: Apache-2.0
 * The certificate of a sample: storage V and energy H with their exact rates (monitoring/certificate.py), the bound on
 * V, and the innovation of the interval since the sample before.
 */
#define NO_BOUND (-1.0) /* J; a storage is never negative */

static double dot(const double* a, const double* b, int n) {
  double sum = 0;
  for (int i = 0; i < n; ++i) sum += a[i] * b[i];
  return sum;
}

void fjr_certificate_restart(struct fjr_certificate* c) {
  c->follows = 0;
  c->bound_start = FJR_NEVER;
  c->bound = NO_BOUND;
}

/* Predict the state from the last one under the effort held for dt. */
static int predict(struct fjr_certificate* c, double dt, double* position, double* velocity) {
  c->arg[0] = c->position, c->arg[1] = c->velocity, c->arg[2] = c->u, c->arg[3] = &dt;
  c->res[0] = position, c->res[1] = velocity;
  return !c->predict(c->arg, c->res, c->iw, c->w, 0);
}

static int storage(struct fjr_certificate* c, const double* position, const double* velocity, const double* jets,
                   double* V) {
  c->arg[0] = position, c->arg[1] = velocity, c->arg[2] = jets, c->arg[3] = c->gains;
  c->res[0] = 0, c->res[1] = V;
  return !c->law(c->arg, c->res, c->iw, c->w, 0);
}

static int evaluate_certificate(struct fjr_certificate* c, const struct fjr_command* command,
                                struct fjr_certified* found) {
  c->arg[0] = command->position, c->arg[1] = command->velocity, c->arg[2] = command->jets, c->arg[3] = c->gains;
  c->res[0] = &c->V, c->res[1] = &found->H, c->res[2] = &c->dissipation, c->res[3] = &found->dissipated;
  c->res[4] = c->u_law, c->res[5] = c->drive, c->res[6] = found->slope;
  return !c->certify(c->arg, c->res, c->iw, c->w, 0);
}

/* Rates under the effort that was sent. */
static void write_rates(const struct fjr_certificate* c, const struct fjr_command* command,
                        struct fjr_certified* found) {
  double excess[N], torque[N];
  for (int i = 0; i < N; ++i) excess[i] = command->u[i] - c->u_law[i];
  for (int i = 0; i < N; ++i) torque[i] = dot(c->B_m + i * N, command->u, N);
  found->V = c->V;
  found->dV = dot(c->drive, excess, N) - c->dissipation;
  found->rate = found->dt != 0 ? (c->V - found->V0) / found->dt : 0;
  found->supplied = dot(command->velocity + N, torque, N);
}

/* The bound decays from V at its first sample. */
static void write_bound(struct fjr_certificate* c, int64_t start, double dt) {
  if (start == FJR_NEVER || !c->bounded) {
    c->bound_start = FJR_NEVER;
    c->bound = NO_BOUND;
  } else if (start != c->bound_start) {
    c->bound_start = start;
    c->bound = c->V;
  } else {
    c->bound *= exp(-2 * c->beta * dt);
  }
}

/* Keep the sample as the predecessor of the next one. */
static void keep(struct fjr_certificate* c, const struct fjr_command* command, int64_t stamp) {
  copy(c->older, c->follows ? c->u : command->u, N);
  copy(c->u, command->u, N);
  copy(c->position, command->position, 2 * N);
  copy(c->velocity, command->velocity, 2 * N);
  c->stamp = stamp, c->follows = isfinite(c->V) != 0;
}

int fjr_certify(struct fjr_certificate* c, const struct fjr_command* command, int64_t stamp,
                struct fjr_certified* found) {
  const double dt = (double)(stamp - c->stamp) * 1e-9;
  double position[2 * N], velocity[2 * N];
  if (command->restarted || !(dt > 0 && dt < c->longest)) c->follows = 0;
  const int predicts = c->follows && c->predict;
  found->follows = c->follows, found->dt = dt, found->V0 = c->V, found->predicted = NAN;
  copy(found->sent, c->u, N);
  copy(found->law, c->u_law, N);
  copy(found->older, c->older, N);
  if (predicts && !predict(c, dt, position, velocity)) return 0;
  if (!evaluate_certificate(c, command, found)) return 0;
  if (predicts && !storage(c, position, velocity, command->jets, &found->predicted)) return 0;
  for (int i = 0; predicts && i < 2 * N; ++i) {
    found->error[i] = command->position[i] - position[i];
    found->error[2 * N + i] = command->velocity[i] - velocity[i];
  }
  write_rates(c, command, found);
  write_bound(c, command->bound_start, dt);
  found->bound = c->bound;
  keep(c, command, stamp);
  const double sum = found->V + found->dV + found->rate + found->bound + found->H + found->supplied + found->dissipated;
  found->valid = found->follows && isfinite(sum);
  return 1;
}
