/* SPDX-License-Identifier: Apache-2.0
 * White noise that depends on nothing but (seed, sample, joint): Philox4x64-10, a counter-based generator.
 * J. Salmon, M. Moraes, R. Dror, D. Shaw, Parallel random numbers: as easy as 1, 2, 3, SC 2011; numpy.random.Philox is
 * the same. The key is (seed, 0), the counter (sample, joint, 0, 0). Two words make two normal numbers by
 * G. E. P. Box, M. E. Muller, Annals of Mathematical Statistics 29(2), 1958.
 */
#include <math.h>
#include <stdint.h>

__extension__ typedef unsigned __int128 uint128;

static void philox(uint64_t c[4], uint64_t k0, uint64_t k1) {
  for (int round = 0; round < 10; ++round) {
    const uint128 first = (uint128)0xD2E7470EE14C6C93u * c[0];
    const uint128 second = (uint128)0xCA5A826395121157u * c[2];
    const uint64_t c1 = c[1], c3 = c[3];
    c[0] = (uint64_t)(second >> 64) ^ c1 ^ k0;
    c[1] = (uint64_t)second;
    c[2] = (uint64_t)(first >> 64) ^ c3 ^ k1;
    c[3] = (uint64_t)first;
    k0 += 0x9E3779B97F4A7C15u;
    k1 += 0xBB67AE8584CAA73Bu;
  }
}

/* Uniform in [0, 1) with 53 bits, as in NumPy. */
static double unit(uint64_t word) { return (double)(word >> 11) * (1.0 / 9007199254740992.0); }

static void normal_pair(uint64_t first, uint64_t second, double* z) {
  const double radius = sqrt(-2 * log(1 - unit(first))), angle = 6.283185307179586 * unit(second);
  z[0] = radius * cos(angle);
  z[1] = radius * sin(angle);
}

/* Fill z (4) with normal numbers of a joint at a sample. */
static void normals(uint64_t seed, uint64_t sample, uint64_t joint, double* z) {
  uint64_t c[4] = {sample, joint, 0, 0};
  philox(c, seed, 0);
  normal_pair(c[0], c[1], z);
  normal_pair(c[2], c[3], z + 2);
}
