/* Moving horizon estimation (RHE) and model predictive control (RHC) of a robot given by a model:
 * one Gauss-Newton iteration each a sample. An export has one of them, or both.
 *
 * C99, nothing but libm: no heap, no input or output, no variables of its own. All memory is in
 * `struct rhec`, which the caller provides: two robots are two of them, and different ones may be
 * used by different threads. rhec_memory.h names the model's states x, inputs u, parameters p and
 * outputs z, in their order. Matrices are stored column by column.
 *
 * Once, then every RHEC_DT_S seconds:
 *
 *     rhec_init(&r, &rhec_scenario, rhec_scenario_guess);
 *
 *     rhec_prepare_estimate(&r);       any time since the last sample
 *     rhec_prepare_control(&r);        any time since the last sample
 *     ... the measurement z arrives ...
 *     rhec_estimate(&r, z, estimate);
 *     rhec_control(&r, x, p, x_ref, u_ref, u);
 *     ... command u ...
 *
 * What was not prepared is prepared when it is needed: later, but the same. Every call returns, in
 * bounded time: estimates are finite, commands within their bounds.
 */
#ifndef RHEC_H
#define RHEC_H

#include "rhec_memory.h" /* generated: struct rhec, struct rhec_settings, RHEC_DT_S, the sizes */

#ifdef __cplusplus
extern "C" {
#endif

/* What rhec_estimate and rhec_control return: a sum of these, or 0. */
enum {
    /* the measurement gave no plausible estimate: it is a prediction */
    RHEC_PREDICTED = 1,
    /* there is no new plan: the command is the one planned for now a sample ago */
    RHEC_AS_PLANNED = 2,
    /* nothing plausible was left of the window: the RHE restarted at the guess */
    RHEC_ESTIMATOR_RESTARTED = 4,
    /* nothing plausible was left of the plan: the RHC restarted at the estimate */
    RHEC_CONTROLLER_RESTARTED = 8
};

/* The settings of this export, which may be copied and changed, and its guess. */
extern const struct rhec_settings rhec_scenario;
extern const double rhec_scenario_guess[RHEC_GUESS];

/* Start. The settings are read, not copied: they must stay. guess: of the joint state; an entry
 * that is not plausible is that of the export. */
void rhec_init(struct rhec *r, const struct rhec_settings *settings,
               const double guess[RHEC_GUESS]);

#ifdef RHEC_ESTIMATOR
/* Preparation phase of the RHE: the rest of the last solution, arrival cost, shift, integration,
 * linearisation, condensing. */
void rhec_prepare_estimate(struct rhec *r);

/* Feedback phase of the RHE. z: measured outputs, those of inputs as means since the last sample;
 * NaN where a sensor has nothing new. estimate: states, inputs of the last interval, parameters. */
int rhec_estimate(struct rhec *r, const double z[RHEC_OUTPUTS], double estimate[RHEC_ESTIMATE]);
#endif

#ifdef RHEC_CONTROLLER
/* Preparation phase of the RHC: the rest of the last plan, shift, integration, linearisation. */
void rhec_prepare_control(struct rhec *r);

/* Feedback phase of the RHC. x, p: estimate; x_ref: desired states of the nodes 0 to N, of which
 * node 0 has no weight; u_ref: desired inputs of the N intervals. u: the inputs to command now. */
int rhec_control(struct rhec *r, const double x[], const double p[], const double x_ref[],
                 const double u_ref[], double u[RHEC_INPUTS]);
#endif

#ifdef __cplusplus
}
#endif
#endif
