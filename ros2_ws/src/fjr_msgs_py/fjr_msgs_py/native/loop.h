/* SPDX-License-Identifier: Apache-2.0
 * A thread that waits for messages, a time or a request, and calls a function for each.
 *
 * Subscriptions and publishers belong to an rclpy node; they are handed over by address (rcl_subscription_t*,
 * rcl_publisher_t*) and live at least as long as the thread runs. Nothing is allocated between start and end.
 */
#ifndef FJR_LOOP_H
#define FJR_LOOP_H

#include <stddef.h>
#include <stdint.h>

#define FJR_SOURCES 4
#define FJR_NO_TIME INT64_MAX

struct fjr_loop;
struct fjr_message;

/* Outcome of a callback; all but FJR_GO_ON end the thread. A positive number is a failure, of the callee's own kinds. */
enum fjr_outcome { FJR_DONE = -1, FJR_GO_ON, FJR_FAILED };

/* Functions that the thread calls. Times are of the steady clock [ns].
 * on_message: a message of subscription `source`, valid until the return; it was taken at `arrival`.
 * on_tick: the time `next` has come, at first at the start; each call writes it anew, FJR_NO_TIME: never. A message may
 * bring it forward.
 * on_request: see fjr_loop_request. on_end: the thread ends with this outcome.
 */
struct fjr_callbacks {
  void* self;
  int (*on_message)(void* self, int32_t source, const uint8_t* data, size_t size, int64_t arrival, int64_t* next);
  int (*on_tick)(void* self, int64_t now, int64_t* next);
  int (*on_request)(void* self, int32_t kind, void* argument);
  void (*on_end)(void* self, int32_t outcome);
};

/* Create a loop for subscriptions (rcl_subscription_t*); messages of up to `largest` bytes are taken without
 * allocation. Return 0 if there is not enough memory. */
struct fjr_loop* fjr_loop_create(const struct fjr_callbacks* callbacks, void* const* subscription,
                                 int32_t subscriptions, size_t largest);
void fjr_loop_destroy(struct fjr_loop* loop);

/* Let the callbacks send by these publishers (rcl_publisher_t*), in their order; not while the thread runs. */
void fjr_loop_use(struct fjr_loop* loop, void* const* publisher);

/* Start the thread; return 0, or an errno. priority: SCHED_FIFO priority of the thread, if the system allows it. Without
 * it a caller with real-time scheduling passes it on; with ordinary scheduling the thread asks for short slices. */
int fjr_loop_start(struct fjr_loop* loop, int32_t priority);

/* End the thread and wait for it. */
void fjr_loop_stop(struct fjr_loop* loop);

/* Let the thread call on_request, and wait for it; the caller does so itself while no thread runs. One caller at a
 * time. Return the outcome of on_request, which ends the thread as that of the other callbacks does. */
int fjr_loop_request(struct fjr_loop* loop, int32_t kind, void* argument);

/* Let messages wait (1) from the end of the next request on, or take them again (0). Requests are served meanwhile. */
void fjr_loop_hold(struct fjr_loop* loop, int32_t hold);

/* Return 1 while the thread runs. */
int fjr_loop_runs(struct fjr_loop* loop);

/* Return why the middleware failed, "" if it did not. Valid after the end of the thread. */
const char* fjr_loop_reason(const struct fjr_loop* loop);

/* For callbacks; at: struct fjr_loop. fjr_loop_publish sends by the k-th publisher; it returns FJR_GO_ON or FJR_FAILED.
 * fjr_loop_settle waits until reliable subscribers have received what it sent, for 2 s at most. fjr_loop_pause waits for a
 * millisecond, a request or the end of the loop, serves requests, and returns FJR_DONE if the loop is to end. */
int fjr_loop_publish(void* at, int32_t k, const struct fjr_message* message);
void fjr_loop_settle(void* at, int32_t k);
int fjr_loop_pause(void* at);

#endif
