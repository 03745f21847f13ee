/* SPDX-License-Identifier: Apache-2.0 */
static int outcome_of(int fault) { return fault ? FJR_FAILED : FJR_GO_ON; }

int fjr_plant_on_message(void* self, int32_t source, const uint8_t* data, size_t size, int64_t arrival) {
  struct fjr_plant_loop* l = self;
  (void)source;
  return outcome_of(l->lock_step ? fjr_lock_step_command(l->plant, data, size, arrival)
                                 : fjr_real_time_command(l->plant, data, size, arrival));
}

int fjr_plant_on_tick(void* self, int64_t now, int64_t* next) {
  struct fjr_plant_loop* l = self;
  return outcome_of(l->lock_step ? fjr_lock_step_tick(l->plant, now, next) : fjr_real_time_tick(l->plant, now, next));
}

int fjr_plant_on_request(void* self, int32_t kind, void* argument) {
  struct fjr_plant_loop* l = self;
  (void)kind, (void)argument;
  return outcome_of(l->work());
}

void fjr_plant_on_end(void* self, int32_t outcome) {
  struct fjr_plant_loop* l = self;
  if (outcome == FJR_FAILED) l->ended();
}

int fjr_plant_send(void* self, int32_t output, const struct fjr_message* message) {
  struct fjr_plant_loop* l = self;
  return fjr_loop_publish(l->loop, l->publisher[output], message) != FJR_GO_ON;
}

int fjr_plant_notify(void* self, int32_t event, int64_t value, const uint8_t* data, size_t size) {
  struct fjr_plant_loop* l = self;
  if (event == FJR_FIRST_ANSWER || event == FJR_ADVANCED || event == FJR_SECOND)
    return l->notify(self, event, value, data, size);
  struct fjr_note* note = fjr_ring_free(l->notes, 0);
  if (!note) return 0;
  note->event = event, note->value = value;
  note->size = size < FJR_NOTE_ROOM ? size : FJR_NOTE_ROOM;
  if (size) memcpy(note->data, data, note->size);
  fjr_ring_commit(l->notes);
  return 0;
}
