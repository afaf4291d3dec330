/* Fuzzing of an exported estimator and controller, of a scenario or of a model.
 *
 * The bytes of an input are a drive: for each sample a byte that says which measurements are taken
 * from the bytes that follow, eight each, whatever number they are; the others are those of a robot
 * that stands still. A bit of it overwrites a number of memory instead. After each sample the
 * estimate must be finite and commands within their bounds.
 *
 * With -DLIBFUZZER, libFuzzer chooses the inputs. Otherwise: exported RUNS SEED FILE..., which runs
 * the files and then RUNS random mutations of them. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "rhec.h"

#define MOST_SAMPLES 64

static double next_number(const uint8_t **data, size_t *size)
{
    double number = 0.5;
    size_t n = *size < sizeof number ? *size : sizeof number;
    memcpy(&number, *data, n);
    *data += n;
    *size -= n;
    return number;
}

static void check(const char *what, int entry, double value, double lower, double upper)
{
    if (!(lower <= value && value <= upper)) {
        fprintf(stderr, "%s %d was %g\n", what, entry, value);
        abort();
    }
}

static void control(struct rhec *r, const double estimate[])
{
    double u[8] = {0};
#ifdef RHEC_PATH
    (void)estimate;
    rhec_control(r, u);
    check("command", 0, u[0], rhec_scenario.lower[0], rhec_scenario.upper[0]);
#else
    static const double nothing[RHEC_HORIZON * 8 + 8];
    rhec_control(r, estimate, estimate + RHEC_STATES + RHEC_INPUTS, nothing, nothing, u);
    for (int i = 0; i < RHEC_INPUTS; i++) {
        check("command", i, u[i], rhec_scenario.lower[i], rhec_scenario.upper[i]);
    }
#endif
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static struct rhec r;
    double guess[RHEC_GUESS];
    memcpy(guess, rhec_scenario_guess, sizeof guess);
    rhec_init(&r, &rhec_scenario, guess);
    for (int sample = 0; sample < MOST_SAMPLES && size > 0; sample++) {
        double z[RHEC_OUTPUTS] = {0}, estimate[RHEC_ESTIMATE];
        int chosen = *data++;
        size--;
        for (int i = 0; i < RHEC_OUTPUTS; i++) {
            z[i] = chosen >> i & 1 ? next_number(&data, &size) : 0.0;
        }
        if (chosen == 0x80) {
            size_t place = (size_t)sample * 97 % (sizeof r.estimator / sizeof(double));
            ((double *)&r.estimator)[place] = next_number(&data, &size);
        }
        if (chosen & 0x20) {
            rhec_prepare_estimate(&r);
        }
        rhec_estimate(&r, z, estimate);
        for (int i = 0; i < RHEC_ESTIMATE; i++) {
            check("estimate", i, estimate[i], -1e300, 1e300);
        }
        if (chosen & 0x40) {
            rhec_prepare_control(&r);
        }
        control(&r, estimate);
    }
    return 0;
}

#ifndef LIBFUZZER
static uint64_t state;

/* A random number below n, by splitmix64. */
static size_t below(size_t n)
{
    uint64_t b = state += UINT64_C(0x9E3779B97F4A7C15);
    b = (b ^ (b >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    b = (b ^ (b >> 27)) * UINT64_C(0x94D049BB133111EB);
    return (size_t)((b ^ (b >> 31)) % n);
}

static size_t read_file(const char *name, uint8_t *bytes, size_t most)
{
    FILE *file = fopen(name, "rb");
    if (!file) {
        perror(name);
        exit(2);
    }
    size_t n = fread(bytes, 1, most, file);
    fclose(file);
    return n;
}

int main(int argc, char **argv)
{
    static uint8_t bytes[2048], other[2048];
    if (argc < 4) {
        fprintf(stderr, "exported RUNS SEED FILE...\n");
        return 2;
    }
    for (int i = 3; i < argc; i++) {
        LLVMFuzzerTestOneInput(bytes, read_file(argv[i], bytes, sizeof bytes));
    }
    for (long run = 0; run < atol(argv[1]); run++) {
        state = strtoull(argv[2], NULL, 10) * UINT64_C(1000003) + (uint64_t)run;
        size_t n = read_file(argv[3 + below((size_t)argc - 3)], bytes, sizeof bytes);
        size_t m = read_file(argv[3 + below((size_t)argc - 3)], other, sizeof other);
        for (size_t k = below(24); n > 0 && k > 0; k--) {
            bytes[below(n)] = (uint8_t)below(256);
        }
        if (n > 0 && m > 0 && below(2)) { /* the end of another */
            size_t at = below(n), from = below(m);
            size_t length = m - from < sizeof bytes - at ? m - from : sizeof bytes - at;
            memcpy(bytes + at, other + from, length);
            n = at + length;
        }
        LLVMFuzzerTestOneInput(bytes, n);
    }
    return 0;
}
#endif
