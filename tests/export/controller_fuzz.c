/* Fuzzes the exported controller of a robot, called 'robot' here; test_c_controller_safety.py writes its name instead.
 *
 * Two robots under control follow one reference: one undisturbed, one with bad inputs. Each robot is simulated by the
 * exported model, without dry friction (SMOOTH_PARAMETERS). Prints what failed and returns 1, or prints OK. */
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "robot_controller.h"
#include "smooth.h" /* written by the test: SMOOTH_PARAMETERS, HOME_Q, AMPLITUDE, VELOCITY, LIMIT, HELD */

enum { N = ROBOT_JOINTS, LONGEST = 20, SETTLING = 600, EPISODES = 60, GARBAGE = 20000 };
static const double PERIOD = 1e-3, OMEGA = 12.0, SETTLED = 1e-5 /* of the limit */, DENORMAL = 1e-310;
static const double PARAMETERS[ROBOT_PARAMETERS] = {SMOOTH_PARAMETERS}, HOME[N] = {HOME_Q};
static const char *doing = "nothing";
static unsigned long long seed = 0x9E3779B97F4A7C15ULL;

static double uniform(void) { /* xorshift64, in [0, 1) */
  seed ^= seed << 13;
  seed ^= seed >> 7;
  seed ^= seed << 17;
  return (double)(seed >> 11) / 9007199254740992.0;
}

static int below(int bound) { return (int)(uniform() * bound); }

static void require(int holds, const char *what, long cycle, int status) {
  if (holds) return;
  printf("%s: %s (cycle %ld, status %d)\n", doing, what, cycle, status);
  exit(1);
}

static double bad_number(void) {
  const double numbers[] = {NAN, INFINITY, -INFINITY, DBL_MAX, -DBL_MAX, 1e300, -1e200, 1e30, -1e9};
  return numbers[below((int)(sizeof numbers / sizeof numbers[0]))];
}

static double not_finite(void) {
  const double numbers[] = {NAN, INFINITY, -INFINITY};
  return numbers[below(3)];
}

static robot_configuration configured(int hold) {
  robot_configuration set = {.period = PERIOD, .bandwidth = 100.0, .hold = hold};
  for (int k = 0; k < N; ++k) {
    set.limit[k] = LIMIT;
    set.velocity[k] = VELOCITY;
    set.following[k] = 0.03 * VELOCITY; /* three time constants */
  }
  return set;
}

typedef struct {
  robot_controller controller;
  robot_pose pose;
  double q[N], qd[N], current[N];
} Plant;

static void start(Plant *plant, int hold) {
  const robot_configuration set = configured(hold);
  memset(plant, 0, sizeof *plant);
  memcpy(plant->q, HOME, sizeof HOME);
  require(robot_controller_start(&plant->controller, &set, HOME) == ROBOT_OK, "start", 0, 0);
  require(robot_start(&plant->pose, HOME) == ROBOT_OK, "start of the plant", 0, 0);
}

static void reference(long cycle, double q[N], double qd[N], double qdd[N]) {
  const double t = PERIOD * (double)cycle;
  for (int k = 0; k < N; ++k) {
    q[k] = HOME[k] + AMPLITUDE * (1.0 - cos(OMEGA * t)) / 2.0;
    qd[k] = AMPLITUDE * OMEGA * sin(OMEGA * t) / 2.0;
    qdd[k] = AMPLITUDE * OMEGA * OMEGA * cos(OMEGA * t) / 2.0;
  }
}

