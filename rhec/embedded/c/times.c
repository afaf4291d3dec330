/* SPDX-License-Identifier: MIT */
/* Measures the time of each phase on this machine [ns] for every line of a log:
 * times log.csv > times.csv. Needs POSIX. */
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "rhec.h"

static double now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

int main(int argc, char **argv)
{
    static struct rhec r;
    static char line[4096];
    if (argc != 2) {
        fprintf(stderr, "usage: %s log.csv\n", argv[0]);
        return 2;
    }
    FILE *log = fopen(argv[1], "r");
    if (!log || !fgets(line, sizeof line, log)) {
        fprintf(stderr, "log was %s, which cannot be read or has no line\n", argv[1]);
        return 2;
    }
    rhec_init(&r, &rhec_scenario, rhec_scenario_guess);
    puts("rhe_preparation_ns,rhe_feedback_ns,rhc_preparation_ns,rhc_feedback_ns");
    while (fgets(line, sizeof line, log)) {
        double z[RHEC_OUTPUTS], estimate[6], omega;
        char *field = line;
        int count = 0;
        while (count < RHEC_OUTPUTS) {
            char *end;
            z[count] = strtod(field, &end);
            if (end == field) {
                break;
            }
            count++;
            field = *end == ',' ? end + 1 : end;
        }
        if (count < RHEC_OUTPUTS) {
            continue;
        }
        double begin = now_ns();
        rhec_prepare_estimate(&r);
        double prepared = now_ns();
        rhec_estimate(&r, z, estimate);
        double estimated = now_ns();
        rhec_prepare_control(&r);
        double planned = now_ns();
        rhec_control(&r, &omega);
        double end = now_ns();
        printf("%.0f,%.0f,%.0f,%.0f\n", prepared - begin, estimated - prepared,
               planned - estimated, end - planned);
    }
    fclose(log);
    return 0;
}
