/* SPDX-License-Identifier: MIT */
/* Replays a log: replay log.csv > results.csv
 *
 * The first line of the log has the column names. Each further line has a measurement: x, y, nu,
 * omega and the sensors of the export, as rhec_memory.h names them (RHEC_OUTPUTS), and in the
 * export of a log the ages of these [s]. An empty field or nan marks a missing measurement. If
 * lines also have Python's results, the program reports the largest difference and fails if it
 * exceeds 1e-9. The results are the estimate (RHEC_ESTIMATE), and then its standard deviations in
 * the export of a log, else the command, if there is one. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "rhec.h"

#ifdef RHEC_HEADINGS
#include "search.h"

enum { MEASURED = 2 * RHEC_OUTPUTS, COMPUTED = 2 * RHEC_ESTIMATE };
static struct rhec_search s; /* too large for small stacks */

static void start(void)
{
    rhec_search_init(&s);
}

static int sample(const double numbers[MEASURED], double result[COMPUTED])
{
    double ages_s[RHEC_OUTPUTS];
    for (int i = 0; i < RHEC_OUTPUTS; i++) {
        ages_s[i] = numbers[RHEC_OUTPUTS + i] > 0 ? numbers[RHEC_OUTPUTS + i] : 0;
    }
    return rhec_search_estimate(&s, numbers, ages_s, result, result + RHEC_ESTIMATE);
}
#else
#ifdef RHEC_CONTROLLER
#define COMMAND "omega_cmd_radps,"
enum { MEASURED = RHEC_OUTPUTS, COMPUTED = RHEC_ESTIMATE + 1 };
#else
#define COMMAND ""
enum { MEASURED = RHEC_OUTPUTS, COMPUTED = RHEC_ESTIMATE };
#endif
static struct rhec r; /* too large for small stacks */

static void start(void)
{
    rhec_init(&r, &rhec_scenario, rhec_scenario_guess);
    puts("x_hat_m,y_hat_m,theta_hat_rad,nu_hat_mps,mu_hat,kappa_hat," COMMAND "status");
}

static int sample(const double numbers[MEASURED], double result[COMPUTED])
{
    rhec_prepare_estimate(&r);
    int status = rhec_estimate(&r, numbers, result);
#ifdef RHEC_CONTROLLER
    status |= rhec_control(&r, &result[RHEC_ESTIMATE]);
#endif
    return status;
}
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
    static char line[8192];
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
    start();
    while (fgets(line, sizeof line, log)) {
        double numbers[MEASURED + COMPUTED], result[COMPUTED];
        int count = parse(line, numbers, MEASURED + COMPUTED);
        for (int i = count; i < MEASURED; i++) {
            numbers[i] = NAN;
        }
        int status = sample(numbers, result);
        for (int i = 0; i < COMPUTED; i++) {
            printf("%.17g,", result[i]);
        }
        printf("%d\n", status);
        if (count == MEASURED + COMPUTED) {
            compared++;
            for (int i = 0; i < COMPUTED; i++) {
                double python = numbers[MEASURED + i];
                double difference = fabs(result[i] - python);
                int both_missing = isnan(result[i]) && isnan(python);
                /* One that is missing alone is NaN, which stays: no difference is larger. */
                if (!both_missing && (isnan(difference) || difference > largest)) {
                    largest = difference;
                }
            }
        }
    }
    fclose(log);
    if (compared) {
        fprintf(stderr, "largest difference in %d samples: %.3g\n", compared, largest);
    }
    return !(largest <= 1e-9);
}
