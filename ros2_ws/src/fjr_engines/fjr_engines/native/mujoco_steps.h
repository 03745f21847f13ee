/* SPDX-License-Identifier: Apache-2.0
 * Inner steps of the plant in MuJoCo, with its Runge-Kutta method of order 4.
 *
 * MuJoCo has inertia, weight, springs, damping and contacts. All other torques come from `torques` and act at every
 * stage of the integrator, through MuJoCo's callback of passive forces.
 */
struct fjr_mujoco {
  void* model;              /* mjModel, mjData */
  void* data;
  const int32_t* dof;       /* (2n) where MuJoCo has q_l, q_m and their velocities */
  fjr_function torques;     /* (q, dq, a, u, external, sliders, parameters, t) -> (2n) */
  fjr_function memory;      /* (q, a, u, sliders, parameters, dt) -> a, sliders */
  const double** arg;
  double** res;
  long long* iw;
  double* w;
  double* known;            /* (4n) state of the robot that MuJoCo has */
  struct fjr_robot* robot;  /* that moves now */
  double start;             /* time of MuJoCo at which the present step began [s] */
  int32_t failed;
};

/* Advance by inner steps; return 0, or another number if a function failed. */
int fjr_mujoco_advance(void* engine, struct fjr_robot* robot, int64_t steps);

/* Let MuJoCo call back for passive forces, in the whole process; forget what MuJoCo knows of the state. */
void fjr_mujoco_begin(struct fjr_mujoco* engine);
