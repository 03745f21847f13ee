/* SPDX-License-Identifier: Apache-2.0
 * The native host of a plant: callbacks of loop.h, whose `self` is a struct fjr_plant_loop.
 */
#ifndef FJR_PLANT_LOOP_H
#define FJR_PLANT_LOOP_H

struct fjr_plant_loop {
  struct fjr_loop* loop;
  struct fjr_plant* plant;
  int32_t lock_step;
  void* publisher[2];  /* rcl_publisher_t* by enum fjr_output */
  int (*work)(void);   /* called for a request; returns an enum fjr_fault */
  void (*ended)(void); /* called after a failure */
};

int fjr_plant_on_message(void* self, int32_t source, const uint8_t* data, size_t size, int64_t arrival);
int fjr_plant_on_tick(void* self, int64_t now, int64_t* next);
int fjr_plant_on_request(void* self, int32_t kind, void* argument);
void fjr_plant_on_end(void* self, int32_t outcome);

/* `send` of the plant. */
int fjr_plant_send(void* self, int32_t output, const struct fjr_message* message);

#endif
