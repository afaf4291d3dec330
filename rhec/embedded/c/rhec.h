/* Receding horizon estimation and control (RHEC) of a tracked robot: nonlinear moving horizon
 * estimation (RHE) of pose, speed and traction, nonlinear model predictive control (RHC) of the yaw
 * rate, one Gauss-Newton iteration each a sample.
 *
 * C99, nothing but libm: no heap, no input or output, no variables of its own. All memory is in
 * `struct rhec`, which the caller provides: two robots are two of them, and different ones may be
 * used by different threads.
 *
 * Units: m, s, rad; x, y and yaw theta of the robot in the plane, yaw counter-clockwise and
 * unwrapped. nu, omega: speed and yaw rate of the tracks; over ground they are mu * nu and
 * kappa * omega.
 *
 * Once, then every RHEC_DT_S seconds:
 *
 *     rhec_init(&r, &rhec_scenario, guess);
 *
 *     rhec_prepare_estimate(&r);       any time since the last sample
 *     rhec_prepare_control(&r);        any time since the last sample
 *     ... the measurement z arrives ...
 *     rhec_estimate(&r, z, estimate);  feedback phase of the RHE
 *     rhec_control(&r, &omega);        references on the path, feedback phase of the RHC
 *     ... command omega, at the robot's set speed ...
 *
 * Only the last two calls lie between a measurement and its command. What was not prepared is
 * prepared when it is needed: later, but the same.
 *
 * Worst case: whatever z holds (NaN, infinities, huge values), every call returns, in bounded time,
 * the estimate is finite, and lower <= omega <= upper. The RHC solves its QP by guesses of
 * the active bounds, one to three as a rule and RHEC_MOST_GUESSES at most. After that, or where
 * numbers leave their range, the answer is the previous solution moved on by one sample, and the
 * return value says so. A return value of 0 does not make an estimate true: sensors that agree on a
 * wrong value are believed. Pointers must be valid, settings as rhec.Scenario allows them.
 */
#ifndef RHEC_H
#define RHEC_H

#include "rhec_memory.h" /* generated: struct rhec, struct rhec_settings, RHEC_DT_S */

#ifdef __cplusplus
extern "C" {
#endif

/* What rhec_estimate and rhec_control return: a sum of these, or 0. */
enum {
    /* the measurement gave no plausible estimate: it is a prediction */
    RHEC_PREDICTED = 1,
    /* there is no new plan: the command is the one planned for now a sample ago */
    RHEC_AS_PLANNED = 2,
    /* the RHE was lost, or predicted for a whole window: it restarted at the measurement and the
     * last yaw */
    RHEC_ESTIMATOR_RESTARTED = 4,
    /* the plan or the place on the path was not plausible: the RHC restarted at the estimate */
    RHEC_CONTROLLER_RESTARTED = 8
};

/* The scenario of this export: its settings, which may be copied and changed, and where its robot
 * starts. */
extern const struct rhec_settings rhec_scenario;
extern const double rhec_scenario_guess[6];

/* Start. The settings are read, not copied: they must stay. guess: (x, y, theta, nu, mu, kappa); an
 * entry that is not plausible is replaced by 0, or by traction 1. */
void rhec_init(struct rhec *r, const struct rhec_settings *settings, const double guess[6]);

/* Preparation phase of the RHE: the rest of the last solution, arrival cost, shift, integration,
 * linearisation, condensing. */
void rhec_prepare_estimate(struct rhec *r);

/* Feedback phase of the RHE. z: measured (x, y, nu, omega), nu and omega as means since the last
 * sample; NaN where a sensor has nothing new. estimate: (x, y, theta, nu, mu, kappa). */
int rhec_estimate(struct rhec *r, const double z[4], double estimate[6]);

/* Preparation phase of the RHC: the rest of the last plan, shift, integration, linearisation. */
void rhec_prepare_control(struct rhec *r);

/* References on the path and feedback phase of the RHC, from the last estimate. omega: the yaw rate
 * to command. */
int rhec_control(struct rhec *r, double *omega);

#ifdef __cplusplus
}
#endif
#endif
