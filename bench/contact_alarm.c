/* SPDX-License-Identifier: Apache-2.0
 * Run the contact alarm along recorded states. */

void watch_along(const struct watched* w, int count, const int64_t* stamps, const double* position,
                 const double* velocity, double* found, int32_t* acting) {
  acting[0] = *w->acting;
  for (int k = 0; k < count; ++k) {
    w->watch(w->observer, w->contact, position + 2 * w->n * k, velocity + 2 * w->n * k, stamps[k]);
    memcpy(found + w->n * k, w->r, w->n * sizeof(double));
    acting[k + 1] = *w->acting;
  }
}
