/* SPDX-License-Identifier: Apache-2.0
 * The order of samples, from their stamps and times of arrival: late, repeated, jumped, or after a silence.
 *
 * FJR_OLDER: older by less than the timeout, soon after a newer one: delivered late. FJR_BACK: older by more, or after
 * nothing newer arrived for that long; it starts another time line (a robot that was reset, a bag that loops).
 * FJR_FORWARD: newer by more than the timeout, although less time has passed. FJR_LATE: after a silence. The last two
 * end a gap of the same time line. FJR_DOUBTED: a jump not yet confirmed by another sample.
 *
 * Without simulated time a jump counts from its second sample on; the first is discarded if the stamps continue as
 * before. With simulated time a jump counts at once, and a pause between arrivals is no silence, because the stamps are
 * the time; whether an older sample is late is still decided by the arrivals.
 */

static enum fjr_order jump(struct fjr_stamps* s, int simulated, int64_t stamp, int64_t before, enum fjr_order order) {
  const int confirmed = before != FJR_NEVER && stamp >= before && stamp - before <= s->timeout;
  s->unconfirmed = stamp;
  return confirmed || simulated ? order : FJR_DOUBTED;
}

/* Return the order of a sample; only an unconfirmed jump is stored. */
static enum fjr_order classify(struct fjr_stamps* s, int simulated, int64_t stamp, int64_t arrival) {
  const int64_t before = s->unconfirmed;
  s->unconfirmed = FJR_NEVER;
  if (s->last == FJR_NEVER) return FJR_FIRST;
  const int64_t ahead = stamp - s->last;
  const int late = arrival - s->arrival > s->timeout;
  if (ahead < 0 && late) return FJR_BACK;
  if (ahead >= 0 && (s->silent || (late && !simulated))) return FJR_LATE;
  if (ahead > s->timeout || ahead < -s->timeout)
    return jump(s, simulated, stamp, before, ahead < 0 ? FJR_BACK : FJR_FORWARD);
  return ahead < 0 ? FJR_OLDER : ahead ? FJR_NEXT : FJR_REPEATED;
}

/* Accept the sample; return the time since the last one by the stamps, from 0 to the timeout. */
static int64_t accept_stamp(struct fjr_stamps* s, int64_t stamp, int64_t arrival) {
  int64_t elapsed = s->last == FJR_NEVER || stamp < s->last ? 0 : stamp - s->last;
  if (elapsed > s->timeout) elapsed = s->timeout;
  s->last = stamp, s->arrival = arrival, s->silent = 0;
  return elapsed;
}

/* Return 1 once per silence: no sample was accepted for longer than the timeout. */
static int is_silent(struct fjr_stamps* s, int simulated, int64_t now) {
  if (s->last == FJR_NEVER || s->silent || now - (simulated ? s->last : s->arrival) <= s->timeout) return 0;
  s->silent = 1;
  return 1;
}

static void forget_stamps(struct fjr_stamps* s) { s->last = s->unconfirmed = FJR_NEVER, s->silent = 0; }
