/* SPDX-License-Identifier: Apache-2.0
 * Serialised messages (CDR, little-endian) read and written in place, without allocation.
 */
#ifndef FJR_CDR_H
#define FJR_CDR_H

#include <stddef.h>
#include <stdint.h>

#define FJR_FIELDS 3 /* position, velocity, effort */

/* Fields of a JointState; `wanted` of a reader is a sum of them. */
enum fjr_field { FJR_POSITION = 1, FJR_VELOCITY = 2, FJR_EFFORT = 4 };

/* What is found in a message. */
enum fjr_reading { FJR_READ, FJR_NOT_A_MESSAGE, FJR_MISSING, FJR_DUPLICATE, FJR_WRONG_LENGTH, FJR_NOT_FINITE };

#define FJR_REFUSALS 7 /* kinds: enum fjr_reading from 1 on, and FJR_NO_STAMP */
#define FJR_NO_STAMP 6

/* Messages that were refused, by kind, with the first one of each. */
struct fjr_refusals {
  int64_t count[FJR_REFUSALS];
  size_t size[FJR_REFUSALS], room;
  uint8_t* first; /* (FJR_REFUSALS, room) */
};

/* Reader of JointStates: the values of some names, in the order of these names. The caller allocates the arrays. */
struct fjr_joint_reader {
  int32_t joints;            /* names that are wanted */
  int32_t wanted;            /* fields that are wanted */
  const char* const* name;   /* (joints) */
  int32_t* column;           /* (joints) index of each wanted name in the last list of names */
  uint8_t* seen;             /* (room) the last list of names that held all wanted ones, as it was serialised */
  size_t room, known;        /* known: bytes of `seen` in use, 0: none */
  int64_t stamp;             /* [ns] of the last message */
  double* value[FJR_FIELDS]; /* (joints) of each wanted field: of the last message */
};

/* A serialised message whose stamp and numbers are overwritten; bytes + 4 is aligned to 8. */
struct fjr_message {
  uint8_t* bytes;
  size_t size;
  size_t at[FJR_FIELDS]; /* offsets of the sequences of numbers */
  int32_t length[FJR_FIELDS];
};

/* Read a JointState; return an enum fjr_reading. Values and stamp are valid for FJR_READ only. */
int fjr_read_joint_state(struct fjr_joint_reader* reader, const uint8_t* data, size_t size);

/* Read the n numbers of a Float64MultiArray; return an enum fjr_reading. */
int fjr_read_array(double* values, int32_t n, const uint8_t* data, size_t size);

/* Count a refused message; keep the first of its kind. */
void fjr_refuse(struct fjr_refusals* refusals, int kind, const uint8_t* data, size_t size);

/* Return how many messages of a kind were refused; if any, the first of them can be read. For every thread. */
int64_t fjr_refused(const struct fjr_refusals* refusals, int kind);

/* Write the stamp [ns] into the header of a message. */
void fjr_put_stamp(struct fjr_message* message, int64_t stamp);

/* Write a sequence of numbers; `sequence` counts those of the message from 0. */
void fjr_put_numbers(struct fjr_message* message, int32_t sequence, const double* values);

#endif
