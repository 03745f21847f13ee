/* SPDX-License-Identifier: Apache-2.0
 * All functions but those of struct fjr_callbacks are static and run on the thread of the host.
 */
#define FIRST_UNSENDABLE 2147483648000000000 /* ns; the seconds of a stamp are a signed 32-bit integer */
#define PAUSED 10000000                      /* ns; a silence check that comes later follows a pause of this process */
#define TOGETHER 8                           /* samples certified at once, at most: the functions stay in the cache */
#define POSITIONS 0
#define VELOCITIES 1
#define EFFORTS 2

static int fail(struct fjr_controller_loop* l, const char* reason) {
  l->reason = reason;
  return FJR_FAILED;
}

/* ---- Messages -------------------------------------------------------------------------------------------------- */

/* Read a state into `sample`; return an enum fjr_reading or FJR_NO_STAMP. */
static int read_sample(struct fjr_controller_loop* l, const uint8_t* data, size_t size) {
  const struct fjr_joint_reader* r = l->reader;
  struct fjr_sample* s = &l->sample;
  const int found = fjr_read_joint_state(l->reader, data, size);
  if (found != FJR_READ) return found;
  if (r->stamp <= 0 || r->stamp >= FIRST_UNSENDABLE) return FJR_NO_STAMP;
  s->stamp = r->stamp;
  memcpy(s->link, r->value[POSITIONS], sizeof s->link);
  memcpy(s->motor, l->model->torque ? r->value[EFFORTS] : r->value[POSITIONS] + FJR_N, sizeof s->motor);
  if (r->value[VELOCITIES]) memcpy(s->velocity, r->value[VELOCITIES], sizeof s->velocity);
  return FJR_READ;
}

/* ---- Commands -------------------------------------------------------------------------------------------------- */

/* Publish a command on both topics; lock-step waits for the named one. */
static int send(struct fjr_controller_loop* l, int64_t stamp, const double* u) {
  int outcome = FJR_GO_ON;
  fjr_put_numbers(l->effort, 0, u);
  fjr_put_stamp(l->command, stamp);
  fjr_put_numbers(l->command, EFFORTS, u);
  if (l->simulated) outcome = l->publish(l->host, FJR_COMMANDS, l->command);
  if (outcome == FJR_GO_ON) outcome = l->publish(l->host, FJR_EFFORTS, l->effort);
  if (outcome == FJR_GO_ON && !l->simulated) outcome = l->publish(l->host, FJR_COMMANDS, l->command);
  return outcome;
}

/* Send the stop effort once per silence; now: of the clock of the arrivals, or of the stamps in simulated time. */
static int check_silence(struct fjr_controller_loop* l, int64_t now) {
  double u[FJR_N];
  if (!l->step.silence(l->model, l->controller, now, u) || !l->sends) return FJR_GO_ON;
  return send(l, l->last_stamp, u);
}

/* Send the stop effort if a command was sent. */
static int send_stop(struct fjr_controller_loop* l) {
  double u[FJR_N];
  if (!l->sends) return FJR_GO_ON;
  l->step.stop_effort(l->model, l->controller, u);
  l->sends = 0;
  return send(l, l->last_stamp, u);
}

/* Return 1 once it is known that nobody else commands the robot; the first call looks for others. */
static int is_alone(struct fjr_controller_loop* l) {
  int32_t known = __atomic_load_n(&l->alone, __ATOMIC_ACQUIRE);
  if (known == FJR_UNASKED) {
    known = l->has_others(l->known) ? FJR_NOT_ALONE : FJR_ALONE;
    __atomic_store_n(&l->alone, known, __ATOMIC_RELEASE);
  }
  return known == FJR_ALONE;
}

/* ---- After the command ----------------------------------------------------------------------------------------- */

static int publish_auxiliary(struct fjr_controller_loop* l) {
  const double *q_ld = l->result.jets, *dq_ld = l->result.jets + FJR_N;
  double q_tilde_l[FJR_N], dq_tilde_l[FJR_N];
  for (int i = 0; i < FJR_N; ++i) {
    q_tilde_l[i] = l->sample.link[i] - q_ld[i];
    dq_tilde_l[i] = l->result.velocity[i] - dq_ld[i];
  }
  fjr_put_stamp(l->reference, l->sample.stamp);
  fjr_put_numbers(l->reference, POSITIONS, q_ld);
  fjr_put_numbers(l->reference, VELOCITIES, dq_ld);
  fjr_put_stamp(l->error, l->sample.stamp);
  fjr_put_numbers(l->error, POSITIONS, q_tilde_l);
  fjr_put_numbers(l->error, VELOCITIES, dq_tilde_l);
  const int outcome = l->publish(l->host, FJR_REFERENCES, l->reference);
  return outcome == FJR_GO_ON ? l->publish(l->host, FJR_ERRORS, l->error) : outcome;
}

