/* SPDX-License-Identifier: Apache-2.0 */
#include <math.h>
#include <mujoco/mujoco.h>
#include <string.h>

static _Thread_local struct fjr_mujoco* moving; /* by this thread */

static void gather(const struct fjr_mujoco* e, const mjtNum* values, double* found, int32_t count) {
  for (int32_t i = 0; i < count; ++i) found[i] = values[e->dof[i]];
}

static void scatter(const struct fjr_mujoco* e, const double* values, mjtNum* found, int32_t count) {
  for (int32_t i = 0; i < count; ++i) found[e->dof[i]] = values[i];
}

/* Add the torques that MuJoCo has no element for, at one stage of a step. */
static void add_torques(const mjModel* m, mjData* d) {
  struct fjr_mujoco* e = moving;
  if (!e || m != e->model || d != e->data) return;
  const struct fjr_robot* r = e->robot;
  const double time = d->time - e->start;
  double q[2 * r->n], dq[2 * r->n], torque[2 * r->n];
  gather(e, d->qpos, q, 2 * r->n);
  gather(e, d->qvel, dq, 2 * r->n);
  const double* given[] = {q, dq, r->state + 4 * r->n, r->u, r->external, r->state + 5 * r->n, r->parameters, &time};
  memcpy(e->arg, given, sizeof given);
  e->res[0] = torque;
  e->failed |= e->torques(e->arg, e->res, e->iw, e->w, 0);
  for (int32_t i = 0; i < 2 * r->n; ++i) d->qfrc_passive[e->dof[i]] += torque[i];
}

/* Advance the outputs of the actuators and the sliders, which MuJoCo does not have. */
static void advance_memory(struct fjr_mujoco* e) {
  struct fjr_robot* r = e->robot;
  double *a = r->state + 4 * r->n, *sliders = a + r->n, q[2 * r->n];
  const double* given[] = {q, a, r->u, sliders, r->parameters, &r->dt};
  gather(e, ((const mjData*)e->data)->qpos, q, 2 * r->n);
  memcpy(e->arg, given, sizeof given);
  e->res[0] = r->next, e->res[1] = r->next + r->n;
  e->failed |= e->memory(e->arg, e->res, e->iw, e->w, 0);
  memcpy(a, r->next, 2 * (size_t)r->n * sizeof(double));
}

/* Add a share of what the contacts of the last step did: torques on the links, force and moment on the arm. */
static void add_contact(const struct fjr_mujoco* e, double share) {
  const mjModel* m = e->model;
  const mjData* d = e->data;
  double *torque = e->robot->contact, *force = torque + e->robot->n;
  for (int32_t i = 0; i < e->robot->n; ++i) torque[i] += share * d->qfrc_constraint[e->dof[i]];
  for (int32_t k = 0; k < d->ncon; ++k) {
    const int second = m->body_weldid[m->geom_bodyid[d->contact[k].geom[1]]]; /* 0: the obstacle, pushed by the arm */
    mjtNum in_contact[6], in_world[3], moment[3];
    mj_contactForce(m, d, k, in_contact);
    mju_mulMatTVec3(in_world, d->contact[k].frame, in_contact);
    mju_scl3(in_world, in_world, second ? share : -share);
    mju_cross(moment, d->contact[k].pos, in_world);
    mju_addTo3(force, in_world);
    mju_addTo3(force + 3, moment);
  }
}

/* Give MuJoCo the state x = (q_l, q_m, p_l, p_m) if it is another one than after the last step. */
static void load(struct fjr_mujoco* e) {
  const mjModel* m = e->model;
  mjData* d = e->data;
  const int32_t n = e->robot->n;
  if (!memcmp(e->known, e->robot->state, 4 * (size_t)n * sizeof(double))) return;
  scatter(e, e->robot->state, d->qpos, 2 * n);
  mj_fwdPosition(m, d);
  double momentum[m->nv];
  scatter(e, e->robot->state + 2 * n, momentum, 2 * n);
  mj_solveM(m, d, d->qvel, momentum, 1);
}

static void store(struct fjr_mujoco* e) {
  const mjModel* m = e->model;
  mjData* d = e->data;
  const int32_t n = e->robot->n;
  double momentum[m->nv];
  mj_fwdPosition(m, d);
  mj_mulM(m, d, momentum, d->qvel);
  gather(e, d->qpos, e->known, 2 * n);
  gather(e, momentum, e->known + 2 * n, 2 * n);
  memcpy(e->robot->state, e->known, 4 * (size_t)n * sizeof(double));
}

int fjr_mujoco_advance(void* engine, struct fjr_robot* robot, int64_t steps) {
  struct fjr_mujoco* e = engine;
  mjData* d = e->data;
  moving = e, e->robot = robot, e->failed = 0;
  load(e);
  memset(robot->contact, 0, ((size_t)robot->n + 6) * sizeof(double));
  for (int64_t k = 0; k < steps && !e->failed; ++k) {
    e->start = d->time;
    mj_step(e->model, d);
    advance_memory(e);
    if (d->ncon) add_contact(e, 1.0 / (double)steps);
  }
  store(e);
  moving = NULL;
  return e->failed;
}

static void ignore(const char* warning) { (void)warning; }

void fjr_mujoco_begin(struct fjr_mujoco* e) {
  mjcb_passive = add_torques;
  mju_user_warning = ignore; /* it would write MUJOCO_LOG.TXT: a state that is not finite ends the plant with a reason */
  e->known[0] = NAN;
}
