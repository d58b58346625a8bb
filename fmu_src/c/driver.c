/* Runs an FMU from a file of inputs and times every step: for benchmarks and for platforms without Python.

   driver LIBRARY RESOURCES GUID JOB RESULT

   JOB, little-endian: u64 steps, rows, n_starts, n_inputs, n_outputs, 1 + core to stay on or 0; f64 start time, h; u64
   value reference and f64 value of every start; u64 value references of the inputs, then of the outputs; f64
   inputs[rows][n_inputs].
   RESULT: u64 nanoseconds[steps]; if a core is given, u64 preemptions[steps], waits[steps], page faults[steps],
   nanoseconds of processor time[steps] and whether the memory was locked; f64 outputs[rows][n_outputs].
   Row 0 of the inputs is also set in Initialization Mode. With more steps than rows the rows are taken again and again,
   and the outputs are of the last time. Exit code 1, with a message, if anything fails. */
#ifndef _WIN32
#define _GNU_SOURCE /* for clock_gettime, RUSAGE_THREAD and sched_setaffinity */
#endif

#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"
#include "watch.h"

#ifdef _WIN32
#include <corecrt_startup.h>
#include <windows.h>
static void *load(const char *path) { return (void *)LoadLibraryA(path); }
static void *symbol(void *library, const char *name)
{
    FARPROC found = GetProcAddress((HMODULE)library, name);
    void *out;
    memcpy(&out, &found, sizeof out);
    return out;
}
static uint64_t nanoseconds(void)
{
    LARGE_INTEGER now, per_second;
    QueryPerformanceCounter(&now);
    QueryPerformanceFrequency(&per_second);
    return (uint64_t)((double)now.QuadPart * 1e9 / (double)per_second.QuadPart);
}
#else
#include <dlfcn.h>
#include <time.h>
static void *load(const char *path)
{
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (library == NULL)
        fprintf(stderr, "%s\n", dlerror());
    return library;
}
static void *symbol(void *library, const char *name) { return dlsym(library, name); }
static uint64_t told_by(clockid_t clock)
{
    struct timespec now;
    clock_gettime(clock, &now);
    return (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
}
static uint64_t nanoseconds(void) { return told_by(CLOCK_MONOTONIC); }
#endif

static void fail(const char *what)
{
    fprintf(stderr, "driver: %s failed\n", what);
    exit(1);
}

/* What held the thread up so far: taken off its core, waited of its own accord, touched memory that was not there; and
   the processor time [ns] that it had, without what other threads, and other machines on this one, had of its core. */
enum { PREEMPTIONS, WAITS, FAULTS, PROCESSOR, INTERRUPTIONS };

#ifdef __linux__
#include <sched.h>
#include <sys/mman.h>
#include <sys/resource.h>
static uint64_t stay_on(uint64_t core)
{
    cpu_set_t cores;
    CPU_ZERO(&cores);
    CPU_SET(core, &cores);
    if (sched_setaffinity(0, sizeof cores, &cores) != 0)
        fail("staying on the core");
    return mlockall(MCL_CURRENT | MCL_FUTURE) == 0; /* not everyone may */
}
static void interruptions(uint64_t *so_far)
{
    struct rusage usage;
    getrusage(RUSAGE_THREAD, &usage);
    so_far[PREEMPTIONS] = (uint64_t)usage.ru_nivcsw;
    so_far[WAITS] = (uint64_t)usage.ru_nvcsw;
    so_far[FAULTS] = (uint64_t)(usage.ru_minflt + usage.ru_majflt);
    so_far[PROCESSOR] = told_by(CLOCK_THREAD_CPUTIME_ID);
}
#else
static uint64_t stay_on(uint64_t core)
{
    (void)core;
    fail("staying on a core, which is for Linux only,");
    return 0;
}
static void interruptions(uint64_t *so_far) { memset(so_far, 0, INTERRUPTIONS * sizeof *so_far); }
#endif

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...)
{
    (void)environment;
    bool watched = watch(false); /* what the importer does with a message is its own affair */
    va_list arguments;
    va_start(arguments, message);
    fprintf(stderr, "%s %d %s: ", name, (int)status, category);
    vfprintf(stderr, message, arguments);
    fputc('\n', stderr);
    va_end(arguments);
    watch(watched);
}

static void *get(void *library, const char *name)
{
    void *found = symbol(library, name);
    if (found == NULL)
        fail(name);
    return found;
}

static void *allocate(uint64_t count)
{
    void *memory = calloc((size_t)count + 1, 8);
    if (memory == NULL)
        fail("calloc");
    return memory;
}

static void read_items(FILE *file, void *to, uint64_t count)
{
    if (fread(to, 8, (size_t)count, file) != count)
        fail("reading the job");
}

static fmi2ValueReference *read_references(FILE *file, uint64_t count)
{
    uint64_t *wide = allocate(count);
    fmi2ValueReference *references = allocate(count);
    read_items(file, wide, count);
    for (uint64_t i = 0; i < count; i++)
        references[i] = (fmi2ValueReference)wide[i];
    free(wide);
    return references;
}

