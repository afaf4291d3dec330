/* SPDX-License-Identifier: MIT */
/* The estimator that `rhec log` judged, for a robot that does not know its first yaw.
 *
 * RHEC_HEADINGS estimators start from directions all around. The answer is that of the one whose
 * positions were the least surprising until now: it may change while the robot drives its first
 * metres. A robot that knows its yaw needs none of this: it calls rhec_init with a guess, and
 * rhec_estimate.
 *
 * Call rhec_search_init once, and rhec_search_estimate every RHEC_DT_S seconds. */
#ifndef RHEC_SEARCH_H
#define RHEC_SEARCH_H

#include "rhec.h"

#ifdef __cplusplus
extern "C" {
#endif

struct rhec_search {
    struct rhec runs[RHEC_HEADINGS];
    double squares[RHEC_HEADINGS]; /* sums of the squared innovations of the positions [m^2] */
    double held[RHEC_OUTPUTS];     /* the newest number of each measurement */
    int is_started, best;
};

void rhec_search_init(struct rhec_search *s);

/* z: as of rhec_estimate. ages_s: how old each measurement is at the sample [s]; 0 for what is a
 * mean since the last sample. estimate and sigma: the estimate of the best direction, and its
 * standard deviations, as of rhec_sigma; NaN before the first position. Returns its status. */
int rhec_search_estimate(struct rhec_search *s, const double z[RHEC_OUTPUTS],
                         const double ages_s[RHEC_OUTPUTS], double estimate[RHEC_ESTIMATE],
                         double sigma[RHEC_ESTIMATE]);

#ifdef __cplusplus
}
#endif
#endif
