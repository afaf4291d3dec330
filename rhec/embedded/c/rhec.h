/* SPDX-License-Identifier: MIT */
/* Receding horizon estimation (RHE, nonlinear moving horizon estimation) and receding horizon
 * control (RHC, nonlinear model predictive control) of a robot, with one Gauss-Newton iteration per
 * sample.
 *
 * C99 that needs only libm: no heap, no input or output, no static variables. All memory is in
 * `struct rhec`, which the caller provides, one for each robot. Threads may use different structs
 * at the same time.
 *
 * rhec_memory.h defines the components of this export. RHEC_PATH is defined in the export of a
 * scenario, in which a tracked robot follows a path. The export of a model has its estimator
 * (RHEC_ESTIMATOR), its controller (RHEC_CONTROLLER), or both.
 *
 * Call rhec_init once. Then call, every RHEC_DT_S seconds:
 *
 *     rhec_prepare_estimate(&r);       any time since the last sample
 *     rhec_prepare_control(&r);        any time since the last sample
 *     ... the measurement z arrives ...
 *     rhec_estimate(&r, z, estimate);
 *     rhec_control(&r, &omega);        for a model: rhec_control(&r, x, p, x_ref, u_ref, u);
 *     ... apply the command ...
 *
 * Only the last two calls are between a measurement and its command. They call the preparation if
 * the caller did not; the results are the same, but later.
 *
 * Guarantees: for any z (NaN, infinities, huge values), every call returns in bounded time,
 * estimates are finite and commands are within their bounds. If the QP of the RHC is not solved, or
 * if numbers leave their range, the result is the last solution shifted by one sample, and the
 * return value reports this. A return value of 0 does not guarantee a correct estimate: wrong
 * measurements that agree are not detected. Pointers must be valid, and settings within the ranges
 * of Python.
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

/* Status of rhec_estimate and rhec_control: 0 or a sum of these. */
enum {
    /* The estimate is a prediction, because the measurement gave no plausible estimate. */
    RHEC_PREDICTED = 1,
    /* The command comes from the last plan, because there is no valid new plan; or, for a model,
     * an entry of u_ref was not finite. */
    RHEC_AS_PLANNED = 2,
    /* The RHE restarted, because the estimate was implausible or, in a scenario, predicted for a
     * whole window. It restarts at the measurement and the last yaw; for a model, at the guess. */
    RHEC_ESTIMATOR_RESTARTED = 4,
    /* The RHC restarted at the estimate, because the plan or the arc length was implausible. */
    RHEC_CONTROLLER_RESTARTED = 8
};

/* The settings and the guess of this export. A copy of the settings may be changed. */
extern const struct rhec_settings rhec_scenario;
extern const double rhec_scenario_guess[RHEC_GUESS];
#ifdef RHEC_COVARIANCE
/* Of each entry of the estimate its row of the covariance, -1 without one. */
extern const int rhec_variances[RHEC_ESTIMATE];
#endif

/* Initialisation. The settings are not copied and must stay valid. guess: (x, y, theta, nu, mu,
 * kappa) for a scenario, the joint state for a model. Implausible entries are replaced: for a
 * scenario by 0, or 1 for the traction; for a model by those of rhec_scenario_guess. */
void rhec_init(struct rhec *r, const struct rhec_settings *settings,
               const double guess[RHEC_GUESS]);

#ifdef RHEC_ESTIMATOR
/* Preparation phase of the RHE: completes the last solution, then arrival cost, shift, integration,
 * linearisation and condensing. */
void rhec_prepare_estimate(struct rhec *r);

/* Feedback phase of the RHE. z: measured outputs, for a scenario (x, y, nu, omega) and then those of
 * its sensors: gyro_radps, the yaw rate over ground as a mean since the last sample,
 * counter-clockwise; heading_rad, the direction from the x axis, counter-clockwise, up to full
 * turns. rhec_memory.h names the entries (RHEC_OUTPUTS). Measured inputs are means since the last
 * sample; NaN marks missing measurements. estimate: (x, y, theta, nu, mu,
 * kappa) for a scenario; states, inputs of the last interval and parameters for a model. */
int rhec_estimate(struct rhec *r, const double z[RHEC_OUTPUTS], double estimate[RHEC_ESTIMATE]);

#ifdef RHEC_COVARIANCE
/* Standard deviations of the last estimate, NaN where it has none, as that of a measured speed. They
 * are multiplied by RHEC_INFLATION: 1, or for the estimator of a log the factor by which hidden
 * positions showed that its own are too small. */
void rhec_sigma(const struct rhec *r, double sigma[RHEC_ESTIMATE]);
#endif

#ifdef RHEC_HEADINGS
/* Of the estimator of a log (search.h). rhec_move moves late measurements to the sample, by the
 * motion from the last estimate, into rhec_moved, which rhec_estimate takes; it returns the square
 * of the innovation of the position [m^2]. held: the newest number of each measurement. */
double rhec_move(struct rhec *r, const double z[RHEC_OUTPUTS], const double held[RHEC_OUTPUTS],
                 const double ages_s[RHEC_OUTPUTS]);
const double *rhec_moved(const struct rhec *r);
#endif
#endif

#ifdef RHEC_CONTROLLER
/* Preparation phase of the RHC: completes the last plan, then shift, integration, linearisation. */
void rhec_prepare_control(struct rhec *r);

#ifdef RHEC_PATH
/* References on the path and feedback phase of the RHC for the last estimate. omega: the commanded
 * yaw rate. The QP is solved by guesses of the active bounds: usually one to three, at most
 * RHEC_MOST_GUESSES. */
int rhec_control(struct rhec *r, double *omega);
#else
/* Feedback phase of the RHC. x, p: estimate. x_ref: desired states of the nodes 0 to N; node 0
 * has no weight. u_ref: desired inputs of the N intervals; where an entry is not finite, the command
 * comes from the last plan. u: the inputs to apply; those that are not commanded are those of u_ref
 * or, where it is not finite, of the last plan, at first 0. The first call, and the first after a
 * restart, iterates up to RHEC_FIRST_ITERATIONS times; it takes longer. */
int rhec_control(struct rhec *r, const double x[], const double p[], const double x_ref[],
                 const double u_ref[], double u[RHEC_INPUTS]);
#endif
#endif

#ifdef __cplusplus
}
#endif
#endif
