/* SPDX-License-Identifier: Apache-2.0 */

/* fjr_watch_torque of the control step. */
typedef int (*watch_function)(void* observer, void* contact, const double* position, const double* velocity, int64_t stamp);

struct watched {
  watch_function watch;
  void *observer, *contact;
  const double* r;       /* estimates of the observer (n,) */
  const int32_t* acting; /* of the contact */
  int32_t n;
};

/* Watch `count` states. Write the estimates (count, n), and whether there is contact before the first one and after each. */
void watch_along(const struct watched* w, int count, const int64_t* stamps, const double* position,
                 const double* velocity, double* found, int32_t* acting);
