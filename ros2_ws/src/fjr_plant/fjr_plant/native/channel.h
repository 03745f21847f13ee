/* SPDX-License-Identifier: Apache-2.0
 * Messages in transit with delay, jitter, loss and duplication in robot time [ns], and the times of samples. Arrays
 * belong to the caller.
 */
#ifndef FJR_CHANNEL_H
#define FJR_CHANNEL_H

struct fjr_channel {
  int32_t on;             /* 0: every item arrives at once */
  int32_t in_order;       /* 1: no item overtakes an earlier one */
  double delay, jitter;   /* [s] */
  double loss, repetition; /* probabilities */
  struct fjr_random* random;
  int64_t latest;         /* arrival of the last item that was sent */
  int32_t width;          /* numbers of an item */
  int32_t capacity, first, count;
  int64_t overflows;      /* items that found no place */
  int32_t* slot;          /* (capacity) circular, a permutation; `count` from `first` on are in transit, by arrival */
  int64_t* due;           /* (capacity) by slot */
  double* items;          /* (capacity, width) by slot */
};

/* Send an item (width) at a time. */
void fjr_channel_push(struct fjr_channel* channel, int64_t time, const double* item);

/* Return and remove the first item if it has arrived by `time`, 0 if there is none; valid until the next push. */
const double* fjr_channel_pop(struct fjr_channel* channel, int64_t time);

/* Return the arrival of the next item, FJR_NO_TIME: no items in transit. */
int64_t fjr_channel_next(const struct fjr_channel* channel);

/* Sample times: the k-th at k period + a uniform share of the jitter, rounded down to an inner step. */
struct fjr_sample_times {
  int64_t period, inner_step;
  double jitter;          /* [s] */
  int64_t k, now;
  struct fjr_random* random;
};

/* Advance to the next sample and return its time. */
int64_t fjr_sample_times_next(struct fjr_sample_times* times);

#endif
