/* One instance of the FMU: what the fmi2 functions share. */
#ifndef TC_INSTANCE_H
#define TC_INSTANCE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "fmi2Functions.h"
#include "layout.h" /* generated from the Python tables */

/* Modes of a co-simulation slave, as bits, so that the table of allowed calls can combine them. */
typedef enum {
    MODE_INSTANTIATED = 1,
    MODE_INITIALIZATION = 2,
    MODE_STEP = 4,
    MODE_STEP_FAILED = 8, /* the last step was discarded; the state from before it stands */
    MODE_TERMINATED = 16,
} Mode;

/* Log categories, as bits; their names are in layout.h. */
typedef enum { LOG_EVENTS = 1, LOG_DISCARD = 2, LOG_ERROR = 4, LOG_ALL = 7 } Category;

/* Blocks of a variable, in the order of Variable.block. */
enum { BLOCK_PARAMETERS, BLOCK_INPUTS, BLOCK_OUTPUTS, BLOCK_COUNT };

typedef struct {
    uint32_t block;
    uint32_t slot;
    double start;
    double minimum;
    double maximum;
    uint64_t name; /* offset of the name in Scene.names */
} Variable;

/* Numbers in each block of memory, in the order of model.bin. */
typedef struct {
    uint64_t model_index, model_real, state_index, state_real, scratch_index, scratch_real;
    uint64_t parameters, inputs, outputs;
} Sizes;

/* model.bin in memory: read once, never written. */
typedef struct {
    void *memory;
    const char *guid;
    uint64_t variable_count;
    const Variable *variables;
    const char *names;
    Sizes sizes;
    double start_time; /* [s] */
    const uint64_t *spans;
    const unsigned char *start; /* what persists, as it is at the start */
    size_t start_bytes;
    const double *model_real;
    const uint32_t *model_index;
} Scene;

/* Time is origin + h * steps_of_h while h stays the same, so it does not drift. */
typedef struct {
    double start;        /* [s] */
    double origin;       /* [s] */
    double h;            /* [s], 0 before the first step */
    uint64_t steps_of_h; /* since origin */
    uint64_t steps;      /* since start */
} Clock;

typedef struct {
    TcEntry *initialize;
    TcEntry *step;
    const char *level; /* instruction set the kernels were compiled for */
} Kernel;

typedef struct {
    fmi2CallbackFunctions callbacks; /* a copy: the caller's structure may be gone */
    char *name;
    bool logging_on; /* as given at instantiation */
    unsigned categories;

    Scene scene;
    Kernel kernel;

    Mode mode;
    Clock clock;
    bool stop_defined;
    double stop_time; /* [s] */
    bool stale;       /* in Initialization Mode: the outputs do not yet follow what was set */
    fmi2Status step_status;

    /* Everything that persists lies in one block, so a backup or a saved state is one copy. */
    unsigned char *live;
    unsigned char *backup;
    double *values[BLOCK_COUNT]; /* into live */
    double *state_real;          /* into live */
    uint32_t *state_index;       /* into live */
    double *scratch_real;
    uint32_t *scratch_index;
} Instance;

/* log.c */
void log_message(Instance *instance, fmi2Status status, Category category, const char *format, ...)
    __attribute__((format(printf, 4, 5)));
fmi2Status error(Instance *instance, const char *format, ...) __attribute__((format(printf, 2, 3)));
fmi2Status discard(Instance *instance, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* calls.c */
typedef enum {
#define CALL(name, modes) CALL_##name,
#include "calls.def"
#undef CALL
} Call;
bool allowed(Instance *instance, Call call);

/* path.c: NULL if it cannot be opened, with the reason in `why`. */
void *read_resource(const char *location, const char *file, size_t *bytes, char *why, size_t why_size);

/* scene.c */
uint64_t checksum(const void *memory, size_t bytes);
bool scene_load(Scene *scene, const char *location, char *why, size_t why_size);
const char *variable_name(const Scene *scene, const Variable *variable);

/* kernel.c */
Kernel kernel_choose(void);
fmi2Status kernel_run(Instance *instance, TcEntry *entry, double h);

/* instance.c */
double clock_now(const Clock *clock);
void start_over(Instance *instance);
fmi2Status refresh(Instance *instance);

#endif
