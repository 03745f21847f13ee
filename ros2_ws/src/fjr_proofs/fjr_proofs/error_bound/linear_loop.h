/* SPDX-License-Identifier: Apache-2.0 */
/* Cells of a loop with S states, m torques and n efforts; `width` is samples (2 m + n) + S. Row-major matrices of each
 * cell: maps (S, width), the response to torques at the start and the end of a sample and to efforts, for each sample,
 * then the loop over the cell; bent (S, m), see CellModels.curvature. half: half the sample period [s]. */
struct fjr_chain {
  const double *maps, *bent;
  double half;
  int32_t states, torques, efforts, samples;
};

/* Add the responses X maps of a chain of `blocks` cells to sums (rows, m + n), from X (rows, S) back; X becomes their
 * product. cells: of each block. product (rows, width): memory. */
void fjr_chain_sums(
    const struct fjr_chain *chain, const int64_t *cells, int64_t blocks, int64_t rows, double *X, double *sums,
    double *product);
