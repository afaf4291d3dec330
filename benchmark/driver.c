/* Compiled phases called one after the other, sample by sample, from C: times without Python. */
#include <string.h>
#include <time.h>

typedef int function(const double **, double **, long long *, double *, int);

/* Copy this sample's row to where a phase reads it, or call a phase; then maybe look at the clock. */
struct step {
    function *phase;
    const double **arguments;
    double **results;
    long long *whole;
    double *work;
    double *to;
    const double *rows;
    long long doubles, timed;
};

static double now_us(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return 1e6 * (double)now.tv_sec + 1e-3 * (double)now.tv_nsec;
}

/* Adds to us[k] the time from one timed step to the next, of all samples. */
int drive(long long samples, long long steps, const struct step *step, double *us)
{
    for (long long k = 0; k < samples; k++) {
        double last = now_us(), *part = us;
        for (const struct step *s = step; s < step + steps; s++) {
            if (s->to)
                memcpy(s->to, s->rows + k * s->doubles, (size_t)s->doubles * sizeof(double));
            if (s->phase && s->phase(s->arguments, s->results, s->whole, s->work, 0))
                return 1;
            if (s->timed) {
                double now = now_us();
                *part++ += now - last;
                last = now;
            }
        }
    }
    return 0;
}
