/* SPDX-License-Identifier: Apache-2.0 */
#ifndef FJR_CLOCK_H
#define FJR_CLOCK_H

#include <stdint.h>

/* Return the time of the steady clock [ns], as Python's time.monotonic_ns(). */
int64_t fjr_steady_now(void);

#endif
