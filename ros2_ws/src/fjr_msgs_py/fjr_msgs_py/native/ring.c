/* SPDX-License-Identifier: Apache-2.0
 * `written` and `read` only grow. Each has one writer, so that an acquire load and a release store order the records.
 */
static uint8_t* slot_of(const struct fjr_ring* ring, uint64_t k) {
  return ring->slots + (k & (ring->capacity - 1)) * ring->record;
}

void* fjr_ring_free(struct fjr_ring* ring, uint64_t ahead) {
  const uint64_t read = __atomic_load_n(&ring->read, __ATOMIC_ACQUIRE);
  return ring->written + ahead - read < ring->capacity ? slot_of(ring, ring->written + ahead) : NULL;
}

void fjr_ring_commit(struct fjr_ring* ring) { __atomic_store_n(&ring->written, ring->written + 1, __ATOMIC_RELEASE); }

void fjr_ring_lose(struct fjr_ring* ring) { __atomic_fetch_add(&ring->lost, 1, __ATOMIC_RELAXED); }

int64_t fjr_ring_take(struct fjr_ring* ring, void* to, int64_t most) {
  const uint64_t written = __atomic_load_n(&ring->written, __ATOMIC_ACQUIRE);
  int64_t taken = 0;
  for (uint64_t k = ring->read; k < written && taken < most; ++k, ++taken)
    memcpy((uint8_t*)to + (size_t)taken * ring->record, slot_of(ring, k), ring->record);
  __atomic_store_n(&ring->read, ring->read + (uint64_t)taken, __ATOMIC_RELEASE);
  return taken;
}

int64_t fjr_ring_lost(struct fjr_ring* ring) { return (int64_t)__atomic_load_n(&ring->lost, __ATOMIC_RELAXED); }
