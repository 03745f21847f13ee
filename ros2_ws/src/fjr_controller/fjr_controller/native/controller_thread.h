/* SPDX-License-Identifier: Apache-2.0
 * The native host of the command loop: callbacks of loop.h, whose `self` is a struct fjr_controller_thread.
 */
#ifndef FJR_CONTROLLER_THREAD_H
#define FJR_CONTROLLER_THREAD_H

struct fjr_controller_thread {
  struct fjr_loop* loop;
  struct fjr_controller_loop* controller;
  void* publisher[FJR_OUTPUTS]; /* rcl_publisher_t* by enum fjr_controller_output */
  void* node;                   /* rcl_node_t* */
  char* topic[2];               /* resolved names of the command topics */
  const char* known;            /* leading bytes of the GIDs of this process, then GIDs of silent publishers */
  uint64_t silent;              /* number of these */
};

int fjr_controller_on_message(void* self, int32_t source, const uint8_t* data, size_t size, int64_t arrival);
int fjr_controller_on_tick(void* self, int64_t now, int64_t* next);
int fjr_controller_on_request(void* self, int32_t kind, void* argument);
void fjr_controller_on_end(void* self, int32_t outcome);

/* `publish`, `has_others` and `pause` of the command loop. */
int fjr_controller_publish(void* self, int32_t output, const struct fjr_message* message);
int fjr_controller_has_others(void* self);
int fjr_controller_pause(void* self);

#endif
