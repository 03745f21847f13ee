/* SPDX-License-Identifier: Apache-2.0
 * CDR aligns each value by its own size, counted from the end of the 4 bytes of the header. Every length is checked
 * against the end of the message before it is used.
 */
#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "messages are read in place on little-endian processors only"
#endif

#define HEADER 4
#define SECOND 1000000000

/* A place in a message, counted from the end of the header. `bad`: the message ends before a value. */
struct cursor {
  const uint8_t* data;
  size_t at, size;
  int bad;
};

static struct cursor cursor_of(const uint8_t* data, size_t size) {
  struct cursor c = {data + HEADER, 0, size < HEADER ? 0 : size - HEADER, 0};
  c.bad = size < HEADER || data[0] != 0 || data[1] != 1;
  return c;
}

/* Skip `count` values of `width` bytes each; return where they begin, 0 if the message ends before. */
static const uint8_t* skip(struct cursor* c, size_t count, size_t width) {
  const size_t begin = count ? (c->at + width - 1) / width * width : c->at;
  if (c->bad || begin > c->size || count > (c->size - begin) / width) {
    c->bad = 1;
    return NULL;
  }
  c->at = begin + count * width;
  return c->data + begin;
}

static uint32_t read_word(struct cursor* c) {
  uint32_t word = 0;
  const uint8_t* from = skip(c, 1, 4);
  if (from) memcpy(&word, from, 4);
  return word;
}

static void skip_string(struct cursor* c) { skip(c, read_word(c), 1); }

static void copy_numbers(double* to, const uint8_t* from, size_t count) { memcpy(to, from, count * sizeof(double)); }

static double number_at(const uint8_t* numbers, int32_t column) {
  double value;
  memcpy(&value, numbers + 8 * (size_t)column, sizeof value);
  return value;
}

/* Return the index of a name in a list of `count` serialised names, -1 if it is missing, -2 if it is there twice. */
static int32_t index_of(const char* name, struct cursor names, uint32_t count) {
  const size_t length = strlen(name);
  int32_t found = -1;
  for (uint32_t i = 0; i < count; ++i) {
    size_t size = read_word(&names);
    const uint8_t* text = skip(&names, size, 1);
    if (!text) return -1;
    if (size && text[size - 1] == 0) --size;
    if (size != length || memcmp(text, name, length)) continue;
    if (found >= 0) return -2;
    found = (int32_t)i;
  }
  return found;
}

/* Look up all wanted names in a list; keep the list if they are there. */
static int look_up(struct fjr_joint_reader* r, struct cursor names, uint32_t count, const uint8_t* list, size_t bytes) {
  int missing = 0, duplicate = 0;
  r->known = 0;
  for (int32_t i = 0; i < r->joints; ++i) {
    r->column[i] = index_of(r->name[i], names, count);
    missing |= r->column[i] == -1;
    duplicate |= r->column[i] == -2;
  }
  if (missing || duplicate) return missing ? FJR_MISSING : FJR_DUPLICATE;
  if (bytes <= r->room) {
    memcpy(r->seen, list, bytes);
    r->known = bytes;
  }
  return FJR_READ;
}

static int pick(const struct fjr_joint_reader* r, const uint8_t* numbers, double* values) {
  for (int32_t i = 0; i < r->joints; ++i) {
    values[i] = number_at(numbers, r->column[i]);
    if (!isfinite(values[i])) return FJR_NOT_FINITE;
  }
  return FJR_READ;
}

int fjr_read_joint_state(struct fjr_joint_reader* r, const uint8_t* data, size_t size) {
  struct cursor c = cursor_of(data, size), names;
  const uint8_t* numbers[FJR_FIELDS];
  uint32_t length[FJR_FIELDS];
  const uint32_t seconds = read_word(&c), nanoseconds = read_word(&c);
  skip_string(&c);
  const uint32_t count = read_word(&c);
  const size_t begin = c.at;
  names = c;
  for (uint32_t i = 0; i < count && !c.bad; ++i) skip_string(&c);
  const size_t bytes = c.at - begin;
  for (int field = 0; field < FJR_FIELDS; ++field) {
    length[field] = read_word(&c);
    numbers[field] = skip(&c, length[field], sizeof(double));
  }
  if (c.bad) return FJR_NOT_A_MESSAGE;
  if (!r->known || bytes != r->known || memcmp(r->seen, c.data + begin, bytes)) {
    const int found = look_up(r, names, count, c.data + begin, bytes);
    if (found != FJR_READ) return found;
  }
  r->stamp = (int64_t)(int32_t)seconds * SECOND + nanoseconds;
  static const int order[FJR_FIELDS] = {0, 2, 1}; /* the order in which faults are reported */
  for (int i = 0; i < FJR_FIELDS; ++i) {
    const int field = order[i];
    if (!(r->wanted >> field & 1)) continue;
    if (length[field] != count) return FJR_WRONG_LENGTH;
    const int found = pick(r, numbers[field], r->value[field]);
    if (found != FJR_READ) return found;
  }
  return FJR_READ;
}

int fjr_read_array(double* values, int32_t n, const uint8_t* data, size_t size) {
  struct cursor c = cursor_of(data, size);
  const uint32_t dimensions = read_word(&c);
  for (uint32_t i = 0; i < dimensions && !c.bad; ++i) {
    skip_string(&c);
    skip(&c, 2, 4);
  }
  read_word(&c); /* data_offset */
  const uint32_t length = read_word(&c);
  const uint8_t* numbers = skip(&c, length, sizeof(double));
  if (c.bad) return FJR_NOT_A_MESSAGE;
  if (length != (uint32_t)n) return FJR_WRONG_LENGTH;
  copy_numbers(values, numbers, length);
  for (int32_t i = 0; i < n; ++i)
    if (!isfinite(values[i])) return FJR_NOT_FINITE;
  return FJR_READ;
}

void fjr_put_stamp(struct fjr_message* message, int64_t stamp) {
  const int32_t seconds = (int32_t)(stamp / SECOND);
  const uint32_t nanoseconds = (uint32_t)(stamp % SECOND);
  memcpy(message->bytes + HEADER, &seconds, 4);
  memcpy(message->bytes + HEADER + 4, &nanoseconds, 4);
}

void fjr_put_numbers(struct fjr_message* message, int32_t sequence, const double* values) {
  memcpy(message->bytes + message->at[sequence], values, (size_t)message->length[sequence] * sizeof(double));
}

void fjr_refuse(struct fjr_refusals* r, int kind, const uint8_t* data, size_t size) {
  const int64_t count = r->count[kind];
  if (count == 0) {
    r->size[kind] = size < r->room ? size : r->room;
    memcpy(r->first + (size_t)kind * r->room, data, r->size[kind]);
  }
  __atomic_store_n(&r->count[kind], count + 1, __ATOMIC_RELEASE);
}

int64_t fjr_refused(const struct fjr_refusals* r, int kind) { return __atomic_load_n(&r->count[kind], __ATOMIC_ACQUIRE); }
