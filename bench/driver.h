/* SPDX-License-Identifier: Apache-2.0
 * The robot driver of bench/bare.py: publish a state at each tick, unless an effort is pending, and time the effort.
 */
struct driver {
  struct fjr_loop* loop;
  struct fjr_message* state;
  int64_t period, longest; /* ns; longest: a state without an effort is given up */
  int64_t sides, block;    /* block: consecutive states to one side */
  int64_t pending, sent;   /* pending: an effort is waited for; sent: when its state was published */
  int64_t count, total;
  double* times; /* (total) us */
};

int driver_message(void* self, int32_t source, const uint8_t* data, size_t size, int64_t arrival, int64_t* next);
int driver_tick(void* self, int64_t now, int64_t* next);
int driver_request(void* self, int32_t kind, void* argument);
void driver_end(void* self, int32_t outcome);