/* Estimate the external torques of the sample; due: publish them and the comparison with thresholds, if finite. */
static int observe_torque(struct fjr_controller_loop* l, int due) {
  double torque[FJR_N];
  const int known = l->step.observe_torque(l->observer, l->model, l->controller, &l->sample, torque);
  if (!known || !due) return FJR_GO_ON;
  fjr_put_stamp(l->torque, l->sample.stamp);
  fjr_put_numbers(l->torque, EFFORTS, torque);
  fjr_put_stamp(l->contact, l->sample.stamp);
  fjr_put_numbers(l->contact, EFFORTS, l->observer->compared);
  const int outcome = l->publish(l->host, FJR_TORQUES, l->torque);
  return outcome == FJR_GO_ON ? l->publish(l->host, FJR_CONTACT_TORQUES, l->contact) : outcome;
}

static int publish_certificate(struct fjr_controller_loop* l, int64_t stamp, const struct fjr_certified* f) {
  const double values[] = {(double)(stamp / SECOND), (double)(stamp % SECOND), f->V, f->dV, f->rate, f->bound, f->H,
                           f->supplied, f->dissipated};
  fjr_put_numbers(l->certified, 0, values);
  return l->publish(l->host, FJR_CERTIFICATES, l->certified);
}

/* Certify a sample; all before it are certified. */
static int certify(struct fjr_controller_loop* l, struct fjr_record* r, int due) {
  if (!l->certificate) return FJR_GO_ON;
  if (!l->step.certify(l->certificate, &r->command, r->sample.stamp, &r->certified))
    return fail(l, "the certificate cannot be evaluated");
  return due && r->certified.valid ? publish_certificate(l, r->sample.stamp, &r->certified) : FJR_GO_ON;
}

/* Certify the samples that wait for it, and hand them to Python; due: publish the certificate of the last one. */
static int hand_over(struct fjr_controller_loop* l, int due) {
  int outcome = FJR_GO_ON;
  for (; l->waiting && outcome == FJR_GO_ON; --l->waiting) {
    outcome = certify(l, fjr_ring_free(l->records, 0), due && l->waiting == 1);
    fjr_ring_commit(l->records);
  }
  return outcome;
}

/* Return a place in the queue, 0 if there is none; in simulated time wait for Python to make one. */
static struct fjr_record* place(struct fjr_controller_loop* l) {
  struct fjr_record* found;
  while (!(found = fjr_ring_free(l->records, l->waiting)))
    if (!l->simulated || hand_over(l, 0) != FJR_GO_ON || l->pause(l->host) != FJR_GO_ON) break;
  return found;
}

/* Keep a sample for Python; without a place in the queue it is only certified, and in real time counted as lost. */
static int keep(struct fjr_controller_loop* l, int64_t arrival, int64_t sent, int due) {
  struct fjr_record *found = place(l), *record = found ? found : &l->spare;
  record->arrival = arrival, record->sent = sent, record->sample = l->sample, record->command = l->result;
  if (found) return ++l->waiting == TOGETHER || due || !l->certificate ? hand_over(l, due) : FJR_GO_ON;
  int outcome = hand_over(l, 0);
  if (outcome == FJR_GO_ON) outcome = certify(l, record, due);
  if (!l->simulated) fjr_ring_lose(l->records);
  return l->simulated && outcome == FJR_GO_ON ? FJR_DONE : outcome;
}

static int answer(struct fjr_controller_loop* l, int64_t arrival) {
  const int64_t stamp = l->sample.stamp;
  l->sends = 1, l->last_stamp = stamp; /* also if only one of both topics takes it */
  int outcome = send(l, stamp, l->result.u);
  const int64_t sent = fjr_steady_now();
  if (outcome != FJR_GO_ON) return outcome;
  __atomic_fetch_add(&l->answered, 1, __ATOMIC_RELAXED);
  const int due = l->step.is_due(&l->auxiliary, stamp);
  if (due) outcome = publish_auxiliary(l);
  if (outcome == FJR_GO_ON) outcome = observe_torque(l, due);
  if (outcome == FJR_GO_ON) outcome = keep(l, arrival, sent, due);
  l->step.check_wiring(l->model, l->controller);
  return outcome;
}

