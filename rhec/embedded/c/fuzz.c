/* SPDX-License-Identifier: MIT */
/* Fuzzing: fuzz [steps [seed]]
 *
 * Measurements are NaN, infinite, denormal, huge or ordinary, for a sample or for storms of many
 * samples. Some storms overwrite parts of struct rhec. After every step the estimate must be finite
 * and the command within its bounds; otherwise the program reports this and returns 1. After each
 * storm the robot drives normally for 20 s. The program reports after how many storms the estimate
 * is still wrong by more than 0.5 m or the status is not 0, and how often each status occurred. */
#include <float.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "rhec.h"

static uint64_t state;

/* A random number of 64 bits, by splitmix64. */
static uint64_t bits(void)
{
    uint64_t b = state += UINT64_C(0x9E3779B97F4A7C15);
    b = (b ^ (b >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    b = (b ^ (b >> 27)) * UINT64_C(0x94D049BB133111EB);
    return b ^ (b >> 31);
}

/* Uniform between 0 and 1. */
static double uniform(void)
{
    return (double)(bits() >> 11) / 9007199254740992.0;
}

/* An invalid sensor value. */
static double invalid(void)
{
    static const double odd[] = {0,       -0.0,   NAN,     INFINITY, -INFINITY, DBL_MAX,
                                 -DBL_MAX, DBL_MIN, 4e-324, -4e-324,  1e8,       -1e8,
                                 100,     -100,   1e12,    1e300};
    uint64_t b = bits();
    double sign = uniform() < 0.5 ? -1 : 1, number;
    switch (bits() % 4) {
    case 0:
        return odd[b % (sizeof odd / sizeof *odd)];
    case 1:
        memcpy(&number, &b, sizeof number); /* random bits as a double */
        return number;
    case 2:
        return sign * pow(10, 600 * uniform() - 300);
    default:
        return sign * 100 * uniform();
    }
}

/* Simulates the robot for one sample with the system model of the paper, mu = 0.9, kappa = 0.8. */
static void drive(double pose[3], double speed, double omega)
{
    for (int i = 0; i < 10; i++) {
        pose[0] += RHEC_DT_S / 10 * 0.9 * speed * cos(pose[2]);
        pose[1] += RHEC_DT_S / 10 * 0.9 * speed * sin(pose[2]);
        pose[2] += RHEC_DT_S / 10 * 0.8 * omega;
    }
}

/* One sample. Each entry of z is invalid with this probability. Returns the status; exits if an
 * result is not finite or out of bounds. */
static int sample(struct rhec *r, double pose[3], double probability, double error[1])
{
    double speed = rhec_scenario_guess[3];
    double omega = 0, estimate[6] = {0}, z[RHEC_OUTPUTS];
    const double measured[4] = {pose[0], pose[1], speed, r->omega[0]};
    for (int i = 0; i < RHEC_OUTPUTS; i++) {
        double value = i < 4 ? measured[i] : NAN; /* the sensors are silent, or invalid */
        value += i < 2 ? 0.06 * (uniform() - 0.5) : 0;
        z[i] = uniform() < probability ? invalid() : value;
    }
    if (bits() % 2) {
        rhec_prepare_estimate(r);
    }
    int status = rhec_estimate(r, z, estimate);
    if (bits() % 2) {
        rhec_prepare_control(r);
    }
    status |= rhec_control(r, &omega);
    for (int i = 0; i < 6; i++) {
        if (!isfinite(estimate[i])) {
            fprintf(stderr, "estimate %d was %g\n", i, estimate[i]);
            exit(1);
        }
    }
    if (!(rhec_scenario.lower[0] <= omega && omega <= rhec_scenario.upper[0])) {
        fprintf(stderr, "omega was %g\n", omega);
        exit(1);
    }
    drive(pose, speed, omega);
    error[0] = hypot(estimate[0] - pose[0], estimate[1] - pose[1]);
    return status;
}

int main(int argc, char **argv)
{
    static struct rhec r;
    long steps = argc > 1 ? atol(argv[1]) : 1000000, done = 0;
    long by_status[16] = {0}, storms = 0, lost = 0, unnoticed = 0;
    state = argc > 2 ? strtoull(argv[2], NULL, 10) : 0;
    while (done < steps) {
        double guess[6];
        double pose[3], error[1];
        for (int i = 0; i < 3; i++) {
            pose[i] = rhec_scenario_guess[i];
        }
        for (int i = 0; i < 6; i++) {
            guess[i] = bits() % 16 ? rhec_scenario_guess[i] : invalid();
        }
        rhec_init(&r, &rhec_scenario, guess);
        for (int storm = 0; storm < 10; storm++, storms++) {
            double probability = uniform();
            int length = 1 + (int)(bits() % 60), calm = 100, status = 0;
            if (bits() % 8 == 0) { /* overwrite memory */
                double *memory[] = {(double *)&r.estimator, (double *)&r.controller,
                                    (double *)&r.path};
                size_t sizes[] = {sizeof r.estimator, sizeof r.controller, sizeof r.path};
                for (int i = 0; i < 5; i++) {
                    size_t which = bits() % 3, place = bits() % (sizes[which] / sizeof(double));
                    memory[which][place] = invalid();
                }
            }
            for (int i = 0; i < length + calm; i++, done++) {
                status = sample(&r, pose, i < length ? probability : 0, error);
                by_status[status]++;
            }
            lost += status != 0 || error[0] > 0.5;
            unnoticed += status == 0 && error[0] > 0.5;
        }
    }
    printf("%ld samples, %ld storms, after %ld of them still lost, %ld with status 0, 20 s later\n",
           done, storms, lost, unnoticed);
    printf("status,samples\n");
    for (int status = 0; status < 16; status++) {
        if (by_status[status]) {
            printf("%d,%ld\n", status, by_status[status]);
        }
    }
    return 0;
}
