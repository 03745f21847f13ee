/* SPDX-License-Identifier: Apache-2.0
 * Publishers of other processes, looked for in the ROS graph without Python.
 */
#ifndef FJR_GRAPH_H
#define FJR_GRAPH_H

#include <stdint.h>

#define FJR_PARTICIPANT 12 /* bytes of a GID */

/* What Python knows. */
struct fjr_known {
  void* node;               /* rcl_node_t* */
  char** topic;             /* (topics) resolved names */
  int32_t topics;
  const char* participant;  /* (FJR_PARTICIPANT) leading bytes of the GIDs of this process, then the GIDs of `others` */
  uint64_t others;          /* number of publishers of other processes */
};

/* Return 1 if the graph shows a publisher on a topic that is not known, or cannot be read; at: struct fjr_known. */
int fjr_has_others(void* at);

#endif
