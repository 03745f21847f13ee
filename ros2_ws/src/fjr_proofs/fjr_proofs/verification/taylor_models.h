/* SPDX-License-Identifier: Apache-2.0 */
/* A function as a list of instructions: out[i] = op[i](left[i], right[i]), numbers of values in the memory. An input has
 * its number in `left` and an output its number in `out`; a constant is number[i]. */
struct fjr_tape {
  const int32_t *op, *out, *left, *right;
  const double *number;
  int64_t count, inputs, outputs;
};

/* Evaluate a tape on `boxes` boxes: inputs (boxes, inputs, WIDTH) -> results (boxes, outputs, WIDTH); memory: of the
 * values. Return 1 if a divisor may be zero. */
int fjr_taylor_evaluate(
    const struct fjr_tape *tape, const double *inputs, int64_t boxes, double *results, double *memory);