/* A period of M qdd = gains current - h(q, qd), in four steps. */
static void advance(Plant *plant) {
  const double none[N] = {0.0}, step = PERIOD / 4.0;
  for (int part = 0; part < 4; ++part) {
    double M[N * N], rest[N], qdd[N];
    robot_inertia(&plant->pose, PARAMETERS, M);
    robot_torques(&plant->pose, plant->qd, none, PARAMETERS, rest);
    for (int k = 0; k < N; ++k) rest[k] = robot_drive_gains[k] * plant->current[k] - rest[k];
    for (int p = 0; p < N; ++p) /* Gauss: M is positive definite */
      for (int k = p + 1; k < N; ++k) {
        const double f = M[k * N + p] / M[p * N + p];
        for (int j = p; j < N; ++j) M[k * N + j] -= f * M[p * N + j];
        rest[k] -= f * rest[p];
      }
    for (int k = N - 1; k >= 0; --k) {
      qdd[k] = rest[k];
      for (int j = k + 1; j < N; ++j) qdd[k] -= M[k * N + j] * qdd[j];
      qdd[k] /= M[k * N + k];
    }
    for (int k = 0; k < N; ++k) {
      plant->qd[k] += step * qdd[k];
      plant->q[k] += step * plant->qd[k];
    }
    require(robot_move(&plant->pose, plant->q) == ROBOT_OK, "the plant left its range", 0, 0);
  }
}

static void within_limits(const double current[N], long cycle, int status) {
  for (int k = 0; k < N; ++k)
    require(isfinite(current[k]) && fabs(current[k]) <= LIMIT, "currents finite and within limits", cycle, status);
}

enum { MEASURED, MEASURED_JUMP, REFERENCE, REFERENCE_JUMP, CLOCK, MISSED, LOAD, KINDS };
static const char *const NAMES[KINDS] = {"measured", "measured jump", "reference", "reference jump",
    "clock", "missed", "parameters"};

/* A cycle of the disturbed robot, with an input of that kind spoilt (or none, KINDS); returns the status. */
static robot_status disturbed(Plant *plant, int kind, double elapsed, long cycle) {
  double q_r[N], qd_r[N], qdd_r[N], q[N], p[ROBOT_PARAMETERS], before[N];
  const double bad = bad_number(), jump = (uniform() < 0.5 ? -1.0 : 1.0) * 1e3 * VELOCITY * PERIOD * (1.0 + uniform());
  const int k = below(N), hold = plant->controller.set.hold;
  reference(cycle, q_r, qd_r, qdd_r);
  memcpy(q, plant->q, sizeof q);
  memcpy(p, PARAMETERS, sizeof p);
  memcpy(before, plant->controller.good, sizeof before);
  const int held = plant->controller.held;
  if (cycle % 2) qdd_r[k] += DENORMAL; /* a good input */
  if (kind == MEASURED) q[k] = bad;
  if (kind == MEASURED_JUMP) q[k] += jump;
  if (kind == REFERENCE) {
    double *const inputs[] = {q_r, qd_r, qdd_r};
    inputs[below(3)][k] = not_finite();
  }
  if (kind == REFERENCE_JUMP) q_r[k] += jump;
  if (kind == CLOCK) elapsed = uniform() < 0.3 ? 0.0 : uniform() < 0.5 ? -1.0 : bad;
  if (kind == LOAD) for (int j = 0; j < ROBOT_PARAMETERS; ++j) p[j] = not_finite();
  const robot_status status = robot_controller_cycle(&plant->controller, elapsed, q_r, qd_r, qdd_r, q, p, plant->current);
  within_limits(plant->current, cycle, (int)status);
  for (int j = 0; j < N && status != ROBOT_OK; ++j)
    require(plant->current[j] == (held < hold ? before[j] : 0.0), "the last good currents, then zero", cycle, (int)status);
  return status;
}