/* Compute and send the command of the sample; one that waits for a newer one comes again, at the latest by a tick. */
static int process(struct fjr_controller_loop* l, int64_t arrival) {
  const int answered = l->step.step(l->model, l->controller, &l->sample, arrival, &l->result);
  if (answered < 0) return fail(l, "the control step failed");
  return answered ? answer(l, arrival) : FJR_GO_ON;
}

/* Return when a sample that waits for a newer one is answered [ns, steady clock], FJR_NO_TIME if none waits. */
static int64_t waits_until(const struct fjr_controller_loop* l) {
  const int64_t waits = l->step.waits_until(l->controller);
  return waits == FJR_NEVER ? FJR_NO_TIME : waits;
}

/* ---- Functions of struct fjr_callbacks -------------------------------------------------------------------------- */

int fjr_controller_message(void* self, int32_t source, const uint8_t* data, size_t size, int64_t arrival,
                           int64_t* next) {
  struct fjr_controller_loop* l = self;
  int outcome;
  (void)source;
  if (arrival < l->since) return FJR_GO_ON;
  __atomic_fetch_add(&l->received, 1, __ATOMIC_RELAXED);
  const int found = read_sample(l, data, size);
  if (found != FJR_READ) return fjr_refuse(l->refusals, found, data, size), FJR_GO_ON;
  if (!is_alone(l)) return FJR_GO_ON;
  if (l->simulated && (outcome = check_silence(l, l->sample.stamp)) != FJR_GO_ON) return outcome;
  outcome = process(l, arrival);
  const int64_t waits = waits_until(l);
  if (waits < *next) *next = waits;
  return outcome;
}

/* Answer a sample for which no newer one has come; check for silence, but not before the states that waited while this
 * process was paused. */
int fjr_controller_tick(void* self, int64_t now, int64_t* next) {
  struct fjr_controller_loop* l = self;
  int outcome = FJR_GO_ON;
  *next = FJR_NO_TIME;
  if (l->simulated) return FJR_GO_ON;
  int64_t waits = waits_until(l);
  const int64_t late = now - l->silence_check;
  const int checks = late >= 0 && (late <= PAUSED || l->postponed);
  if (late >= 0) l->silence_check = now + (checks ? l->silence_period : PAUSED), l->postponed = !checks;
  *next = l->silence_check;
  if (waits <= now) {
    if ((outcome = process(l, now)) != FJR_GO_ON) return outcome;
    waits = waits_until(l);
  } else if (waits != FJR_NO_TIME) {
    return *next = waits < *next ? waits : *next, FJR_GO_ON;
  }
  if (waits < *next) *next = waits;
  return checks ? check_silence(l, now) : outcome;
}

int fjr_controller_request(void* self, int32_t kind, void* argument) {
  struct fjr_controller_loop* l = self;
  const struct fjr_arguments* a = argument;
  int outcome = FJR_GO_ON;
  switch (kind) {
    case FJR_DO_START: l->step.start(l->controller, a->first); break;
    case FJR_DO_APPLY: l->step.apply(l->controller, a->first); break;
    case FJR_DO_USE_GAINS: l->step.use_gains(l->controller, a->first, a->second); break;
    case FJR_DO_FOLLOW: l->step.follow(l->controller, a->first, a->time); break;
    case FJR_DO_HOLD: l->step.hold(l->controller); break;
    case FJR_DO_RESUME: l->step.resume(l->controller); break;
    case FJR_DO_SEND_STOP: outcome = send_stop(l); break;
    case FJR_DO_CHECK_SILENCE: outcome = check_silence(l, a->time); break;
    case FJR_DO_RECERTIFY:
      outcome = hand_over(l, 0);
      l->certificate->beta = *(const double*)a->second;
      if (a->first) l->certificate->gains = a->first, l->step.certificate_restart(l->certificate);
      return outcome; /* the controller is as before; without a thread it is Python's */
    default: break;
  }
  *l->copy = *l->controller;
  return outcome == FJR_GO_ON ? hand_over(l, 0) : outcome;
}

/* After a failure the robot must not keep the last effort. Python may read the copy now; its next request renews it. */
void fjr_controller_end(void* self, int32_t outcome) {
  struct fjr_controller_loop* l = self;
  if (outcome == FJR_FAILED) (void)send_stop(l);
  (void)hand_over(l, 0);
}
