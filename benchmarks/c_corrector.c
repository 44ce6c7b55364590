/* Time of each setpoint in process, memory locked: `c_corrector PROGRAM COUNT [PRIORITY]` prints nanoseconds.
 *
 * With a priority it runs as real-time process (SCHED_FIFO), which needs the right to do so.
 * Beside each setpoint an empty loop that takes as long is timed: what is slow in both is the machine's.
 */
#define _GNU_SOURCE
#include "kilter_corrector.h"

#include <math.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>

enum { WARM_UP = 1000 };
static unsigned char content[1 << 20];
static double memory[(KC_MOST_ROWS + 256) * KC_COLUMNS];

static int by_size(const void *a, const void *b)
{
    const double one = *(const double *)a, other = *(const double *)b;
    return (one > other) - (one < other);
}

/* Nanoseconds since then. */
static double since(const struct timespec *begun)
{
    struct timespec ended;
    clock_gettime(CLOCK_MONOTONIC, &ended);
    return 1e9 * (double)(ended.tv_sec - begun->tv_sec) + (double)(ended.tv_nsec - begun->tv_nsec);
}

static void run_empty(long rounds)
{
    volatile long k;
    for (k = 0; k < rounds; k++) {}
}

static void print_shares(double *took, long count)
{
    const double shares[] = {0.5, 0.99, 0.999, 0.9999, 0.99999, 1.0};
    qsort(took, (size_t)count, sizeof *took, by_size);
    for (size_t i = 0; i < sizeof shares / sizeof *shares; i++) printf(" %.0f", took[(long)(shares[i] * (double)(count - 1))]);
}

int main(int argc, char **argv)
{
    FILE *file = argc > 2 ? fopen(argv[1], "rb") : NULL;
    const size_t bytes = file ? fread(content, 1, sizeof content, file) : 0;
    const long count = argc > 2 ? atol(argv[2]) : 0;
    double *took = calloc((size_t)(count > 0 ? count : 1), sizeof *took);
    double *empty = calloc((size_t)(count > 0 ? count : 1), sizeof *empty);
    kc_corrector corrector;
    const int code = kc_load(&corrector, content, bytes, memory, sizeof memory / sizeof *memory, 0);
    if (!took || !empty || count < WARM_UP || code) {
        fprintf(stderr, "c_corrector PROGRAM COUNT [PRIORITY]: %s\n", code ? kc_sentence(code) : "COUNT is 1000 or more");
        return 2;
    }
    const int locked = mlockall(MCL_CURRENT | MCL_FUTURE) == 0;
    const struct sched_param wanted = {argc > 3 ? atoi(argv[3]) : 0};
    const int real_time = argc > 3 && sched_setscheduler(0, SCHED_FIFO, &wanted) == 0;
    double q[KC_MOST_JOINTS], out[KC_MOST_JOINTS];
    kc_answer answer;
    long refused = 0;
    /* As many rounds of the empty loop as take the time of a setpoint, by the medians of WARM_UP of each. */
    long rounds = 1000;
    /* Linux takes real-time processes that never rest off the processor, for 50 ms of each second: a controller rests. */
    const struct timespec rest = {0, 1000000};
    for (long k = -WARM_UP; k < count; k++) {
        struct timespec begun;
        if (real_time && k % 250 == 0) nanosleep(&rest, NULL);
        for (int i = 0; i < corrector.joints; i++) q[i] = 0.7 * sin(0.001 * (1.0 + 0.3 * i) * (double)k + i);
        clock_gettime(CLOCK_MONOTONIC, &begun);
        refused += kc_correct(&corrector, q, NULL, NULL, 0.001, out, &answer) != KC_OK;
        const double one = since(&begun);
        clock_gettime(CLOCK_MONOTONIC, &begun);
        run_empty(rounds);
        const double other = since(&begun);
        took[k < 0 ? k + WARM_UP : k] = one;
        empty[k < 0 ? k + WARM_UP : k] = other;
        if (k == -1) {
            qsort(took, WARM_UP, sizeof *took, by_size);
            qsort(empty, WARM_UP, sizeof *empty, by_size);
            rounds = (long)(1000.0 * took[WARM_UP / 2] / empty[WARM_UP / 2]);
            refused = 0;
        }
    }
    printf("%d %d %ld", locked, real_time, refused);
    print_shares(took, count);
    print_shares(empty, count);
    printf("\n");
    return 0;
}
