/* SPDX-License-Identifier: MIT */
/* Calls the generated phases in order, and restarts if numbers leave their range; see rhec.h.
 *
 * rhec_memory.h defines the components of this export: RHEC_ESTIMATOR, RHEC_CONTROLLER, and
 * RHEC_PATH for a tracked robot that follows a path. Without RHEC_PATH, a model was exported. */
#include "rhec.h"

#include <math.h>
#include <string.h>

static int are_plausible(const double *numbers, int count)
{
    for (int i = 0; i < count; i++) {
        if (!(fabs(numbers[i]) <= RHEC_MAX_PLAUSIBLE)) { /* false for NaN too */
            return 0;
        }
    }
    return 1;
}

#include "rhec_phases.h" /* generated: each phase bound to the memory */

/* The next step of the preparation. NO_PLAN: the first plan starts at the first estimate. */
enum { TO_SHIFT, PREPARED, TO_EXPAND, NO_PLAN };

/* Returns whether a component has restarted since the last call, and clears the flag. */
static int take_restart(struct rhec *r, int component)
{
    int restarted = r->restarted & component;
    r->restarted &= ~component;
    return restarted;
}

#ifdef RHEC_ESTIMATOR

#ifdef RHEC_PATH
/* Largest plausible x, y, theta, nu, mu, kappa. Above 1e6 rad, a yaw has lost too many digits. */
static const double largest[RHEC_GUESS] = {1e8, 1e8, 1e6, 100, 10, 10};
static const double fallback[RHEC_GUESS] = {0, 0, 0, 0, 1, 1};
#else
#define fallback rhec_scenario_guess
#endif

static int is_plausible(int i, double number)
{
#ifdef RHEC_PATH
    return fabs(number) <= largest[i];
#else
    (void)i;
    return are_plausible(&number, 1);
#endif
}

/* The starting point of the RHE. On a path it is also the first estimate of the controller. */
static double *start_of(struct rhec *r)
{
#ifdef RHEC_PATH
    return r->estimate;
#else
    return r->guess;
#endif
}

/* Starts the RHE. Each entry comes from the guess if that is plausible, else from the other guess
 * if that is plausible, else from the fallback. On a path, the closest point is searched again. */
static void restart(struct rhec *r, const double guess[], const double other[])
{
    double *start = start_of(r);

    for (int i = 0; i < RHEC_GUESS; i++) {
        start[i] = is_plausible(i, guess[i])   ? guess[i]
                   : is_plausible(i, other[i]) ? other[i]
                                               : fallback[i];
    }
    estimator_start(r);
#ifdef RHEC_HEADINGS
    estimator_first(r);
#endif
#ifdef RHEC_YAW_DRIFT
    r->estimator.yaw_drift[0] = 0;
#endif
#if defined RHEC_PATH && defined RHEC_CONTROLLER
    path_closest(r);
#endif
    r->estimator_stage = TO_SHIFT;
    r->predicted = 0;
}

void rhec_prepare_estimate(struct rhec *r)
{
    if (r->estimator_stage == PREPARED) {
        return;
    }
    if (r->estimator_stage == TO_EXPAND) {
        estimator_expand(r);
    }
    if (!estimator_is_plausible(r)) {
        restart(r, start_of(r), start_of(r));
        r->restarted |= RHEC_ESTIMATOR_RESTARTED;
    }
    estimator_shift(r);
    estimator_linearise(r);
    r->estimator_stage = PREPARED;
}

/* The feedback phase. Returns whether the preparation before it restarted the RHE. */
static int estimator_step(struct rhec *r, const double z[RHEC_OUTPUTS])
{
    rhec_prepare_estimate(r);
    int status = take_restart(r, RHEC_ESTIMATOR_RESTARTED);
    memcpy(r->z, z, sizeof r->z);
    estimator_feedback(r);
    r->estimator_stage = TO_EXPAND;
    return status;
}

#ifdef RHEC_PATH
/* Whether the estimate is implausible or has been predicted for longer than the window. */
static int is_lost(const struct rhec *r)
{
    for (int i = 0; i < RHEC_ESTIMATE; i++) {
        if (!is_plausible(i, r->estimate[i])) {
            return 1;
        }
    }
    return r->predicted > RHEC_PATIENCE;
}

int rhec_estimate(struct rhec *r, const double z[RHEC_OUTPUTS], double estimate[RHEC_ESTIMATE])
{
    double last[RHEC_ESTIMATE];

    rhec_prepare_estimate(r); /* a restart changes the last estimate */
    memcpy(last, r->estimate, sizeof last);
    int status = estimator_step(r, z);
    r->predicted = estimator_ok(r) ? 0 : r->predicted + 1;
    status |= r->predicted ? RHEC_PREDICTED : 0;
    if (is_lost(r)) {
        const double measured[RHEC_GUESS] = {z[0], z[1], last[2], z[2], 1, 1};
        restart(r, measured, last);
        status |= RHEC_ESTIMATOR_RESTARTED;
    }
    memcpy(estimate, r->estimate, sizeof r->estimate);
    return status;
}
#else
int rhec_estimate(struct rhec *r, const double z[RHEC_OUTPUTS], double estimate[RHEC_ESTIMATE])
{
    int status = 0;

    /* If the estimate is implausible, the second attempt starts with a new window. */
    for (int attempt = 0; attempt < 2; attempt++) {
        status |= estimator_step(r, z);
        if (are_plausible(r->estimate, RHEC_ESTIMATE)) {
            break;
        }
        restart(r, r->guess, r->guess);
        status |= RHEC_ESTIMATOR_RESTARTED;
    }
    status |= estimator_ok(r) ? 0 : RHEC_PREDICTED;
    memcpy(estimate, r->estimate, sizeof r->estimate);
    return status;
}
#endif

