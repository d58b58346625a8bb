/* What one core can do at most: printed as lines of a name and a number per second.

   peak BYTES...

   Cycles, fused multiply-adds in float64 and float32 as flops, square roots with a division each, in vectors of 32
   bytes; and for every number of bytes, bytes read from an array of that size. Seconds are those that the thread had its
   core, and the best of several short tries counts: what else the machine does only ever takes away. */
#define _GNU_SOURCE /* for clock_gettime */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef double Double4 __attribute__((vector_size(32)));
typedef float Float8 __attribute__((vector_size(32)));

enum { CHAINS = 12, TRIES = 40 }; /* a chain waits for itself; as many as keep two units busy fit into the registers */

static volatile double kept; /* what is not used is not computed */

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static double cycles(void)
{
    enum { COUNT = 200000 };
    uint64_t sum = 0;
    for (int i = 0; i < COUNT; i++)
#if defined(__x86_64__)
        __asm__ volatile("add $1, %0\n\tadd $1, %0\n\tadd $1, %0\n\tadd $1, %0" : "+r"(sum));
#elif defined(__aarch64__)
        __asm__ volatile("add %0, %0, #1\n\tadd %0, %0, #1\n\tadd %0, %0, #1\n\tadd %0, %0, #1" : "+r"(sum));
#endif
    return (double)sum;
}

#define CHAINED(name, Vector, scalar, count, per_pass, change)                                                         \
    static double name(void)                                                                                           \
    {                                                                                                                  \
        Vector chain[CHAINS];                                                                                          \
        const Vector a = (Vector){0} + (scalar)0.999, b = (Vector){0} + (scalar)0.001 + (scalar)kept;                  \
        for (int k = 0; k < CHAINS; k++)                                                                               \
            chain[k] = b + (scalar)k;                                                                                  \
        for (int i = 0; i < (count); i++)                                                                              \
            for (int k = 0; k < CHAINS; k++)                                                                           \
                chain[k] = change;                                                                                     \
        for (int k = 0; k < CHAINS; k++)                                                                               \
            kept = 0.0 * (double)chain[k][0];                                                                          \
        return (double)(count) * CHAINS * (sizeof(Vector) / sizeof(scalar)) * (per_pass);                              \
    }

CHAINED(flops_f64, Double4, double, 100000, 2.0, chain[k] * a + b)
CHAINED(flops_f32, Float8, float, 100000, 2.0, chain[k] * a + b)
CHAINED(roots_f64, Double4, double, 10000, 1.0, a / __builtin_elementwise_sqrt(chain[k] + b))

static const double *memory;
static size_t vectors;

static double bytes(void)
{
    Double4 sum[CHAINS] = {{0}};
    size_t passes = 1 + (size_t)(1 << 20) / vectors;
    for (size_t pass = 0; pass < passes; pass++) {
        __asm__ volatile("" : : "r"(memory) : "memory"); /* each pass reads anew */
        const Double4 *at = (const Double4 *)(const void *)memory;
        for (size_t i = 0; i + CHAINS <= vectors; i += CHAINS)
            for (int k = 0; k < CHAINS; k++)
                sum[k] += at[i + (size_t)k];
    }
    for (int k = 0; k < CHAINS; k++)
        kept = 0.0 * sum[k][0];
    return (double)passes * (double)(vectors / CHAINS * CHAINS) * sizeof(Double4);
}

static void tell(const char *name, double (*work)(void))
{
    double best = 0.0;
    for (int i = 0; i < TRIES; i++) {
        double before = seconds(), done = work(), rate = done / (seconds() - before);
        best = rate > best ? rate : best;
    }
    printf("%s %.6g\n", name, best);
}

int main(int argc, char **argv)
{
    tell("cycles", cycles);
    tell("flops_f64", flops_f64);
    tell("flops_f32", flops_f32);
    tell("roots_f64", roots_f64);
    for (int i = 1; i < argc; i++) {
        size_t size = (size_t)strtoull(argv[i], NULL, 10) / 4096 * 4096;
        void *taken = size == 0 ? NULL : aligned_alloc(4096, size);
        if (taken == NULL) {
            fprintf(stderr, "peak: no array of %s bytes\n", argv[i]);
            return 1;
        }
        memset(taken, 0, size);
        memory = taken;
        vectors = size / sizeof(Double4);
        tell(argv[i], bytes);
        free(taken);
    }
    return 0;
}
