/* Receding horizon estimation (RHE, nonlinear moving horizon estimation) and receding horizon
 * control (RHC, nonlinear model predictive control) of a robot, with one Gauss-Newton iteration per
 * sample.
 *
 * C99 without any library but libm: no heap, no input or output, no static variables. All memory is
 * in `struct rhec`, which the caller provides. Two robots need two of them, and different threads
 * may use different ones.
 *
 * rhec_memory.h says what this export has. RHEC_PATH is defined in the export of a scenario: a
 * tracked robot that follows a path. Otherwise the export was made from a model, and has its
 * estimator (RHEC_ESTIMATOR), its controller (RHEC_CONTROLLER), or both.
 *
 * Call rhec_init once. Then call, every RHEC_DT_S seconds:
 *
 *     rhec_prepare_estimate(&r);       any time since the last sample
 *     rhec_prepare_control(&r);        any time since the last sample
 *     ... the measurement z arrives ...
 *     rhec_estimate(&r, z, estimate);
 *     rhec_control(&r, &omega);        of a model: rhec_control(&r, x, p, x_ref, u_ref, u);
 *     ... apply the command ...
 *
 * Only the last two calls lie between a measurement and its command. They do the preparation
 * themselves if it was not called; the results are the same, but later.
 *
 * Worst case: whatever z holds (NaN, infinities, huge values), every call returns in bounded time,
 * estimates are finite and commands are within their bounds. Where the QP of the RHC is not solved,
 * or numbers leave their range, the answer is the last solution moved on by one sample, and the
 * return value says so. A return value of 0 does not make an estimate true: sensors that agree on a
 * wrong value are believed. Pointers must be valid, and settings as Python allows them.
 *
 * Units of a scenario: m, s, rad. x, y, theta: position and yaw in the plane, yaw counter-clockwise
 * and unwrapped. nu, omega: speed and yaw rate of the tracks; over ground they are mu * nu and
 * kappa * omega. For a model, rhec_memory.h names its states x, inputs u, parameters p and outputs
 * z, in their order. Matrices are stored column by column.
 */
#ifndef RHEC_H
#define RHEC_H

#include "rhec_memory.h" /* generated: struct rhec, struct rhec_settings, sizes */

#ifdef __cplusplus
extern "C" {
#endif

/* What rhec_estimate and rhec_control return: a sum of these, or 0. */
enum {
    /* The measurement gave no plausible estimate: the estimate is a prediction. */
    RHEC_PREDICTED = 1,
    /* There is no new plan: the command is the one that the last plan has for now. */
    RHEC_AS_PLANNED = 2,
    /* The estimate was not plausible, or of a scenario was predicted for a whole window. The RHE
     * restarted: of a scenario at the measurement and the last yaw, of a model at the guess. */
    RHEC_ESTIMATOR_RESTARTED = 4,
    /* The plan or the place on the path was not plausible: the RHC restarted at the estimate. */
    RHEC_CONTROLLER_RESTARTED = 8
};

/* The settings of this export, which may be copied and changed, and its guess. */
extern const struct rhec_settings rhec_scenario;
extern const double rhec_scenario_guess[RHEC_GUESS];

/* Start. The settings are read, not copied: they must stay. guess: of a scenario (x, y, theta, nu,
 * mu, kappa); of a model its joint state. An entry that is not plausible is replaced: of a scenario
 * by 0, or by traction 1; of a model by that of rhec_scenario_guess. */
void rhec_init(struct rhec *r, const struct rhec_settings *settings,
               const double guess[RHEC_GUESS]);

#ifdef RHEC_ESTIMATOR
/* Preparation phase of the RHE: the rest of the last solution, arrival cost, shift, integration,
 * linearisation, condensing. */
void rhec_prepare_estimate(struct rhec *r);

/* Feedback phase of the RHE. z: measured outputs, of a scenario (x, y, nu, omega); measured inputs
 * are means since the last sample; NaN where a sensor has nothing new. estimate: of a scenario (x,
 * y, theta, nu, mu, kappa); of a model its states, inputs of the last interval and parameters. */
int rhec_estimate(struct rhec *r, const double z[RHEC_OUTPUTS], double estimate[RHEC_ESTIMATE]);
#endif

#ifdef RHEC_CONTROLLER
/* Preparation phase of the RHC: the rest of the last plan, shift, integration, linearisation. */
void rhec_prepare_control(struct rhec *r);

#ifdef RHEC_PATH
/* References on the path and feedback phase of the RHC, from the last estimate. omega: the yaw rate
 * to command. The QP is solved by guesses of the active bounds: one to three as a rule, and
 * RHEC_MOST_GUESSES at most. */
int rhec_control(struct rhec *r, double *omega);
#else
/* Feedback phase of the RHC. x, p: estimate. x_ref: desired states of the nodes 0 to N, of which
 * node 0 has no weight. u_ref: desired inputs of the N intervals. u: the inputs to command now. */
int rhec_control(struct rhec *r, const double x[], const double p[], const double x_ref[],
                 const double u_ref[], double u[RHEC_INPUTS]);
#endif
#endif

#ifdef __cplusplus
}
#endif
#endif
