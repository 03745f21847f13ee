/* Replays the case that Python recorded: every function on the recorded inputs, then the closed loop on its own.
 *   @{prefix}_replay [case.csv]
 * A difference is |C - Python| / max(1, |Python|). Exit code 0: all within the tolerance, 1: not, 2: no such case.
 */
#include "@{prefix}.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define N @{PREFIX}_JOINTS
#define M @{PREFIX}_MEMORY
#define TOLERANCE 1e-12      /* of one call */
#define LOOP_TOLERANCE 1e-9  /* of all samples in a row, where rounding adds up */
#define LONGEST_NUMBER 32    /* characters, with its comma */

/* A row of the case; the names of the columns are in its first line. */
enum {
  T = 0,
  DT = T + 1,
  X = DT + 1,
  POSITION = X + 4 * N,
  VELOCITY = POSITION + 2 * N,
  JETS = VELOCITY + 2 * N,
  MEMORY = JETS + 5 * N,
  SENT = MEMORY + M,
  U = SENT + N,
  V = U + N,
  NEXT = V + 1,
  X_NEXT = NEXT + M,
  COLUMNS = X_NEXT + 4 * N
};

typedef struct {
  double measure, reference, law, step, loop;
} worst_differences;

/* The closed loop as it goes on by itself. */
typedef struct {
  double x[4 * N], memory[M + 1], sent[N], dt;
} closed_loop;

static double difference(const double *here, const double *python, int length)
{
  double worst = 0.0;
  int i;
  for (i = 0; i < length; ++i) {
    const double scale = fabs(python[i]) > 1.0 ? fabs(python[i]) : 1.0;
    const double d = fabs(here[i] - python[i]) / scale;
    if (isnan(here[i]) && isnan(python[i])) continue;
    if (!(d <= worst)) worst = isnan(d) ? INFINITY : d;
  }
  return worst;
}

static void keep(double *worst, double d)
{
  if (d > *worst) *worst = d;
}

static int plant_sample(const double *x, const double *u, double *x_next, @{prefix}_work *work)
{
  int k, failed = 0;
  memcpy(x_next, x, 4 * N * sizeof(double));
  for (k = 0; k < @{PREFIX}_INNER_STEPS; ++k)
    failed |= @{prefix}_plant_step(x_next, u, @{PREFIX}_SAMPLE_PERIOD / @{PREFIX}_INNER_STEPS, x_next, work);
  return failed;
}

/* Each function on what Python gave to its own. */
static int each_function(const double *row, worst_differences *worst, @{prefix}_work *work)
{
  double position[2 * N], velocity[2 * N], jets[5 * N], u[N], storage, next[M + 1], x_next[4 * N];
  int failed = @{prefix}_plant_measure(row + X, position, velocity, work);
  failed |= @{prefix}_reference(row[T] + @{PREFIX}_LEAD, jets, work);
  failed |= @{prefix}_law(row + POSITION, row + VELOCITY, row + JETS, @{prefix}_gains, row + MEMORY, row + SENT, row[DT],
                          u, &storage, next, work);
  failed |= plant_sample(row + X, row + U, x_next, work);
  keep(&worst->measure, difference(position, row + POSITION, 2 * N));
  keep(&worst->measure, difference(velocity, row + VELOCITY, 2 * N));
  keep(&worst->reference, difference(jets, row + JETS, 5 * N));
  keep(&worst->law, difference(u, row + U, N));
  keep(&worst->law, difference(&storage, row + V, 1));
  keep(&worst->law, difference(next, row + NEXT, M));
  keep(&worst->step, difference(x_next, row + X_NEXT, 4 * N));
  return failed;
}

/* One sample of a controller and its plant. */
static int one_sample(closed_loop *loop, double t, @{prefix}_work *work)
{
  double position[2 * N], velocity[2 * N], jets[5 * N];
  int failed = @{prefix}_plant_measure(loop->x, position, velocity, work);
  failed |= @{prefix}_reference(t + @{PREFIX}_LEAD, jets, work);
  failed |= @{prefix}_law(position, velocity, jets, NULL, loop->memory, loop->sent, loop->dt, loop->sent, NULL,
                          loop->memory, work);
  failed |= plant_sample(loop->x, loop->sent, loop->x, work);
  loop->dt = @{PREFIX}_SAMPLE_PERIOD;
  return failed;
}

static int read_row(FILE *file, double *row)
{
  static char line[COLUMNS * LONGEST_NUMBER]; /* of this program, not of the library */
  char *at = line, *end;
  int i;
  if (fgets(line, (int)sizeof line, file) == NULL) return 0;
  for (i = 0; i < COLUMNS; ++i, at = end + 1) {
    row[i] = strtod(at, &end);
    if (end == at || *end != (i + 1 < COLUMNS ? ',' : '\n')) return -1;
  }
  return 1;
}

static int told(const char *what, double worst, double tolerance)
{
  printf("  %-28s %10.3g  (at most %g)\n", what, worst, tolerance);
  return worst > tolerance;
}

static int report(int samples, int failed, const worst_differences *worst)
{
  int wrong = failed;
  printf("%s: %d samples, worst differences from Python\n", @{prefix}_scenario, samples);
  wrong |= told("law: u, V, next", worst->law, TOLERANCE);
  wrong |= told("reference: jets", worst->reference, TOLERANCE);
  wrong |= told("plant: measured", worst->measure, TOLERANCE);
  wrong |= told("plant: one sample later", worst->step, TOLERANCE);
  wrong |= told("closed loop: x, u, memory", worst->loop, LOOP_TOLERANCE);
  if (failed) printf("  a function returned no result\n");
  return wrong ? 1 : 0;
}

static int no_case(const char *path, const char *why)
{
  fprintf(stderr, "%s: %s\n", path, why);
  return 2;
}

int main(int argc, char **argv)
{
  const char *path = argc > 1 ? argv[1] : "case.csv";
  double row[COLUMNS];
  @{prefix}_work work;
  worst_differences worst = {0.0, 0.0, 0.0, 0.0, 0.0};
  closed_loop loop;
  int samples = 0, failed = 0, state, c;
  FILE *file = fopen(path, "r");

  if (file == NULL) return no_case(path, "cannot be opened; expected the case.csv of this export");
  memset(&loop, 0, sizeof loop);
  memcpy(loop.x, @{prefix}_x0, sizeof loop.x);
  memcpy(loop.memory, @{prefix}_first_memory, M * sizeof(double));
  while ((c = fgetc(file)) != EOF && c != '\n') continue; /* the names of the columns */
  while ((state = read_row(file, row)) > 0) {
    keep(&worst.loop, difference(loop.x, row + X, 4 * N));
    failed |= each_function(row, &worst, &work);
    failed |= one_sample(&loop, row[T], &work);
    keep(&worst.loop, difference(loop.sent, row + U, N));
    keep(&worst.loop, difference(loop.memory, row + NEXT, M));
    ++samples;
  }
  fclose(file);
  if (state < 0 || samples == 0) return no_case(path, "is not a case of this export; expected rows of numbers");
  return report(samples, failed, &worst);
}
