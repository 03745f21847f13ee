/* SPDX-License-Identifier: Apache-2.0
 * Counters and events of the controller: values as numbers, sentences are made where they are shown.
 */
#include <math.h>
#include <string.h>

#include "step.h"

#define N FJR_N
#define NONE (-1) /* no joint, no detail */

static void count(struct fjr_controller* c, int32_t kind) { ++c->journal.count[kind]; }

static void report_event(struct fjr_controller* c, struct fjr_event event) {
  count(c, event.kind);
  c->journal.event[c->journal.events++ % FJR_EVENTS] = event;
}

static void report(struct fjr_controller* c, int32_t kind, int64_t stamp) {
  const struct fjr_event event = {kind, NONE, NONE, 0, stamp, NAN, NAN};
  report_event(c, event);
}

static void report_value(struct fjr_controller* c, int32_t kind, int64_t stamp, double value) {
  const struct fjr_event event = {kind, NONE, NONE, 0, stamp, value, NAN};
  report_event(c, event);
}

/* Count, and add an event at the beginning of an episode only. */
static void report_episode(struct fjr_controller* c, int32_t* episode, struct fjr_event event) {
  if (*episode)
    count(c, event.kind);
  else
    report_event(c, event);
  *episode = 1;
}

/* Small operations on vectors of n joints. */

static void copy(double* to, const double* from, int n) { memcpy(to, from, (size_t)n * sizeof *to); }

static void fill(double* to, double value, int n) {
  for (int i = 0; i < n; ++i) to[i] = value;
}

/* True if every value is finite and its square does not overflow. */
static int all_finite(const double* values, int n) {
  double size = 0;
  for (int i = 0; i < n; ++i) size += values[i] * values[i];
  return size < (double)INFINITY;
}

/* y = A x, A (n, n) by rows. */
static void multiply(double* y, const double* A, const double* x) {
  for (int i = 0; i < N; ++i) {
    y[i] = 0;
    for (int j = 0; j < N; ++j) y[i] += A[i * N + j] * x[j];
  }
}

static double clamp(double value, double least, double most) {
  return value < least ? least : value > most ? most : value;
}
