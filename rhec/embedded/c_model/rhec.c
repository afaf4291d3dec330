/* Calls the generated phases in order, and restarts where numbers leave their range: see rhec.h. */
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

enum { FRESH, PREPARED, TO_EXPAND }; /* how far preparation has got */

#ifdef RHEC_ESTIMATOR
/* Start the RHE at the guess; an entry that is not plausible is that of the export. */
static void restart(struct rhec *r)
{
    for (int i = 0; i < RHEC_GUESS; i++) {
        if (!are_plausible(&r->guess[i], 1)) {
            r->guess[i] = rhec_scenario_guess[i];
        }
    }
    estimator_start(r);
    r->estimator_stage = FRESH;
}
#endif

void rhec_init(struct rhec *r, const struct rhec_settings *settings, const double guess[RHEC_GUESS])
{
    memset(r, 0, sizeof *r);
    r->settings = settings;
#ifdef RHEC_ESTIMATOR
    memcpy(r->guess, guess, sizeof r->guess);
    restart(r);
#else
    (void)guess;
#endif
}

#ifdef RHEC_ESTIMATOR
void rhec_prepare_estimate(struct rhec *r)
{
    if (r->estimator_stage == PREPARED) {
        return;
    }
    if (r->estimator_stage == TO_EXPAND) {
        estimator_expand(r);
    }
    if (!estimator_is_plausible(r)) {
        restart(r);
        r->restarted |= RHEC_ESTIMATOR_RESTARTED;
    }
    estimator_shift(r);
    estimator_linearise(r);
    r->estimator_stage = PREPARED;
}

int rhec_estimate(struct rhec *r, const double z[RHEC_OUTPUTS], double estimate[RHEC_ESTIMATE])
{
    int status = 0;

    for (int attempt = 0; attempt < 2; attempt++) {
        rhec_prepare_estimate(r);
        status |= r->restarted & RHEC_ESTIMATOR_RESTARTED;
        r->restarted &= ~RHEC_ESTIMATOR_RESTARTED;
        memcpy(r->z, z, sizeof r->z);
        estimator_feedback(r);
        r->estimator_stage = TO_EXPAND;
        if (are_plausible(r->estimate, RHEC_ESTIMATE)) {
            break;
        }
        restart(r);
        status |= RHEC_ESTIMATOR_RESTARTED;
    }
    if (!estimator_ok(r)) {
        status |= RHEC_PREDICTED;
    }
    memcpy(estimate, r->estimate, sizeof r->estimate);
    return status;
}
#endif

#ifdef RHEC_CONTROLLER
void rhec_prepare_control(struct rhec *r)
{
    if (r->controller_stage != TO_EXPAND) {
        return; /* the first plan begins at the first estimate */
    }
    controller_expand(r);
    if (!controller_is_plausible(r)) {
        r->controller_stage = FRESH;
        r->restarted |= RHEC_CONTROLLER_RESTARTED;
        return;
    }
    controller_shift(r);
    controller_linearise(r);
    r->controller_stage = PREPARED;
}

int rhec_control(struct rhec *r, const double x[], const double p[], const double x_ref[],
                 const double u_ref[], double u[RHEC_INPUTS])
{
    int status;

    rhec_prepare_control(r);
    status = r->restarted & RHEC_CONTROLLER_RESTARTED;
    r->restarted &= ~RHEC_CONTROLLER_RESTARTED;
    memcpy(r->controller.s_0, x, RHEC_STATES * sizeof *x);
    memcpy(r->controller.s_0 + RHEC_STATES, p, RHEC_PARAMETERS * sizeof *p);
    memcpy(r->controller.x_ref, x_ref, sizeof r->controller.x_ref);
    memcpy(r->controller.u_ref, u_ref, sizeof r->controller.u_ref);
    if (r->controller_stage == FRESH) {
        controller_start(r);
        r->controller.current = r->controller.previous;
        controller_linearise(r);
    }
    controller_feedback(r);
    r->controller_stage = TO_EXPAND;
    if (!controller_ok(r)) {
        status |= RHEC_AS_PLANNED;
    }
    memcpy(u, r->controller.u_plan, RHEC_INPUTS * sizeof *u);
    return status;
}
#endif
