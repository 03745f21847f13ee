/* SPDX-License-Identifier: Apache-2.0
 * Each item draws four numbers, whether they are used or not, so that one error does not change the others.
 */
static int32_t* place(const struct fjr_channel* c, int32_t k) { return &c->slot[(c->first + k) % c->capacity]; }

/* Insert behind all items that arrive no later. */
static void transmit(struct fjr_channel* c, int64_t time, double share, const double* item) {
  int64_t due = time + llrint((c->delay + c->jitter * share) * 1e9);
  if (c->in_order && due < c->latest) due = c->latest;
  if (due > c->latest) c->latest = due;
  if (c->count == c->capacity) {
    __atomic_store_n(&c->overflows, c->overflows + 1, __ATOMIC_RELAXED); /* Python reads it at any time */
    return;
  }
  int32_t k = c->count++;
  const int32_t slot = *place(c, k);
  for (; k > 0 && c->due[*place(c, k - 1)] > due; --k) *place(c, k) = *place(c, k - 1);
  *place(c, k) = slot;
  c->due[slot] = due;
  memcpy(c->items + (size_t)slot * (size_t)c->width, item, (size_t)c->width * sizeof(double));
}

void fjr_channel_push(struct fjr_channel* c, int64_t time, const double* item) {
  double draw[4]; /* loss, duplication, jitter, jitter of the duplicate */
  for (int i = 0; i < 4; ++i) draw[i] = c->random->next_double(c->random->state);
  if (draw[0] < c->loss) return;
  transmit(c, time, draw[2], item);
  if (draw[1] < c->repetition) transmit(c, time, draw[3], item);
}

int64_t fjr_channel_next(const struct fjr_channel* c) { return c->count ? c->due[*place(c, 0)] : FJR_NO_TIME; }

const double* fjr_channel_pop(struct fjr_channel* c, int64_t time) {
  if (fjr_channel_next(c) > time || !c->count) return NULL;
  const int32_t slot = *place(c, 0);
  c->first = (c->first + 1) % c->capacity, --c->count;
  return c->items + (size_t)slot * (size_t)c->width;
}

int64_t fjr_sample_times_next(struct fjr_sample_times* t) {
  const int64_t late = llrint(t->random->next_double(t->random->state) * t->jitter * 1e9);
  const int64_t instant = ++t->k * t->period + late, earliest = t->now + t->inner_step;
  const int64_t rounded = instant - instant % t->inner_step;
  t->now = rounded > earliest ? rounded : earliest;
  return t->now;
}
