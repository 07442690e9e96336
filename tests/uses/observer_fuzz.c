/* Fuzzes the exported observer of a robot, called 'robot' here; test_observer.py writes its name instead.
 *
 * Two observers follow one motion under a contact: one undisturbed, one with bad inputs. */
#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "robot_observer.h"
#include "motion.h" /* written by the test: HOME_Q */

enum { N = ROBOT_JOINTS, EPISODES = 80, LONGEST = 8, SETTLING = 400, GARBAGE = 20000 };
static const double PERIOD = 1e-3, BANDWIDTH = 60.0, HOME[N] = {HOME_Q};
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
  printf("%s (cycle %ld, status %d)\n", what, cycle, status);
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

static void sample(long cycle, double q[N], double current[N]) {
  const double t = PERIOD * (double)cycle;
  for (int k = 0; k < N; ++k) {
    q[k] = HOME[k] + 0.05 * sin(4.0 * t + k);
    current[k] = 1.0 + 0.5 * sin(3.0 * t + 2.0 * k);
  }
}

static void finite(const robot_observer *self, const double external[N], long cycle, int status) {
  const double *numbers = (const double *)self; /* all members before the two int */
  for (size_t k = 0; k < offsetof(robot_observer, known) / sizeof *numbers; ++k)
    require(isfinite(numbers[k]), "a member is not finite", cycle, status);
  for (int k = 0; k < N; ++k) require(external[k] == self->external[k], "the estimate is the last good one", cycle, status);
}

enum { POSITION, JUMP, CURRENT, HUGE_CURRENT, CLOCK, TWICE, GAP, LOAD, KINDS };

static double LIMIT[N];

static void episodes(const double velocity[N]) {
  robot_observer one, other;
  long cycle = 0;
  double first[N], none[N];
  sample(0, first, none);
  require(robot_observer_start(&one, PERIOD, BANDWIDTH, velocity, LIMIT, first) == ROBOT_OK, "start", 0, 0);
  require(robot_observer_start(&other, PERIOD, BANDWIDTH, velocity, LIMIT, first) == ROBOT_OK, "start", 0, 0);
  for (int episode = 0; episode < EPISODES; ++episode) {
    const int kind = episode % KINDS, length = 1 + below(LONGEST);
    double truth[N], external[N], last[N];
    for (int k = 0; k < length + SETTLING; ++k, ++cycle) {
      double q[N], current[N], p[ROBOT_PARAMETERS], elapsed = PERIOD;
      sample(cycle, q, current);
      memcpy(p, robot_parameters, sizeof p);
      robot_status status = robot_observer_cycle(&one, elapsed, q, current, p, truth);
      require(status == ROBOT_OK, "the undisturbed observer is OK", cycle, (int)status);
      if (k < length) {
        const int joint = below(N);
        if (kind == POSITION) q[joint] = bad_number();
        if (kind == JUMP) q[joint] += (uniform() < 0.5 ? -1.0 : 1.0) * 100.0;
        if (kind == CURRENT) current[joint] = not_finite();
        if (kind == HUGE_CURRENT) current[joint] = uniform() < 0.5 ? -1e30 : 2.0 * LIMIT[joint];
        if (kind == TWICE) elapsed = 1e-6;
        if (kind == GAP) elapsed = 5.0;
        if (kind == CLOCK) elapsed = uniform() < 0.4 ? 0.0 : uniform() < 0.5 ? -1.0 : not_finite();
        if (kind == LOAD) for (int j = 0; j < ROBOT_PARAMETERS; ++j) p[j] = not_finite();
      }
      memcpy(last, other.external, sizeof last);
      status = robot_observer_cycle(&other, elapsed, q, current, p, external);
      finite(&other, external, cycle, (int)status);
      if (k < length) {
        require(status != ROBOT_OK || (kind == LOAD && other.known < 2), "bad inputs have a status", cycle, (int)status);
        if (status != ROBOT_OK) require(memcmp(last, external, sizeof last) == 0, "nothing bad counts", cycle, (int)status);
      } else {
        require(status == ROBOT_OK, "good inputs are OK", cycle, (int)status);
      }
    }
    for (int k = 0; k < N; ++k)
      require(fabs(external[k] - truth[k]) < 1e-6 * (1.0 + fabs(truth[k])), "settles to the undisturbed estimate", cycle, k);
  }
}

/* Whatever stands in any input and start: finite, and no status OK for what is not finite. */
static void garbage(const double velocity[N]) {
  robot_observer self;
  double external[N];
  require(robot_observer_start(&self, PERIOD, BANDWIDTH, velocity, LIMIT, HOME) == ROBOT_OK, "start", 0, 0);
  for (long cycle = 0; cycle < GARBAGE; ++cycle) {
    double q[N], current[N], p[ROBOT_PARAMETERS], elapsed = uniform() < 0.9 ? PERIOD : bad_number();
    int good = isfinite(elapsed) && elapsed > 0.0;
    memcpy(p, robot_parameters, sizeof p);
    for (int k = 0; k < N; ++k) {
      q[k] = uniform() < 0.02 ? bad_number() : HOME[k] + 1e-4 * uniform();
      current[k] = uniform() < 0.02 ? bad_number() : uniform() < 0.02 ? 1e-310 : uniform();
      good = good && isfinite(q[k]) && isfinite(current[k]);
    }
    if (uniform() < 0.02) p[below(ROBOT_PARAMETERS)] = bad_number();
    const robot_status status = robot_observer_cycle(&self, elapsed, q, current, p, external);
    finite(&self, external, cycle, (int)status);
    require(good || status != ROBOT_OK, "not finite, yet OK", cycle, (int)status);
    if (cycle % 50 == 49) { /* a new start, which may fail */
      double bound[N], limit[N], bandwidth = BANDWIDTH, period = PERIOD;
      const int spoilt = below(7);
      memcpy(bound, velocity, sizeof bound);
      memcpy(limit, LIMIT, sizeof limit);
      memcpy(q, HOME, sizeof q);
      if (spoilt == 0) bandwidth = uniform() < 0.5 ? -1.0 : not_finite();
      if (spoilt == 1) bound[below(N)] = uniform() < 0.5 ? 0.0 : not_finite();
      if (spoilt == 2) limit[below(N)] = uniform() < 0.5 ? 0.0 : not_finite();
      if (spoilt == 3) period = uniform() < 0.5 ? 0.0 : not_finite();
      if (spoilt == 4) q[below(N)] = not_finite();
      const robot_status begun = robot_observer_start(&self, period, bandwidth, bound, limit, q);
      require(begun == (spoilt < 4 ? ROBOT_NOT_CONFIGURED : spoilt == 4 ? ROBOT_NOT_FINITE : ROBOT_OK), "start", cycle, (int)begun);
      if (begun != ROBOT_OK) {
        const robot_status not_begun = robot_observer_cycle(&self, PERIOD, HOME, HOME, p, external);
        require(not_begun == ROBOT_NOT_STARTED, "no start", cycle, (int)not_begun);
        for (int k = 0; k < N; ++k) require(external[k] == 0.0, "zero before a start", cycle, (int)not_begun);
        require(robot_observer_start(&self, PERIOD, BANDWIDTH, velocity, LIMIT, HOME) == ROBOT_OK, "start", cycle, 0);
      }
    }
  }
}

int main(void) {
  double velocity[N];
  for (int k = 0; k < N; ++k) {
    velocity[k] = 5.0;
    LIMIT[k] = 10.0;
  }
  episodes(velocity);
  garbage(velocity);
  printf("OK\n");
  return 0;
}
