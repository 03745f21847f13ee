int echo_message(void* self, int32_t source, const uint8_t* data, size_t size, int64_t arrival, int64_t* next) {
  struct echo* e = self;
  (void)source, (void)arrival, (void)next;
  if (fjr_read_joint_state(e->reader, data, size) != FJR_READ) return FJR_GO_ON;
  if (++e->messages == e->fault) return FJR_FAILED;
  int64_t* record = fjr_ring_free(e->ring, 0);
  if (record) {
    *record = e->reader->stamp;
    fjr_ring_commit(e->ring);
  } else {
    fjr_ring_lose(e->ring);
  }
  fjr_put_stamp(e->answer, e->reader->stamp);
  fjr_put_numbers(e->answer, 2, e->reader->value[2]);
  return fjr_loop_publish(e->loop, 0, e->answer);
}

int echo_tick(void* self, int64_t now, int64_t* next) {
  (void)self, (void)now;
  *next = FJR_NO_TIME;
  return FJR_GO_ON;
}

int echo_request(void* self, int32_t kind, void* argument) {
  struct echo* e = self;
  (void)kind, (void)argument;
  ++e->requests;
  e->by_thread = pthread_equal(pthread_self(), e->loop->thread) && e->loop->started;
  return FJR_GO_ON;
}

void echo_end(void* self, int32_t outcome) { ((struct echo*)self)->ends += 1 + 10 * (outcome == FJR_FAILED); }
