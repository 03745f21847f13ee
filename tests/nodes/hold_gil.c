/* SPDX-License-Identifier: Apache-2.0
 * Wait, with Python's lock held by the caller, until a counter has reached a number; return 0 if it does not.
 */
#include <stdint.h>
#include <unistd.h>

int hold_gil(const int64_t* counter, int64_t least, int64_t milliseconds) {
  for (; milliseconds > 0; --milliseconds) {
    if (__atomic_load_n(counter, __ATOMIC_ACQUIRE) >= least) return 1;
    usleep(1000);
  }
  return 0;
}
