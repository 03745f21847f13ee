/* SPDX-License-Identifier: Apache-2.0
 * Count the calls of allocators, by the library of the thread's first function and by the calling library; preloaded.
 * The linker allocates a library's thread-local storage when a thread first touches it: for these, that library calls.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <execinfo.h>
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define ROWS 4096
#define DEPTH 16

struct row {
  const char *thread, *caller;
  long count;
};

struct start {
  void* (*function)(void*);
  void* argument;
};

void* __libc_malloc(size_t size);
void* __libc_calloc(size_t count, size_t size);
void* __libc_realloc(void* memory, size_t size);
void* __libc_memalign(size_t alignment, size_t size);

static struct row row[ROWS];
static int rows, counting;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static __thread const char* thread;
static __thread int busy;

static const char* library_of(void* address) {
  Dl_info found;
  return dladdr(address, &found) ? found.dli_fname : "";
}

static const char* caller_of_linker(const char* linker) {
  void* address[DEPTH];
  const int frames = backtrace(address, DEPTH);
  int k = 0;
  while (k < frames && strcmp(library_of(address[k]), linker)) ++k;
  while (k < frames && !strcmp(library_of(address[k]), linker)) ++k;
  return k < frames ? library_of(address[k]) : linker;
}

static void note(void* address) {
  if (!counting || !thread || busy) return;
  busy = 1;
  const char* caller = library_of(address);
  if (strstr(caller, "/ld-linux")) caller = caller_of_linker(caller);
  pthread_mutex_lock(&lock);
  int k = 0;
  while (k < rows && (row[k].thread != thread || row[k].caller != caller)) ++k;
  if (k < ROWS) {
    if (k == rows) row[rows++] = (struct row){thread, caller, 0};
    ++row[k].count;
  }
  pthread_mutex_unlock(&lock);
  busy = 0;
}

void* malloc(size_t size) { return note(__builtin_return_address(0)), __libc_malloc(size); }
void* calloc(size_t count, size_t size) { return note(__builtin_return_address(0)), __libc_calloc(count, size); }
void* realloc(void* memory, size_t size) { return note(__builtin_return_address(0)), __libc_realloc(memory, size); }
void* memalign(size_t alignment, size_t size) {
  return note(__builtin_return_address(0)), __libc_memalign(alignment, size);
}
void* aligned_alloc(size_t alignment, size_t size) {
  return note(__builtin_return_address(0)), __libc_memalign(alignment, size);
}
int posix_memalign(void** memory, size_t alignment, size_t size) {
  note(__builtin_return_address(0));
  *memory = __libc_memalign(alignment, size);
  return *memory ? 0 : 12;
}

static void* begin(void* at) {
  struct start start = *(struct start*)at;
  free(at);
  thread = library_of(*(void**)&start.function);
  return start.function(start.argument);
}

int pthread_create(pthread_t* made, const pthread_attr_t* attributes, void* (*function)(void*), void* argument) {
  int (*original)(pthread_t*, const pthread_attr_t*, void* (*)(void*), void*);
  struct start* start = __libc_malloc(sizeof *start);
  if (!start) return 11;
  *start = (struct start){function, argument};
  *(void**)&original = dlsym(RTLD_NEXT, "pthread_create");
  return original(made, attributes, begin, start);
}

void allocations_count(int on) { __atomic_store_n(&counting, on, __ATOMIC_SEQ_CST); }

/* Print a line for each pair of libraries: library of the thread, calling library, number of calls. */
void allocations_print(void) {
  for (int k = 0; k < rows; ++k) printf("%s %s %ld\n", row[k].thread, row[k].caller, row[k].count);
  fflush(stdout);
}
