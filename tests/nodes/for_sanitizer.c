/* SPDX-License-Identifier: Apache-2.0
 * What ThreadSanitizer of gcc 12 does not know, in words that it knows; preloaded before it. It refuses libraries with
 * symbols of their own, as CasADi opens its plugins, and misses a lock with a time limit, as Fast DDS takes its own.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <pthread.h>
#include <time.h>

void* dlopen(const char* file, int mode) {
  void* (*original)(const char*, int);
  *(void**)&original = dlsym(RTLD_NEXT, "dlopen");
  return original(file, mode & ~RTLD_DEEPBIND);
}

int pthread_mutex_clocklock(pthread_mutex_t* mutex, clockid_t clock, const struct timespec* limit) {
  (void)clock, (void)limit;
  return pthread_mutex_lock(mutex);
}
