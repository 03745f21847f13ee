/* SPDX-License-Identifier: Apache-2.0
 * The order of samples, from their stamps and times of arrival: late, repeated, jumped, or after a silence.
 *
 * FJR_OLDER: older by less than the timeout, soon after a newer one: delivered late; or the last one again, although a
 * silence followed. FJR_BACK: older by more, or after nothing newer arrived for that long; it starts another time line
 * (a robot that was reset, a bag that loops). FJR_FORWARD: newer by more than the timeout, although less time has
 * passed. FJR_LATE: after a silence, which in real time a repeated sample does not end. FJR_GAP: newer by more than
 * LONGEST_GAP, after as long a pause of the arrivals, where samples came more often before. The last three end a gap of
 * the same time line. FJR_DOUBTED: a jump not yet confirmed by another sample. FJR_STALE: a newer sample follows.
 *
 * Samples that waited while this process was paused come at once when it goes on, oldest first. After a pause of the
 * arrivals a sample whose age (arrival - stamp) has grown waits for a newer one, for at most WAITING: the last of them
 * is answered, once the age is the usual one again, nothing newer comes, or the age no longer falls (a robot whose
 * clock stood still).
 *
 * Without simulated time a jump counts from its second sample on; the first is discarded if the stamps continue as
 * before. With simulated time a jump counts at once, and a pause between arrivals is no silence, because the stamps are
 * the time; whether an older sample is late is still decided by the arrivals.
 */
#define LONGEST_GAP 0.1    /* s; a longer gap is a recovery, and an observer restarts */
#define OFTEN 4            /* a gap is this much longer than the interval before it */
#define PAUSE 10000000     /* ns; samples that arrive after a longer pause may have waited */
#define LATER 2000000      /* ns; a sample that is older than usual by more has waited */
#define SLOWLY 64          /* samples in which the usual age follows a larger one */
#define WAITING 5000000    /* ns */
#define DRIFT 1000         /* of this time the least age forgets one part: two clocks may drift apart */

/* Return 1 if the sample is to wait for a newer one. */
static int waits(struct fjr_stamps* s, int simulated, int64_t stamp, int64_t arrival) {
  const int waited = s->waiting != FJR_NEVER;
  s->waiting = FJR_NEVER;
  if (simulated || s->last == FJR_NEVER || stamp <= s->last) return 0;
  const int64_t age = arrival - stamp;
  if (age - s->usual_age <= LATER || (!waited && arrival - s->arrival <= PAUSE)) return 0;
  const int64_t looked = arrival - s->falling_since;
  const int alone = waited && arrival - s->waiting_since >= WAITING;
  if (alone || (waited && looked >= WAITING && s->age - age < looked / 2)) {
    s->usual_age = age;
    return 0;
  }
  if (!waited || looked >= WAITING) s->falling_since = arrival, s->age = age;
  s->waiting = stamp, s->waiting_since = arrival;
  return 1;
}

static enum fjr_order jump(struct fjr_stamps* s, int simulated, int64_t stamp, int64_t before, enum fjr_order order) {
  const int confirmed = before != FJR_NEVER && stamp >= before && stamp - before <= s->timeout;
  s->unconfirmed = stamp;
  return confirmed || simulated ? order : FJR_DOUBTED;
}

/* Return 1 if the time since the last sample is a gap. */
static int is_gap(const struct fjr_stamps* s, int64_t time) {
  return s->interval && time > (int64_t)(LONGEST_GAP * 1e9) && time / OFTEN > s->interval;
}

/* Return the order of a sample; only an unconfirmed jump is stored. */
static enum fjr_order classify(struct fjr_stamps* s, int simulated, int64_t stamp, int64_t arrival) {
  const int64_t before = s->unconfirmed;
  s->unconfirmed = FJR_NEVER;
  if (waits(s, simulated, stamp, arrival)) return FJR_STALE;
  if (s->last == FJR_NEVER) return FJR_FIRST;
  const int64_t ahead = stamp - s->last;
  const int late = arrival - s->arrival > s->timeout;
  if (ahead < 0 && late) return FJR_BACK;
  if (!ahead && late && !simulated) return FJR_OLDER;
  if (ahead >= 0 && (s->silent || (late && !simulated))) return FJR_LATE;
  if (ahead > s->timeout || ahead < -s->timeout)
    return jump(s, simulated, stamp, before, ahead < 0 ? FJR_BACK : FJR_FORWARD);
  if (!simulated && is_gap(s, ahead) && is_gap(s, arrival - s->arrival)) return FJR_GAP;
  return ahead < 0 ? FJR_OLDER : ahead ? FJR_NEXT : FJR_REPEATED;
}

/* Accept the sample; return the time since the last one by the stamps, from 0 to the timeout. */
static int64_t accept_stamp(struct fjr_stamps* s, int64_t stamp, int64_t arrival) {
  int64_t elapsed = s->last == FJR_NEVER || stamp < s->last ? 0 : stamp - s->last;
  const int64_t age = arrival - stamp;
  if (s->last == FJR_NEVER || age < s->usual_age) s->usual_age = age;
  s->usual_age += (age - s->usual_age) / SLOWLY;
  if (s->last == FJR_NEVER || stamp < s->last || age < s->least_age) s->least_age = age;
  s->least_age += elapsed / DRIFT;
  if (elapsed) s->interval = elapsed;
  if (elapsed > s->timeout) elapsed = s->timeout;
  if (stamp != s->last) s->arrival = arrival;
  s->last = stamp, s->silent = 0;
  return elapsed;
}

static void note_gap(struct fjr_stamps* s, int64_t stamp, int64_t arrival) {
  const int64_t by_stamps = stamp - s->last, by_arrivals = arrival - s->arrival;
  s->gap = by_stamps > by_arrivals ? by_stamps : by_arrivals;
  s->gap_end = stamp;
}

/* Return 1 once per silence: no sample was accepted for longer than the timeout. */
static int is_silent(struct fjr_stamps* s, int simulated, int64_t now) {
  if (s->last == FJR_NEVER || s->silent || now - (simulated ? s->last : s->arrival) <= s->timeout) return 0;
  s->silent = 1;
  return 1;
}

static void forget_stamps(struct fjr_stamps* s) {
  s->last = s->unconfirmed = s->waiting = s->gap_end = FJR_NEVER;
  s->interval = s->silent = 0;
}
