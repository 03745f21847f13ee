/* SPDX-License-Identifier: Apache-2.0
 * The middleware announces messages by a callback on a thread of its own, which wakes this one by a semaphore.
 */
#include <dirent.h>
#include <errno.h>
#include <pthread.h>
#include <sched.h>
#include <semaphore.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <rcl/error_handling.h>
#include <rcl/publisher.h>
#include <rcl/subscription.h>
#include <rcutils/types/uint8_array.h>

#define REASON 512
#define PAUSE 1000000 /* ns */
#define SLICE 100000 /* ns; the shortest slice that Linux grants */

enum request_state { NO_REQUEST, POSTED };

/* A subscription; announced: messages since the thread looked last. */
struct source {
  struct fjr_loop* loop;
  const rcl_subscription_t* subscription;
  uint64_t announced;
};

struct fjr_loop {
  struct fjr_callbacks call;
  void* const* publisher;
  struct source source[FJR_SOURCES];
  int32_t sources, held, priority;
  rcl_serialized_message_t buffer;
  pthread_t thread;
  sem_t wake, answered;
  int32_t started, running, stopping;        /* running, stopping: atomic */
  int32_t request, kind, answer, outcome;    /* request: atomic, an enum request_state */
  void* argument;
  int64_t next;
  char reason[REASON];
};

static int rcl_failed(struct fjr_loop* loop, const char* what, int code) {
  snprintf(loop->reason, REASON, "%s returned %d (%s)", what, code, rcl_get_error_string().str);
  rcl_reset_error();
  return FJR_FAILED;
}

void fjr_loop_use(struct fjr_loop* loop, void* const* publisher) { loop->publisher = publisher; }

int fjr_loop_publish(void* at, int32_t k, const struct fjr_message* message) {
  struct fjr_loop* loop = at;
  rcl_serialized_message_t bytes = rcutils_get_zero_initialized_uint8_array();
  bytes.buffer = message->bytes;
  bytes.buffer_length = bytes.buffer_capacity = message->size;
  const rcl_ret_t code = rcl_publish_serialized_message(loop->publisher[k], &bytes, NULL);
  return code == RCL_RET_OK ? FJR_GO_ON : rcl_failed(loop, "rcl_publish_serialized_message", code);
}

void fjr_loop_settle(void* at, int32_t k) {
  if (rcl_publisher_wait_for_all_acked(((struct fjr_loop*)at)->publisher[k], RCL_MS_TO_NS(2000))) rcl_reset_error();
}

static void on_announcement(const void* at, size_t count) {
  struct source* source = (struct source*)(uintptr_t)at;
  __atomic_fetch_add(&source->announced, count, __ATOMIC_RELEASE);
  sem_post(&source->loop->wake);
}

static int held(struct fjr_loop* loop) { return __atomic_load_n(&loop->held, __ATOMIC_SEQ_CST); }

/* Take and handle the announced messages of a subscription; the middleware keeps the newest ones only. */
static int take(struct fjr_loop* loop, int32_t k) {
  struct source* source = &loop->source[k];
  uint64_t count = __atomic_exchange_n(&source->announced, 0, __ATOMIC_ACQUIRE);
  int outcome = FJR_GO_ON;
  for (; count && outcome == FJR_GO_ON; --count) {
    if (held(loop)) {
      __atomic_fetch_add(&source->announced, count, __ATOMIC_RELEASE);
      return FJR_GO_ON;
    }
    const rcl_ret_t code = rcl_take_serialized_message(source->subscription, &loop->buffer, NULL, NULL);
    if (code == RCL_RET_SUBSCRIPTION_TAKE_FAILED) return FJR_GO_ON;
    if (code != RCL_RET_OK) return rcl_failed(loop, "rcl_take_serialized_message", code);
    outcome = loop->call.on_message(loop->call.self, k, loop->buffer.buffer, loop->buffer.buffer_length,
                                    fjr_steady_now(), &loop->next);
  }
  return outcome;
}

/* Discard what arrived before the start. */
static void discard(struct fjr_loop* loop, int32_t k) {
  loop->source[k].announced = 0;
  while (rcl_take_serialized_message(loop->source[k].subscription, &loop->buffer, NULL, NULL) == RCL_RET_OK) {
  }
  rcl_reset_error();
}

