/* SPDX-License-Identifier: Apache-2.0 */
#include <rcl/graph.h>

#define DRAIN_PERIOD 1000000 /* ns; wait for Python where no record may be lost */

static int outcome_of(struct fjr_controller_thread* t, int outcome) {
  if (outcome == FJR_FAILED && t->controller->reason) return fjr_loop_fail(t->loop, t->controller->reason);
  fjr_loop_tick_by(t->loop, fjr_controller_waits(t->controller));
  return outcome;
}

int fjr_controller_on_message(void* self, int32_t source, const uint8_t* data, size_t size, int64_t arrival) {
  struct fjr_controller_thread* t = self;
  return outcome_of(t, fjr_controller_message(t->controller, source, data, size, arrival));
}

int fjr_controller_on_tick(void* self, int64_t now, int64_t* next) {
  struct fjr_controller_thread* t = self;
  return outcome_of(t, fjr_controller_tick(t->controller, now, next));
}

int fjr_controller_on_request(void* self, int32_t kind, void* argument) {
  struct fjr_controller_thread* t = self;
  return outcome_of(t, fjr_controller_request(t->controller, kind, argument));
}

void fjr_controller_on_end(void* self, int32_t outcome) {
  struct fjr_controller_thread* t = self;
  fjr_controller_end(t->controller, outcome);
}

int fjr_controller_publish(void* self, int32_t output, const struct fjr_message* message) {
  struct fjr_controller_thread* t = self;
  return fjr_loop_publish(t->loop, t->publisher[output], message);
}

int fjr_controller_pause(void* self) {
  struct fjr_controller_thread* t = self;
  return fjr_loop_pause(t->loop, DRAIN_PERIOD);
}

static int is_known(const struct fjr_controller_thread* t, const uint8_t* gid) {
  int known = memcmp(gid, t->known, FJR_PARTICIPANT) == 0;
  for (uint64_t k = 0; k < t->silent; ++k)
    known |= memcmp(gid, t->known + FJR_PARTICIPANT + k * RMW_GID_STORAGE_SIZE, RMW_GID_STORAGE_SIZE) == 0;
  return known;
}

/* Return 1 if the graph shows unknown publishers on a topic, or cannot be read. */
static int has_others_on(struct fjr_controller_thread* t, const char* topic) {
  rcutils_allocator_t allocator = rcutils_get_default_allocator();
  rcl_topic_endpoint_info_array_t found = rcl_get_zero_initialized_topic_endpoint_info_array();
  int others = rcl_get_publishers_info_by_topic(t->node, &allocator, topic, false, &found) != RCL_RET_OK;
  for (size_t k = 0; k < found.size; ++k) others |= !is_known(t, found.info_array[k].endpoint_gid);
  others |= rcl_topic_endpoint_info_array_fini(&found, &allocator) != RCL_RET_OK;
  rcl_reset_error();
  return others;
}

int fjr_controller_has_others(void* self) {
  struct fjr_controller_thread* t = self;
  return has_others_on(t, t->topic[0]) || has_others_on(t, t->topic[1]);
}
