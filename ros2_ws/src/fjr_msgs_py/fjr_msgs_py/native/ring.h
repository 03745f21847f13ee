/* SPDX-License-Identifier: Apache-2.0
 * A queue of records of one size from one thread to another, without locks.
 */
#ifndef FJR_RING_H
#define FJR_RING_H

#include <stddef.h>
#include <stdint.h>

struct fjr_ring {
  uint8_t* slots;    /* (capacity, record) */
  uint64_t capacity; /* a power of 2 */
  size_t record;     /* bytes of a record */
  uint64_t written, read, lost;
};

/* Return the free record that is `ahead` records after the next one, 0 if the queue ends before; for the writer. */
void* fjr_ring_free(struct fjr_ring* ring, uint64_t ahead);

/* Hand the next record over. */
void fjr_ring_commit(struct fjr_ring* ring);

/* Count a record that found no place. */
void fjr_ring_lose(struct fjr_ring* ring);

/* Move at most `most` records to `to`, the oldest first; return their number. For the reader. */
int64_t fjr_ring_take(struct fjr_ring* ring, void* to, int64_t most);

/* Return how many records were lost so far. For the reader. */
int64_t fjr_ring_lost(struct fjr_ring* ring);

#endif