/* Answer the pending request, if there is one; thread or caller do so, whoever comes first. */
static int serve(struct fjr_loop* loop) {
  int32_t posted = POSTED;
  if (!__atomic_compare_exchange_n(&loop->request, &posted, NO_REQUEST, 0, __ATOMIC_SEQ_CST, __ATOMIC_SEQ_CST))
    return FJR_GO_ON;
  const int outcome = loop->call.on_request(loop->call.self, loop->kind, loop->argument);
  loop->answer = outcome;
  sem_post(&loop->answered);
  return outcome;
}

int fjr_loop_request(struct fjr_loop* loop, int32_t kind, void* argument) {
  loop->kind = kind, loop->argument = argument;
  __atomic_store_n(&loop->request, POSTED, __ATOMIC_SEQ_CST);
  if (__atomic_load_n(&loop->running, __ATOMIC_SEQ_CST))
    sem_post(&loop->wake);
  else
    serve(loop);
  while (sem_wait(&loop->answered)) {
  }
  return loop->answer;
}

void fjr_loop_hold(struct fjr_loop* loop, int32_t hold) {
  __atomic_store_n(&loop->held, hold, __ATOMIC_SEQ_CST);
  if (!hold) sem_post(&loop->wake);
}

static struct timespec timespec_of(int64_t time) {
  const struct timespec at = {(time_t)(time / 1000000000), (long)(time % 1000000000)};
  return at;
}

/* Wait until something is announced, requested or to be ended, at most until a time. */
static void wait_until(struct fjr_loop* loop, int64_t time) {
  const struct timespec at = timespec_of(time);
  if (time == FJR_NO_TIME)
    sem_wait(&loop->wake);
  else
    sem_clockwait(&loop->wake, CLOCK_MONOTONIC, &at);
}

static int stopping(struct fjr_loop* loop) { return __atomic_load_n(&loop->stopping, __ATOMIC_ACQUIRE); }

int fjr_loop_pause(void* at) {
  struct fjr_loop* loop = at;
  wait_until(loop, fjr_steady_now() + PAUSE);
  const int outcome = serve(loop);
  return outcome == FJR_GO_ON && stopping(loop) ? FJR_DONE : outcome;
}

/* Whether something has come for which the semaphore may already have been taken, by fjr_loop_pause. */
static int waiting(struct fjr_loop* loop) {
  int found = __atomic_load_n(&loop->request, __ATOMIC_ACQUIRE) == POSTED;
  for (int32_t k = 0; k < loop->sources && !held(loop); ++k)
    found |= __atomic_load_n(&loop->source[k].announced, __ATOMIC_ACQUIRE) > 0;
  return found;
}

static int one_round(struct fjr_loop* loop) {
  int outcome = serve(loop);
  for (int32_t k = 0; k < loop->sources && outcome == FJR_GO_ON; ++k) outcome = take(loop, k);
  if (outcome == FJR_GO_ON && loop->next != FJR_NO_TIME) {
    const int64_t now = fjr_steady_now();
    if (now >= loop->next) outcome = loop->call.on_tick(loop->call.self, now, &loop->next);
  }
  return outcome;
}

/* Confine this thread to the last core that a thread of this process may use, if the system allows it; scheduling.py
 * does the same with the threads of the middleware, says why, and reports the core, which Python has left. */
static void keep_to_last_core(void) {
  cpu_set_t cores, own;
  int last = CPU_SETSIZE - 1;
  DIR* threads = opendir("/proc/self/task");
  CPU_ZERO(&cores);
  for (struct dirent* each; threads && (each = readdir(threads));)
    if (!sched_getaffinity(atoi(each->d_name), sizeof own, &own)) CPU_OR(&cores, &cores, &own);
  if (threads) closedir(threads);
  while (last >= 0 && !CPU_ISSET(last, &cores)) --last;
  if (last < 0) return;
  CPU_ZERO(&cores);
  CPU_SET(last, &cores);
  (void)sched_setaffinity(0, sizeof cores, &cores);
}

/* Keep to one core and take the priority. With ordinary scheduling ask for a short slice: the system
 * then lets the thread run soon after it wakes up (Linux 6.12; every user may ask for it). */