#ifdef RHEC_COVARIANCE
void rhec_sigma(const struct rhec *r, double sigma[RHEC_ESTIMATE])
{
    for (int i = 0; i < RHEC_ESTIMATE; i++) {
        int k = rhec_variances[i];

        sigma[i] = NAN;
        if (k >= 0) {
            sigma[i] = RHEC_INFLATION * sqrt(r->estimator.covariance[k * (RHEC_COVARIANCE + 1)]);
        }
    }
}
#endif

#ifdef RHEC_HEADINGS
double rhec_move(struct rhec *r, const double z[RHEC_OUTPUTS], const double held[RHEC_OUTPUTS],
                 const double ages_s[RHEC_OUTPUTS])
{
    rhec_prepare_estimate(r); /* a restart changes the last estimate */
    memcpy(r->estimator.measured, z, sizeof r->estimator.measured);
    memcpy(r->estimator.held, held, sizeof r->estimator.held);
    memcpy(r->estimator.ages, ages_s, sizeof r->estimator.ages);
    estimator_move(r);
    return r->estimator.square[0];
}

const double *rhec_moved(const struct rhec *r)
{
    return r->estimator.moved;
}
#endif

#endif /* RHEC_ESTIMATOR */

void rhec_init(struct rhec *r, const struct rhec_settings *settings, const double guess[RHEC_GUESS])
{
    memset(r, 0, sizeof *r);
    r->settings = settings;
    r->controller_stage = NO_PLAN;
#ifdef RHEC_ESTIMATOR
    restart(r, guess, guess);
#else
    (void)guess;
#endif
#if defined RHEC_PATH && defined RHEC_CONTROLLER
    controller_start(r);
    r->controller_stage = TO_SHIFT;
#endif
}

#ifdef RHEC_CONTROLLER

void rhec_prepare_control(struct rhec *r)
{
    if (r->controller_stage == PREPARED || r->controller_stage == NO_PLAN) {
        return;
    }
    if (r->controller_stage == TO_EXPAND) {
        controller_expand(r);
    }
    if (!controller_is_plausible(r)) {
        r->restarted |= RHEC_CONTROLLER_RESTARTED;
#ifdef RHEC_PATH
        controller_start(r);
#else
        r->controller_stage = NO_PLAN;
        return;
#endif
    }
    controller_shift(r);
    controller_linearise(r);
    r->controller_stage = PREPARED;
}

/* The feedback phase. Returns whether the command comes from the last plan. */
static int controller_step(struct rhec *r)
{
    controller_feedback(r);
    r->controller_stage = TO_EXPAND;
    return controller_ok(r) ? 0 : RHEC_AS_PLANNED;
}

#ifdef RHEC_PATH
int rhec_control(struct rhec *r, double *omega)
{
    rhec_prepare_control(r);
    int status = take_restart(r, RHEC_CONTROLLER_RESTARTED);

    path_follow(r);
    if (!are_plausible(r->path.s_next_m, 1)) {
        path_closest(r);
        path_follow(r);
        status |= RHEC_CONTROLLER_RESTARTED;
    }
    r->path.s_m[0] = r->path.s_next_m[0];
    memcpy(r->controller.s_0, r->estimate, sizeof r->estimate);
    status |= controller_step(r);
    r->omega[0] = r->controller.u_plan[0];
#ifdef RHEC_YAW_DRIFT
    r->omega[0] -= r->path.disturbance[0]; /* the plan is of both */
#endif
    *omega = r->omega[0];
    return status;
}
#else
#ifdef RHEC_FIRST_ITERATIONS /* of a controller without bounds on states or outputs */
/* Iterates for the data of the first sample, because there is no plan to improve. */
static void improve_first_plan(struct rhec *r)
{
    memset(r->controller.penalty, 0, sizeof r->controller.penalty);
    for (int i = 0; i < RHEC_FIRST_ITERATIONS; i++) {
        controller_improve(r);
        r->controller.current = r->controller.previous;
        memcpy(r->controller.penalty, r->controller.penalty_after, sizeof r->controller.penalty);
        if (r->controller.done[0] == 1) {
            return;
        }
    }
}
#endif

int rhec_control(struct rhec *r, const double x[], const double p[], const double x_ref[],
                 const double u_ref[], double u[RHEC_INPUTS])
{
    rhec_prepare_control(r);
    int status = take_restart(r, RHEC_CONTROLLER_RESTARTED);

    memcpy(r->controller.s_0, x, RHEC_STATES * sizeof *x);
    memcpy(r->controller.s_0 + RHEC_STATES, p, RHEC_PARAMETERS * sizeof *p);
    memcpy(r->controller.x_ref, x_ref, sizeof r->controller.x_ref);
    memcpy(r->controller.u_ref, u_ref, sizeof r->controller.u_ref);
    if (r->controller_stage == NO_PLAN) {
        controller_start(r);
        r->controller.current = r->controller.previous;
#ifdef RHEC_FIRST_ITERATIONS
        improve_first_plan(r);
#endif
        controller_linearise(r);
    }
    status |= controller_step(r);
    memcpy(u, r->controller.u_plan, RHEC_INPUTS * sizeof *u);
    return status;
}
#endif

#endif /* RHEC_CONTROLLER */
