/* Stands in for an FMU whose step does what a step must not do; its one start value says what. */
#define _GNU_SOURCE
#include <pthread.h>
#include <stdlib.h>
#include <unistd.h>

#include "fmi2Functions.h"

static int offence;
static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)name, (void)type, (void)guid, (void)location, (void)callbacks, (void)visible, (void)logging;
    return &offence;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real d, fmi2Boolean e, fmi2Real f)
{
    (void)c, (void)a, (void)b, (void)d, (void)e, (void)f;
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference references[], size_t count, const fmi2Real values[])
{
    (void)c, (void)references;
    if (count == 1) /* a start; the inputs are two */
        offence = (int)values[0];
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference references[], size_t count, fmi2Real values[])
{
    (void)c, (void)references;
    for (size_t i = 0; i < count; i++)
        values[i] = 0.0;
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real h, fmi2Boolean keep)
{
    (void)c, (void)time, (void)h, (void)keep;
    static void *volatile kept;
    switch (offence) {
    case 1:
        kept = malloc(8);
        break;
    case 2:
        kept = calloc(1, 8);
        break;
    case 3:
        kept = realloc(kept, 8);
        break;
    case 4:
        free(kept);
        break;
    case 5:
        kept = aligned_alloc(64, 64);
        break;
    case 6:
        pthread_mutex_lock(&mutex);
        pthread_mutex_unlock(&mutex);
        break;
    case 7:
        return (fmi2Status)(getppid() == 0); /* system call 110 */
    default:
        break;
    }
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return c == NULL ? fmi2Error : fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return c == NULL ? fmi2Error : fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return c == NULL ? fmi2Error : fmi2OK; }
void fmi2FreeInstance(fmi2Component c) { (void)c; }