/* A pointer to data is not a pointer to a function in ISO C; the bits are the same on every platform here. */
#define GET(type, name)                                                                                                \
    type *name;                                                                                                        \
    do {                                                                                                               \
        void *found = get(library, #name);                                                                             \
        memcpy(&name, &found, sizeof found);                                                                           \
    } while (0)

static int run(int argc, char **argv)
{
    if (argc != 6) {
        fprintf(stderr, "usage: driver LIBRARY RESOURCES GUID JOB RESULT\n");
        return 2;
    }
    if (!watch_ready())
        fail("syscall user dispatch of Linux 5.11");
    void *library = load(argv[1]);
    if (library == NULL)
        fail("loading the library");
    GET(fmi2InstantiateTYPE, fmi2Instantiate);
    GET(fmi2SetupExperimentTYPE, fmi2SetupExperiment);
    GET(fmi2EnterInitializationModeTYPE, fmi2EnterInitializationMode);
    GET(fmi2ExitInitializationModeTYPE, fmi2ExitInitializationMode);
    GET(fmi2SetRealTYPE, fmi2SetReal);
    GET(fmi2GetRealTYPE, fmi2GetReal);
    GET(fmi2DoStepTYPE, fmi2DoStep);
    GET(fmi2TerminateTYPE, fmi2Terminate);
    GET(fmi2FreeInstanceTYPE, fmi2FreeInstance);

    FILE *job = fopen(argv[4], "rb");
    if (job == NULL)
        fail("opening the job");
    uint64_t counts[6]; /* steps, rows, starts, inputs, outputs, core */
    double times[2];
    read_items(job, counts, 6);
    read_items(job, times, 2);
    uint64_t steps = counts[0], rows = counts[1], n_starts = counts[2], n_in = counts[3], n_out = counts[4];
    bool still = counts[5] != 0;
    double begin = times[0], h = times[1];
    fmi2ValueReference *start_refs = allocate(n_starts);
    double *starts = allocate(n_starts);
    for (uint64_t i = 0; i < n_starts; i++) {
        uint64_t reference;
        read_items(job, &reference, 1);
        start_refs[i] = (fmi2ValueReference)reference;
        read_items(job, starts + i, 1);
    }
    fmi2ValueReference *in_refs = read_references(job, n_in);
    fmi2ValueReference *out_refs = read_references(job, n_out);
    double *inputs = allocate(rows * n_in);
    read_items(job, inputs, rows * n_in);
    fclose(job);
    double *outputs = allocate(rows * n_out);
    uint64_t *spent = allocate(steps);
    uint64_t held_up = still ? INTERRUPTIONS * steps + 1 : 0;
    uint64_t *held = allocate(held_up);
    if (still)
        held[INTERRUPTIONS * steps] = stay_on(counts[5] - 1);

    fmi2CallbackFunctions callbacks = {.logger = logger};
    fmi2Component c = fmi2Instantiate("driver", fmi2CoSimulation, argv[3], argv[2], &callbacks, fmi2False, fmi2False);
    if (c == NULL)
        fail("fmi2Instantiate");
    if (fmi2SetupExperiment(c, fmi2False, 0, begin, fmi2False, 0) != fmi2OK ||
        fmi2SetReal(c, start_refs, (size_t)n_starts, starts) != fmi2OK || fmi2EnterInitializationMode(c) != fmi2OK ||
        (steps > 0 && fmi2SetReal(c, in_refs, (size_t)n_in, inputs) != fmi2OK) ||
        fmi2ExitInitializationMode(c) != fmi2OK)
        fail("initialization");
    for (uint64_t k = 0; k < steps; k++) {
        uint64_t row = k % rows, so_far[INTERRUPTIONS], then[INTERRUPTIONS];
        if (fmi2SetReal(c, in_refs, (size_t)n_in, inputs + row * n_in) != fmi2OK)
            fail("fmi2SetReal");
        if (still)
            interruptions(so_far);
        uint64_t before = nanoseconds();
        watch(true);
        fmi2Status status = fmi2DoStep(c, begin + (double)k * h, h, fmi2True);
        watch(false);
        spent[k] = nanoseconds() - before;
        if (still) {
            interruptions(then);
            for (int i = 0; i < INTERRUPTIONS; i++)
                held[(uint64_t)i * steps + k] = then[i] - so_far[i];
        }
        if (status != fmi2OK) {
            fprintf(stderr, "driver: status %d in step %llu\n", (int)status, (unsigned long long)k);
            return 1;
        }
        if (fmi2GetReal(c, out_refs, (size_t)n_out, outputs + row * n_out) != fmi2OK)
            fail("fmi2GetReal");
    }
    if (fmi2Terminate(c) != fmi2OK)
        fail("fmi2Terminate");
    fmi2FreeInstance(c);

    FILE *result = fopen(argv[5], "wb");
    if (result == NULL || fwrite(spent, 8, (size_t)steps, result) != steps ||
        fwrite(held, 8, (size_t)held_up, result) != held_up ||
        fwrite(outputs, 8, (size_t)(rows * n_out), result) != rows * n_out || fclose(result) != 0)
        fail("writing the result");
    return 0;
}

#ifdef _WIN32
/* Where Windows begins. mingw's runtime, which would call main from here, is not there (windows.c). */
void mainCRTStartup(void)
{
    if (_configure_narrow_argv(_crt_argv_unexpanded_arguments) != 0)
        exit(1);
    exit(run(*__p___argc(), *__p___argv()));
}
#else
int main(int argc, char **argv) { return run(argc, argv); }
#endif