static void schedule(int32_t priority) {
  const struct sched_param wanted = {.sched_priority = priority};
  if (priority) keep_to_last_core();
  if (priority && !pthread_setschedparam(pthread_self(), SCHED_FIFO, &wanted)) return;
  const int policy = sched_getscheduler(0) & ~SCHED_RESET_ON_FORK;
  if (policy != SCHED_OTHER && policy != SCHED_BATCH) return;
  const struct {
    uint32_t size, policy;
    uint64_t flags;
    int32_t nice;
    uint32_t priority;
    uint64_t runtime, deadline, period;
  } attributes = {48, SCHED_OTHER, 0, getpriority(PRIO_PROCESS, 0), 0, SLICE, 0, 0}; /* struct sched_attr */
  (void)syscall(SYS_sched_setattr, 0, &attributes, 0);
}

static void* run(void* at) {
  struct fjr_loop* loop = at;
  int outcome = FJR_GO_ON;
  schedule(loop->priority);
  rcl_reset_error(); /* its first call in a thread allocates */
  while (!stopping(loop) && (outcome = one_round(loop)) == FJR_GO_ON)
    if (!waiting(loop)) wait_until(loop, loop->next);
  loop->call.on_end(loop->call.self, outcome);
  __atomic_store_n(&loop->running, 0, __ATOMIC_SEQ_CST);
  serve(loop);
  return NULL;
}

struct fjr_loop* fjr_loop_create(const struct fjr_callbacks* callbacks, void* const* subscription,
                                 int32_t subscriptions, size_t largest) {
  struct fjr_loop* loop = calloc(1, sizeof *loop);
  const rcutils_allocator_t allocator = rcutils_get_default_allocator();
  if (!loop) return NULL;
  loop->call = *callbacks, loop->sources = subscriptions;
  loop->buffer = rcutils_get_zero_initialized_uint8_array();
  if (rcutils_uint8_array_init(&loop->buffer, largest, &allocator) != RCUTILS_RET_OK) {
    free(loop);
    return NULL;
  }
  sem_init(&loop->wake, 0, 0);
  sem_init(&loop->answered, 0, 0);
  for (int32_t k = 0; k < subscriptions; ++k)
    loop->source[k] = (struct source){.loop = loop, .subscription = subscription[k]};
  return loop;
}

void fjr_loop_destroy(struct fjr_loop* loop) {
  fjr_loop_stop(loop);
  sem_destroy(&loop->wake);
  sem_destroy(&loop->answered);
  if (rcutils_uint8_array_fini(&loop->buffer) != RCUTILS_RET_OK) rcl_reset_error();
  free(loop);
}

static rcl_ret_t listen(struct fjr_loop* loop, int32_t k) {
  return rcl_subscription_set_on_new_message_callback(loop->source[k].subscription, on_announcement, &loop->source[k]);
}

int fjr_loop_start(struct fjr_loop* loop, int32_t priority) {
  loop->priority = priority;
  loop->next = fjr_steady_now(), loop->reason[0] = 0, loop->stopping = 0, loop->running = 1;
  for (int32_t k = 0; k < loop->sources; ++k) discard(loop, k);
  const int code = pthread_create(&loop->thread, NULL, run, loop);
  if (code) {
    loop->running = 0;
    return code;
  }
  loop->started = 1;
  for (int32_t k = 0; k < loop->sources; ++k)
    if (listen(loop, k) != RCL_RET_OK) {
      rcl_reset_error();
      fjr_loop_stop(loop);
      return ENOTSUP;
    }
  return 0;
}

void fjr_loop_stop(struct fjr_loop* loop) {
  if (!loop->started) return;
  for (int32_t k = 0; k < loop->sources; ++k)
    if (rcl_subscription_set_on_new_message_callback(loop->source[k].subscription, NULL, NULL) != RCL_RET_OK)
      rcl_reset_error();
  __atomic_store_n(&loop->stopping, 1, __ATOMIC_RELEASE);
  sem_post(&loop->wake);
  pthread_join(loop->thread, NULL);
  loop->started = 0;
}

int fjr_loop_runs(struct fjr_loop* loop) { return __atomic_load_n(&loop->running, __ATOMIC_ACQUIRE); }

const char* fjr_loop_reason(const struct fjr_loop* loop) { return loop->reason; }
