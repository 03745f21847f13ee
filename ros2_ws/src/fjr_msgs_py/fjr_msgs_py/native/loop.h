/* SPDX-License-Identifier: Apache-2.0
 * A thread that waits for messages, a time or a request, and calls its host for each.
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

/* Outcome of a callback; FJR_DONE and FJR_FAILED end the thread. */
enum fjr_outcome { FJR_GO_ON, FJR_DONE, FJR_FAILED };

/* Callbacks of a host, all on the thread. Times are of the steady clock [ns].
 * on_message: a message of subscription `source`, valid until the return; it was taken at `arrival`.
 * on_tick: the time that the last call wrote to `next` has come; the first call is at the start; FJR_NO_TIME: never.
 * on_request: see fjr_loop_request. on_end: the thread ends; outcome FJR_FAILED: after a failure.
 */
struct fjr_host {
  void* self;
  int (*on_message)(void* self, int32_t source, const uint8_t* data, size_t size, int64_t arrival);
  int (*on_tick)(void* self, int64_t now, int64_t* next);
  int (*on_request)(void* self, int32_t kind, void* argument);
  void (*on_end)(void* self, int32_t outcome);
};

/* Create a loop for subscriptions (rcl_subscription_t*); messages of up to `largest` bytes are taken without
 * allocation. Return 0 if there is not enough memory. */
struct fjr_loop* fjr_loop_create(const struct fjr_host* host, void* const* subscription, int32_t subscriptions,
                                 size_t largest);
void fjr_loop_destroy(struct fjr_loop* loop);

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

/* Return the reason of FJR_FAILED, "" for none. Valid after the end of the thread. */
const char* fjr_loop_reason(const struct fjr_loop* loop);

/* For callbacks. fjr_loop_fail stores a reason and returns FJR_FAILED. fjr_loop_publish returns FJR_GO_ON or fails.
 * fjr_loop_pause waits for `nanoseconds`, a request or the end of the loop, serves requests, and returns FJR_DONE if
 * the loop is to end. fjr_loop_tick_by brings the next tick forward. */
int fjr_loop_fail(struct fjr_loop* loop, const char* reason);
int fjr_loop_publish(struct fjr_loop* loop, void* publisher, const struct fjr_message* message);
int fjr_loop_pause(struct fjr_loop* loop, int64_t nanoseconds);
void fjr_loop_tick_by(struct fjr_loop* loop, int64_t time);

#endif