static void episodes(int hold) {
  Plant one, other;
  long cycle = 0;
  start(&one, hold);
  start(&other, hold);
  for (int episode = 0; episode < EPISODES; ++episode) {
    const int kind = episode % KINDS, length = 1 + below(LONGEST);
    int lost = 0, recovered = -1;
    doing = NAMES[kind];
    for (int k = 0; k < length + SETTLING; ++k) {
      const int spoilt = k < length;
      int missed = spoilt && kind == MISSED ? 1 + below(3) : 0;
      for (; missed >= 0; --missed, ++cycle) {
        robot_status status = disturbed(&one, KINDS, PERIOD, cycle);
        require(status == ROBOT_OK, "the undisturbed controller is OK", cycle, (int)status);
        advance(&one);
        if (missed == 0) {
          const double elapsed = spoilt && kind == MISSED ? 2.0 * PERIOD : PERIOD * (0.8 + 0.4 * uniform());
          status = disturbed(&other, spoilt ? kind : KINDS, elapsed, cycle);
          if (spoilt) require(status != ROBOT_OK, "bad inputs have a status", cycle, (int)status);
          if (!spoilt && recovered < 0 && status == ROBOT_OK) recovered = k - length;
          if (recovered >= 0) require(status == ROBOT_OK, "good inputs are OK", cycle, (int)status);
        }
        lost += spoilt;
        advance(&other);
      }
    }
    require(recovered >= 0 && recovered <= lost, "recovers within as many cycles as were lost", cycle, recovered);
    if (kind == LOAD || kind == CLOCK) require(recovered == 0, "recovers at once", cycle, recovered);
    for (int j = 0; j < N; ++j)
      require(fabs(one.current[j] - other.current[j]) < SETTLED * LIMIT, "settles to the undisturbed currents", cycle, j);
  }
}

/* A position lost in every other cycle leaves the robot under control. */
static void every_other_cycle(void) {
  Plant plant;
  doing = "every other cycle";
  start(&plant, 1);
  for (long cycle = 0; cycle < 3000; ++cycle) {
    const robot_status status = disturbed(&plant, cycle % 2 ? MEASURED : KINDS, PERIOD, cycle);
    require((status == ROBOT_OK) == !(cycle % 2), "status", cycle, (int)status);
    advance(&plant);
    double q_r[N], qd_r[N], qdd_r[N];
    reference(cycle + 1, q_r, qd_r, qdd_r);
    for (int k = 0; k < N; ++k) require(fabs(q_r[k] - plant.q[k]) < 0.02 * AMPLITUDE, "tracks", cycle, (int)status);
  }
}

/* Reference and robot go on at almost the velocity while everything is lost: both are found again in as much time. */
static void long_outages(void) {
  const double speed = 0.1, none[N] = {0.0};
  doing = "long outages";
  for (int lost = 1; lost <= 400; lost = 3 * lost + 1) {
    robot_configuration set = configured(0);
    robot_controller controller;
    double q[N], qd[N], current[N], lose[N];
    int recovered = -1;
    for (int k = 0; k < N; ++k) {
      set.velocity[k] = speed;
      q[k] = HOME[k];
      qd[k] = 0.95 * speed;
      lose[k] = not_finite();
    }
    require(robot_controller_start(&controller, &set, HOME) == ROBOT_OK, "start", lost, 0);
    for (int cycle = 0; cycle < 2 * lost + 10; ++cycle) {
      const int bad = cycle < lost;
      for (int k = 0; k < N; ++k) q[k] += PERIOD * qd[k];
      const double *const seen = bad ? lose : q;
      const robot_status status = robot_controller_cycle(&controller, PERIOD, seen, qd, none, seen, PARAMETERS, current);
      within_limits(current, cycle, (int)status);
      if (bad) require(status == ROBOT_NOT_FINITE, "status", cycle, (int)status);
      if (!bad && recovered < 0 && status == ROBOT_OK) recovered = cycle - lost;
      if (recovered >= 0) require(status == ROBOT_OK, "stays OK", cycle, (int)status);
    }
    require(recovered >= 0 && recovered <= lost, "recovers within as many cycles", lost, recovered);
  }
}

