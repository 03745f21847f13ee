/* SPDX-License-Identifier: Apache-2.0
 * Recorded inputs of a controller in a file, for programs that replay them (inputs.py).
 */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

enum kind { STATE, TICK, HOLD, RESUME, CHANGE, RESTART, PARAMETERS, NOT_FINITE, REFUSED };

struct input {
  int64_t kind, time;
  struct fjr_sample sample;
};

/* The inputs of one round; in round k times and stamps are later by k shift. */
struct inputs {
  struct input* input;
  size_t count;
  int64_t rounds, shift;
  int simulated;
};

/* Read the arguments: file, rounds, shift, simulated. */
static struct inputs read_inputs(char** argument) {
  struct inputs found = {NULL, 0, atoll(argument[2]), atoll(argument[3]), atoi(argument[4])};
  FILE* file = fopen(argument[1], "rb");
  if (!file) exit(2);
  fseek(file, 0, SEEK_END);
  found.count = (size_t)ftell(file) / sizeof(struct input);
  found.input = (struct input*)malloc(found.count * sizeof(struct input));
  rewind(file);
  if (!found.input || fread(found.input, sizeof(struct input), found.count, file) != found.count) exit(2);
  fclose(file);
  return found;
}

/* Write an effort to the standard output. */
static void put(const double* u) { fwrite(u, sizeof *u, FJR_N, stdout); }
