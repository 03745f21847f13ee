/* SPDX-License-Identifier: Apache-2.0
 * The native host of a plant: callbacks of loop.h, whose `self` is a struct fjr_plant_loop.
 */
#ifndef FJR_PLANT_LOOP_H
#define FJR_PLANT_LOOP_H

#define FJR_NOTE_ROOM 65536 /* bytes of a message that are kept */

/* An event that does not wait for Python. */
struct fjr_note {
  int64_t event, value;
  size_t size;
  uint8_t data[FJR_NOTE_ROOM];
};

struct fjr_plant_loop {
  struct fjr_loop* loop;
  struct fjr_plant* plant;
  int32_t lock_step;
  struct fjr_ring* notes;
  int (*notify)(void* host, int32_t event, int64_t value, const uint8_t* data, size_t size); /* Python */
  void* publisher[FJR_OUTPUTS]; /* rcl_publisher_t* by enum fjr_output */
  int (*work)(void);   /* called for a request; returns an enum fjr_fault */
  void (*ended)(void); /* called after a failure */
};

int fjr_plant_on_message(void* self, int32_t source, const uint8_t* data, size_t size, int64_t arrival);
int fjr_plant_on_tick(void* self, int64_t now, int64_t* next);
int fjr_plant_on_request(void* self, int32_t kind, void* argument);
void fjr_plant_on_end(void* self, int32_t outcome);

/* `notify` of the plant: keep the event for Python, or call it if the plant needs the result or the time stands still. */
int fjr_plant_notify(void* self, int32_t event, int64_t value, const uint8_t* data, size_t size);

/* `send` of the plant. */
int fjr_plant_send(void* self, int32_t output, const struct fjr_message* message);

#endif
