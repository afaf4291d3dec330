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

/* x, y, theta, nu, mu, kappa that a robot may have. Measurements beyond do not count either, and a
 * yaw of more turns has lost its digits. */
static int is_plausible(int i, double number)
{
    static const double most[6] = {1e8, 1e8, 1e6, 100, 10, 10};
    return fabs(number) <= most[i];
}

#include "rhec_phases.h" /* generated: each phase bound to the memory */

enum { TO_SHIFT, PREPARED, TO_EXPAND }; /* how far preparation has got */

/* Start the RHE at this guess as far as it is plausible, else at the other, and look for the
 * closest point on the whole path. */
static void restart(struct rhec *r, const double guess[6], const double other[6])
{
    static const double origin[6] = {0, 0, 0, 0, 1, 1};

    for (int i = 0; i < 6; i++) {
        r->estimate[i] = is_plausible(i, guess[i])   ? guess[i]
                         : is_plausible(i, other[i]) ? other[i]
                                                     : origin[i];
    }
    estimator_start(r);
    path_closest(r);
    r->estimator_stage = TO_SHIFT;
    r->predicted = 0;
}

void rhec_init(struct rhec *r, const struct rhec_settings *settings, const double guess[6])
{
    memset(r, 0, sizeof *r);
    r->settings = settings;
    restart(r, guess, guess);
    controller_start(r);
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
        restart(r, r->estimate, r->estimate);
        r->restarted |= RHEC_ESTIMATOR_RESTARTED;
    }
    estimator_shift(r);
    estimator_linearise(r);
    r->estimator_stage = PREPARED;
}

int rhec_estimate(struct rhec *r, const double z[4], double estimate[6])
{
    double last[6];
    int status, lost = 0;

    rhec_prepare_estimate(r);
    memcpy(last, r->estimate, sizeof last);
    memcpy(r->z, z, sizeof r->z);
    estimator_feedback(r);
    r->estimator_stage = TO_EXPAND;

    r->predicted = estimator_ok(r) ? 0 : r->predicted + 1;
    status = r->restarted & RHEC_ESTIMATOR_RESTARTED;
    status |= r->predicted ? RHEC_PREDICTED : 0;
    for (int i = 0; i < 6; i++) {
        lost |= !is_plausible(i, r->estimate[i]);
    }
    if (lost || r->predicted > RHEC_PATIENCE) {
        const double measured[6] = {z[0], z[1], last[2], z[2], 1, 1};
        restart(r, measured, last);
        status |= RHEC_ESTIMATOR_RESTARTED;
    }
    r->restarted &= ~RHEC_ESTIMATOR_RESTARTED;
    memcpy(estimate, r->estimate, sizeof r->estimate);
    return status;
}

void rhec_prepare_control(struct rhec *r)
{
    if (r->controller_stage == PREPARED) {
        return;
    }
    if (r->controller_stage == TO_EXPAND) {
        controller_expand(r);
    }
    if (!controller_is_plausible(r)) {
        controller_start(r);
        r->restarted |= RHEC_CONTROLLER_RESTARTED;
    }
    controller_shift(r);
    controller_linearise(r);
    r->controller_stage = PREPARED;
}

int rhec_control(struct rhec *r, double *omega)
{
    rhec_prepare_control(r);
    int status = r->restarted & RHEC_CONTROLLER_RESTARTED;
    r->restarted &= ~RHEC_CONTROLLER_RESTARTED;

    path_follow(r);
    if (!are_plausible(r->path.s_next, 1)) {
        path_closest(r);
        path_follow(r);
        status |= RHEC_CONTROLLER_RESTARTED;
    }
    r->path.s[0] = r->path.s_next[0];
    memcpy(r->controller.s_0, r->estimate, sizeof r->estimate);
    controller_feedback(r);
    r->controller_stage = TO_EXPAND;
    if (!controller_ok(r)) {
        status |= RHEC_AS_PLANNED;
    }
    r->omega[0] = r->controller.u_plan[0];
    *omega = r->omega[0];
    return status;
}
