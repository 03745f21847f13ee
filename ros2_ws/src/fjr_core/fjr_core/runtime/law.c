/* SPDX-License-Identifier: Apache-2.0
 * Evaluation of the law u(x, x, t) at the measured state, with its controller state if it has one.
 *
 * The controller state advances where a sample follows one for which the law acted; it starts again everywhere else. A
 * repeated sample is evaluated again with the same state. The state after a sample counts only once it was accepted.
 */

static void forget_law(struct fjr_controller* c) { c->law.evaluated = c->law.continues = 0; }

static void accept_law(struct fjr_controller* c) { c->law.continues = c->law.evaluated; }

/* Set the inputs of the law's step for a sample dt after the last accepted one. */
static void prepare_law(const struct fjr_model* m, struct fjr_controller* c, enum fjr_order order, int64_t dt) {
  struct fjr_law_state* s = &c->law;
  s->evaluated = 1;
  if (order == FJR_REPEATED && s->continues) return;
  const int next = order == FJR_NEXT && s->continues;
  copy(s->memory, next ? s->next : m->memory, FJR_MEMORY);
  s->dt = next ? (double)dt * 1e-9 : 0;
  copy(s->sent, c->limits.left, N);
}

/* Write u, NaN if the next controller state is not finite, and V; return 0 if the law failed. */
static int evaluate_law(const struct fjr_model* m, struct fjr_controller* c, const double* jets, enum fjr_order order,
                        int64_t dt, double* u, double* V) {
  struct fjr_law_state* s = &c->law;
  if (m->has_memory) prepare_law(m, c, order, dt);
  m->arg[0] = c->measured.values, m->arg[1] = c->measured.values + 2 * N, m->arg[2] = jets, m->arg[3] = c->gains;
  m->arg[4] = s->memory, m->arg[5] = s->sent, m->arg[6] = &s->dt;
  m->res[0] = u, m->res[1] = V, m->res[2] = s->next;
  if (m->law(m->arg, m->res, m->iw, m->w, 0)) return 0;
  if (m->has_memory && !all_finite(s->next, FJR_MEMORY)) fill(u, NAN, N);
  return 1;
}
