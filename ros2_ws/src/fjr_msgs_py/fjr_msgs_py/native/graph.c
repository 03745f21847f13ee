/* SPDX-License-Identifier: Apache-2.0 */
#include <rcl/graph.h>

static int is_known(const struct fjr_known* k, const uint8_t* gid) {
  const char* other = k->participant + FJR_PARTICIPANT;
  int known = memcmp(gid, k->participant, FJR_PARTICIPANT) == 0;
  for (uint64_t i = 0; i < k->others; ++i)
    known |= memcmp(gid, other + i * RMW_GID_STORAGE_SIZE, RMW_GID_STORAGE_SIZE) == 0;
  return known;
}

static int has_others_on(const struct fjr_known* k, const char* topic) {
  rcutils_allocator_t allocator = rcutils_get_default_allocator();
  rcl_topic_endpoint_info_array_t found = rcl_get_zero_initialized_topic_endpoint_info_array();
  int others = rcl_get_publishers_info_by_topic(k->node, &allocator, topic, false, &found) != RCL_RET_OK;
  for (size_t i = 0; i < found.size; ++i) others |= !is_known(k, found.info_array[i].endpoint_gid);
  others |= rcl_topic_endpoint_info_array_fini(&found, &allocator) != RCL_RET_OK;
  rcl_reset_error();
  return others;
}

int fjr_has_others(void* at) {
  const struct fjr_known* k = at;
  int others = 0;
  for (int32_t i = 0; i < k->topics && !others; ++i) others = has_others_on(k, k->topic[i]);
  return others;
}
