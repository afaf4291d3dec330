/* SPDX-License-Identifier: MIT */
/* Replays a log: replay_log log.csv > results.csv
 *
 * The first line has the names of the columns. Each further line has a measurement, as
 * rhec_memory.h names its entries (RHEC_OUTPUTS), and the ages of these [s]; an empty field marks
 * what is missing. If lines also have Python's estimates (RHEC_ESTIMATE) and their standard
 * deviations, the program reports the largest difference and fails if it exceeds 1e-9. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "search.h"

enum { MEASURED = 2 * RHEC_OUTPUTS, COMPUTED = 2 * RHEC_ESTIMATE };

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
    static struct rhec_search s; /* too large for small stacks */
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
    rhec_search_init(&s);
    while (fgets(line, sizeof line, log)) {
        double numbers[MEASURED + COMPUTED], result[COMPUTED];
        int count = parse(line, numbers, MEASURED + COMPUTED);
        for (int i = count; i < MEASURED; i++) {
            numbers[i] = NAN;
        }
        for (int i = RHEC_OUTPUTS; i < MEASURED; i++) {
            numbers[i] = numbers[i] > 0 ? numbers[i] : 0;
        }
        int status = rhec_search_estimate(&s, numbers, numbers + RHEC_OUTPUTS, result,
                                          result + RHEC_ESTIMATE);
        for (int i = 0; i < COMPUTED; i++) {
            printf("%.17g,", result[i]);
        }
        printf("%d\n", status);
        if (count == MEASURED + COMPUTED) {
            compared++;
            for (int i = 0; i < COMPUTED; i++) {
                double python = numbers[MEASURED + i];
                double difference = fabs(result[i] - python);
                int both_missing = result[i] != result[i] && python != python;
                difference = both_missing ? 0 : difference;
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
