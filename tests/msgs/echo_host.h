/* A host for tests: answer each JointState by the stamp and the efforts of the message, and count. */
struct echo {
  struct fjr_loop* loop;
  struct fjr_joint_reader* reader;
  struct fjr_message* answer;
  struct fjr_ring* ring;
  int64_t messages, requests, ends;
  int32_t by_thread; /* the last request was answered by the thread of the loop */
  int32_t fault; /* message number at which the host fails */
};

int echo_message(void* self, int32_t source, const uint8_t* data, size_t size, int64_t arrival, int64_t* next);
int echo_tick(void* self, int64_t now, int64_t* next);
int echo_request(void* self, int32_t kind, void* argument);
void echo_end(void* self, int32_t outcome);
