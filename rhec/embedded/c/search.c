/* SPDX-License-Identifier: MIT */
#include "search.h"

#include <math.h>
#include <string.h>

static const double full_turn = 6.283185307179586;
static const double clearly = 1e-6; /* share by which a worse direction is more surprising */

void rhec_search_init(struct rhec_search *s)
{
    memset(s, 0, sizeof *s);
    for (int i = 0; i < RHEC_OUTPUTS; i++) {
        s->held[i] = NAN;
    }
}

/* Starts at the first position, in all directions. */
static void start(struct rhec_search *s, const double z[RHEC_OUTPUTS])
{
    double guess[RHEC_GUESS];

    memcpy(guess, rhec_scenario_guess, sizeof guess);
    guess[0] = z[0];
    guess[1] = z[1];
    for (int k = 0; k < RHEC_HEADINGS; k++) {
        guess[RHEC_GUESS_YAW] = full_turn / RHEC_HEADINGS * k;
        rhec_init(&s->runs[k], &rhec_scenario, guess);
    }
    s->is_started = 1;
}

int rhec_search_estimate(struct rhec_search *s, const double z[RHEC_OUTPUTS],
                         const double ages_s[RHEC_OUTPUTS], double estimate[RHEC_ESTIMATE],
                         double sigma[RHEC_ESTIMATE])
{
    int status[RHEC_HEADINGS];
    double least;

    if (!s->is_started && !(isfinite(z[0]) && isfinite(z[1]))) {
        for (int i = 0; i < RHEC_ESTIMATE; i++) {
            estimate[i] = sigma[i] = NAN;
        }
        return RHEC_PREDICTED;
    }
    if (!s->is_started) {
        start(s, z);
    }
    for (int i = 0; i < RHEC_OUTPUTS; i++) {
        s->held[i] = isfinite(z[i]) ? z[i] : s->held[i];
    }
    for (int k = 0; k < RHEC_HEADINGS; k++) {
        s->squares[k] += rhec_move(&s->runs[k], z, s->held, ages_s);
        status[k] = rhec_estimate(&s->runs[k], rhec_moved(&s->runs[k]), estimate);
    }
    least = s->squares[0];
    for (int k = 1; k < RHEC_HEADINGS; k++) {
        least = s->squares[k] < least ? s->squares[k] : least;
    }
    /* While a robot stands, all directions are as good, and rounding would decide. */
    if (s->squares[s->best] > (1 + clearly) * least) {
        for (s->best = 0; s->squares[s->best] > (1 + clearly) * least;) {
            s->best++;
        }
    }
    memcpy(estimate, s->runs[s->best].estimate, RHEC_ESTIMATE * sizeof *estimate);
    rhec_sigma(&s->runs[s->best], sigma);
    return status[s->best];
}
