/* SPDX-License-Identifier: Apache-2.0
 * The rate of messages that observers read: by the stamps, on a grid of one period, which a jump restarts.
 */

int fjr_is_due(struct fjr_auxiliary_rate* r, int64_t stamp) {
  const int64_t ahead = r->next - stamp;
  if (r->period <= 0) return 1;
  if (ahead > 0 && ahead <= r->period) return 0;
  r->next = ahead <= 0 && ahead > -r->period ? r->next + r->period : stamp + r->period;
  return 1;
}
