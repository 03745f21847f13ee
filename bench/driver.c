/* SPDX-License-Identifier: Apache-2.0 */
int driver_message(void* self, int32_t source, const uint8_t* data, size_t size, int64_t arrival, int64_t* next) {
  struct driver* d = self;
  (void)data, (void)size, (void)next;
  if (!d->pending || source != d->count / d->block % d->sides) return FJR_GO_ON;
  d->pending = 0;
  d->times[d->count++] = 1e-3 * (double)(arrival - d->sent);
  return d->count < d->total ? FJR_GO_ON : FJR_DONE;
}

int driver_tick(void* self, int64_t now, int64_t* next) {
  struct driver* d = self;
  struct timespec clock;
  *next += d->period;
  if (*next < now) *next = now + d->period;
  if (d->pending && now - d->sent < d->longest) return FJR_GO_ON;
  clock_gettime(CLOCK_REALTIME, &clock);
  fjr_put_stamp(d->state, (int64_t)clock.tv_sec * 1000000000 + clock.tv_nsec);
  d->pending = 1;
  d->sent = fjr_steady_now();
  return fjr_loop_publish(d->loop, (int32_t)(d->count / d->block % d->sides), d->state);
}

int driver_request(void* self, int32_t kind, void* argument) {
  (void)self, (void)kind, (void)argument;
  return FJR_GO_ON;
}

void driver_end(void* self, int32_t outcome) { (void)self, (void)outcome; }
