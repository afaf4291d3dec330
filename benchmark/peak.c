/* How fast scalars are added and multiplied, where none waits for another: the loop that a step of
   estimation or control could at best be. */
#include <time.h>

double seconds_a_flop(void)
{
    enum { CHAINS = 8, TIMES = 20000 };
    volatile double factor = 0.999, offset = 0.001;
    double a = factor, b = offset, x[CHAINS] = {1, 2, 3, 4, 5, 6, 7, 8};
    struct timespec begin, end;
    clock_gettime(CLOCK_MONOTONIC, &begin);
    for (int i = 0; i < TIMES; i++) {
        x[0] = x[0] * a + b;
        x[1] = x[1] * a + b;
        x[2] = x[2] * a + b;
        x[3] = x[3] * a + b;
        x[4] = x[4] * a + b;
        x[5] = x[5] * a + b;
        x[6] = x[6] * a + b;
        x[7] = x[7] * a + b;
    }
    clock_gettime(CLOCK_MONOTONIC, &end);
    for (int k = 0; k < CHAINS; k++)
        offset = x[k]; /* otherwise nothing would be computed */
    return ((double)(end.tv_sec - begin.tv_sec) + 1e-9 * (double)(end.tv_nsec - begin.tv_nsec)) /
           (2.0 * CHAINS * TIMES);
}
