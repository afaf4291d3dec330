/* SPDX-License-Identifier: MIT */
/* Replays a log: replay log.csv > results.csv
 *
 * The first line of the log has the column names. Each further line has a measurement: x, y, nu,
 * omega and the sensors of the export, as rhec_memory.h names them (RHEC_OUTPUTS). An empty field
 * or nan marks a missing measurement. If lines also have Python's results (x, y, theta, nu, mu,
 * kappa and the command, if there is one), the program reports the largest difference and fails if it exceeds
 * 1e-9. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "rhec.h"

#ifdef RHEC_CONTROLLER
enum { MEASURED = RHEC_OUTPUTS, COMPUTED = RHEC_ESTIMATE + 1 };
#else
enum { MEASURED = RHEC_OUTPUTS, COMPUTED = RHEC_ESTIMATE };
#endif

/* Reads the numbers of a line, NaN for empty fields. Returns the number of fields. */
static int parse(char *line, double *numbers, int most)
{
    int count = 0;
    for (char *field = line; field && count < most; count++) {
        char *end, *next = strchr(field, ',');
        double number = strtod(field, &end);
        numbers[count] = end > field ? number : NAN;
        field = next ? next + 1 : NULL;
    }
    return count;
}

int main(int argc, char **argv)
{
    static struct rhec r; /* too large for small stacks */
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
    double largest = 0;
    int compared = 0;
    rhec_init(&r, &rhec_scenario, rhec_scenario_guess);
#ifdef RHEC_CONTROLLER
    puts("x_hat_m,y_hat_m,theta_hat_rad,nu_hat_mps,mu_hat,kappa_hat,omega_cmd_radps,status");
#else
    puts("x_hat_m,y_hat_m,theta_hat_rad,nu_hat_mps,mu_hat,kappa_hat,status");
#endif
    while (fgets(line, sizeof line, log)) {
        double numbers[MEASURED + COMPUTED], result[COMPUTED];
        int count = parse(line, numbers, MEASURED + COMPUTED);
        for (int i = count; i < MEASURED; i++) {
            numbers[i] = NAN;
        }
        rhec_prepare_estimate(&r);
        int status = rhec_estimate(&r, numbers, result);
#ifdef RHEC_CONTROLLER
        status |= rhec_control(&r, &result[RHEC_ESTIMATE]);
#endif
        for (int i = 0; i < COMPUTED; i++) {
            printf("%.17g,", result[i]);
        }
        printf("%d\n", status);
        if (count == MEASURED + COMPUTED) {
            compared++;
            for (int i = 0; i < COMPUTED; i++) {
                double difference = fabs(result[i] - numbers[MEASURED + i]);
                largest = difference <= largest ? largest : difference; /* NaN counts */
            }
        }
    }
    fclose(log);
    if (compared) {
        fprintf(stderr, "largest difference in %d samples: %.3g\n", compared, largest);
    }
    return !(largest <= 1e-9);
}
