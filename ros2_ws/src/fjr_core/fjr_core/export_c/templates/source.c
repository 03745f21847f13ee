/* @{title}: the functions of @{prefix}.h around those that CasADi made. Made by `fjr export-c`; do not edit. */
#include "@{prefix}.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

int @{prefix}_casadi_reference(const double **arg, double **res, long long int *iw, double *w, int mem);
int @{prefix}_casadi_law(const double **arg, double **res, long long int *iw, double *w, int mem);
int @{prefix}_casadi_plant_measure(const double **arg, double **res, long long int *iw, double *w, int mem);
int @{prefix}_casadi_plant_step(const double **arg, double **res, long long int *iw, double *w, int mem);

const char *const @{prefix}_scenario = @{title_literal};
const char *const @{prefix}_joint_names[@{PREFIX}_JOINTS] = {@{joint_literals}};

const double @{prefix}_x0[4 * @{PREFIX}_JOINTS] = {
    @{x0_numbers}};

const double @{prefix}_gains[@{gains_length}] = {
    @{gain_numbers}};

const double @{prefix}_first_memory[@{memory_length}] = {
    @{memory_numbers}};

int @{prefix}_reference(double t, double *jets, @{prefix}_work *work)
{
  work->arg[0] = &t;
  work->res[0] = jets;
  return @{prefix}_casadi_reference(work->arg, work->res, work->iw, work->w, 0);
}

int @{prefix}_law(const double *position, const double *velocity, const double *jets, const double *gains,
@{indent}const double *memory, const double *sent, double dt, double *u, double *V, double *next,
@{indent}@{prefix}_work *work)
{
  int failed;
  work->arg[0] = position;
  work->arg[1] = velocity;
  work->arg[2] = jets;
  work->arg[3] = gains ? gains : @{prefix}_gains;
  work->arg[4] = memory ? memory : @{prefix}_first_memory;
  work->arg[5] = sent; /* NULL: zeros */
  work->arg[6] = &dt;
  work->res[0] = u;
  work->res[1] = V;
  work->res[2] = work->next;
  failed = @{prefix}_casadi_law(work->arg, work->res, work->iw, work->w, 0);
  if (next != NULL) memcpy(next, work->next, @{PREFIX}_MEMORY * sizeof(double));
  return failed;
}

int @{prefix}_plant_measure(const double *x, double *position, double *velocity, @{prefix}_work *work)
{
  work->arg[0] = x;
  work->res[0] = position;
  work->res[1] = velocity;
  return @{prefix}_casadi_plant_measure(work->arg, work->res, work->iw, work->w, 0);
}

int @{prefix}_plant_step(const double *x, const double *u, double dt, double *x_next, @{prefix}_work *work)
{
  int failed;
  work->arg[0] = x;
  work->arg[1] = u;
  work->arg[2] = &dt;
  work->res[0] = work->next;
  failed = @{prefix}_casadi_plant_step(work->arg, work->res, work->iw, work->w, 0);
  memcpy(x_next, work->next, 4 * @{PREFIX}_JOINTS * sizeof(double));
  return failed;
}