/* Whatever stands in any input, configuration and start: finite, within limits, and no status OK for what is not finite. */
static void garbage(void) {
  Plant plant;
  doing = "garbage";
  start(&plant, 3);
  for (long cycle = 0; cycle < GARBAGE; ++cycle) {
    double in[4][N], p[ROBOT_PARAMETERS], elapsed = uniform() < 0.9 ? PERIOD : bad_number();
    int finite = isfinite(elapsed);
    memcpy(p, robot_parameters, sizeof p);
    for (int k = 0; k < N; ++k) {
      in[0][k] = plant.controller.reference[k] + (uniform() - 0.5) * VELOCITY * PERIOD;
      in[3][k] = plant.controller.measured[k] + (uniform() - 0.5) * VELOCITY * PERIOD;
      in[1][k] = 2.0 * (uniform() - 0.5) * VELOCITY;
      in[2][k] = pow(10.0, 20.0 * uniform() - 10.0);
      for (int j = 0; j < 4; ++j) {
        if (uniform() < 0.02) in[j][k] = bad_number();
        if (uniform() < 0.02) in[j][k] = DENORMAL;
        finite = finite && isfinite(in[j][k]);
      }
    }
    if (uniform() < 0.02) p[below(ROBOT_PARAMETERS)] = bad_number();
    const robot_status status = robot_controller_cycle(&plant.controller, elapsed, in[0], in[1], in[2], in[3], p, plant.current);
    within_limits(plant.current, cycle, (int)status);
    require(finite || status != ROBOT_OK, "not finite, yet OK", cycle, (int)status);
    if (cycle % 50 == 49) { /* a new start, which may fail */
      robot_configuration set = configured(3);
      double q[N];
      const int spoilt = below(7);
      for (int k = 0; k < N; ++k) q[k] = HOME[k] + 0.1 * AMPLITUDE * uniform();
      if (spoilt == 0) set.period = uniform() < 0.5 ? -1.0 : not_finite();
      if (spoilt == 1) set.bandwidth = uniform() < 0.5 ? 0.0 : not_finite();
      if (spoilt == 2) set.limit[below(N)] = uniform() < 0.5 ? -1.0 : not_finite();
      if (spoilt == 3) set.velocity[below(N)] = uniform() < 0.5 ? 0.0 : not_finite();
      if (spoilt == 4) set.following[below(N)] = uniform() < 0.5 ? 0.0 : not_finite();
      if (spoilt == 5) q[below(N)] = not_finite();
      const robot_status begun = robot_controller_start(&plant.controller, &set, q);
      require((begun == ROBOT_OK) == (spoilt > 5), "start", cycle, (int)begun);
      if (begun != ROBOT_OK) {
        require(begun == (spoilt < 5 ? ROBOT_NOT_CONFIGURED : ROBOT_NOT_FINITE), "status of a start", cycle, (int)begun);
        const robot_status not_begun = robot_controller_cycle(&plant.controller, PERIOD, HOME, HOME, HOME, HOME, p, plant.current);
        require(not_begun == ROBOT_NOT_STARTED, "no start", cycle, (int)not_begun);
        for (int k = 0; k < N; ++k) require(plant.current[k] == 0.0, "zero before a start", cycle, (int)not_begun);
        start(&plant, 3);
      }
    }
  }
}

/* The model's own start and move: a status, and the last good pose. */
static void poses(void) {
  robot_pose pose, before;
  doing = "poses";
  for (int trial = 0; trial < 200; ++trial) {
    double q[N];
    require(robot_start(&pose, HOME) == ROBOT_OK, "start", trial, 0);
    before = pose;
    memcpy(q, HOME, sizeof q);
    q[below(N)] = not_finite();
    require(robot_move(&pose, q) == ROBOT_NOT_FINITE, "move", trial, 0);
    require(memcmp(&pose, &before, sizeof pose) == 0, "the last good pose stays", trial, 0);
    memset(&pose, 0xFF, sizeof pose); /* numbers that are not */
    require(robot_start(&pose, q) == ROBOT_NOT_FINITE, "start", trial, 0);
    for (int k = 0; k < ROBOT_COORDINATES; ++k) require(isfinite(pose.c[k]), "a pose at a failed start", trial, 0);
    q[below(N)] = bad_number();
    (void)robot_move(&pose, q);
    for (int k = 0; k < ROBOT_COORDINATES; ++k) require(isfinite(pose.c[k]), "a pose", trial, 0);
  }
}

int main(void) {
  poses();
  episodes(0);
  episodes(HELD);
  every_other_cycle();
  long_outages();
  garbage();
  printf("OK\n");
  return 0;
}
