/* The life of an instance: instantiate, set up, initialize, terminate, reset, free. */
#include "instance.h"

#include <ctype.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

double clock_now(const Clock *clock) { return clock->origin + clock->h * (double)clock->steps_of_h; }

static void clock_start(Clock *clock, double start) { *clock = (Clock){.start = start, .origin = start}; }

/* As fmi2Instantiate leaves it. */
void start_over(Instance *instance)
{
    const Scene *scene = &instance->scene;
    memcpy(instance->live, scene->start, scene->start_bytes);
    memset(instance->scratch_real, 0, scene->sizes.scratch_real * sizeof(double));
    memset(instance->scratch_index, 0, scene->sizes.scratch_index * sizeof(uint32_t));
    clock_start(&instance->clock, scene->start_time);
    instance->mode = MODE_INSTANTIATED;
    instance->stop_defined = false;
    instance->stale = false;
    instance->step_status = fmi2OK;
    /* What is wrong is told even without debug logging; fmi2SetDebugLogging can silence it. */
    instance->categories = instance->logging_on ? LOG_ALL : LOG_ERROR;
}

/* In Initialization Mode: let the state and the outputs follow the inputs and parameters set so far. */
fmi2Status refresh(Instance *instance)
{
    const Scene *scene = &instance->scene;
    size_t values = (scene->sizes.parameters + scene->sizes.inputs + scene->sizes.outputs) * sizeof(double);
    memcpy(instance->live + values, scene->start + values, scene->start_bytes - values);
    fmi2Status status = kernel_run(instance, instance->kernel.initialize, 0.0);
    instance->stale = status != fmi2OK;
    return status;
}

static bool allocate(Instance *instance)
{
    const Scene *scene = &instance->scene;
    const Sizes *sizes = &scene->sizes;
    /* One more than needed: an empty block is still a valid pointer. */
    instance->live = calloc(scene->start_bytes + 8, 1);
    instance->backup = calloc(scene->start_bytes + 8, 1);
    instance->scratch_real = calloc(sizes->scratch_real + 1, sizeof(double));
    instance->scratch_index = calloc(sizes->scratch_index + 1, sizeof(uint32_t));
    if (!instance->live || !instance->backup || !instance->scratch_real || !instance->scratch_index)
        return false;
    double *at = (double *)(void *)instance->live;
    instance->values[BLOCK_PARAMETERS] = at;
    instance->values[BLOCK_INPUTS] = at += sizes->parameters;
    instance->values[BLOCK_OUTPUTS] = at += sizes->inputs;
    instance->state_real = at += sizes->outputs;
    instance->state_index = (uint32_t *)(void *)(at + sizes->state_real);
    return true;
}

static void release(Instance *instance)
{
    free(instance->name);
    free(instance->scene.memory);
    free(instance->live);
    free(instance->backup);
    free(instance->scratch_real);
    free(instance->scratch_index);
    free(instance);
}

static bool is_blank(const char *text)
{
    if (text == NULL)
        return true;
    while (isspace((unsigned char)*text))
        text++;
    return *text == '\0';
}

static bool set_up(Instance *instance, fmi2Type type, const char *guid, const char *location)
{
    if (type != fmi2CoSimulation) {
        error(instance, "fmi2Instantiate: this FMU is for co-simulation only");
        return false;
    }
    char why[768];
    if (!scene_load(&instance->scene, location, why, sizeof why)) {
        error(instance, "fmi2Instantiate: %s", why);
        return false;
    }
    if (guid == NULL || strcmp(guid, instance->scene.guid) != 0) {
        error(instance,
              "fmi2Instantiate: the guid of modelDescription.xml is %s and that of resources/model.bin is %s: they "
              "belong to different FMUs. Unpack the FMU again",
              guid == NULL ? "NULL" : guid, instance->scene.guid);
        return false;
    }
    if (!allocate(instance)) {
        error(instance, "fmi2Instantiate: out of memory");
        return false;
    }
    return true;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    (void)visible; /* there is nothing to show */
    if (functions == NULL)
        return NULL; /* nobody to tell */
    Instance *instance = calloc(1, sizeof *instance);
    if (instance == NULL)
        return NULL;
    instance->callbacks = *functions;
    instance->logging_on = loggingOn;
    instance->categories = LOG_ALL;
    bool blank = is_blank(instanceName);
    const char *name = blank ? "unnamed" : instanceName;
    instance->name = malloc(strlen(name) + 1);
    if (instance->name == NULL) {
        free(instance);
        return NULL;
    }
    strcpy(instance->name, name);
    if (blank) {
        error(instance, "fmi2Instantiate: the instance needs a name");
        release(instance);
        return NULL;
    }
    if (!set_up(instance, fmuType, fmuGUID, fmuResourceLocation)) {
        release(instance);
        return NULL;
    }
    instance->kernel = kernel_choose();
    start_over(instance);
    log_message(instance, fmi2OK, LOG_EVENTS, "instantiated; the kernels run on %s", instance->kernel.level);
    return instance;
}

void fmi2FreeInstance(fmi2Component c)
{
    if (c != NULL)
        release(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    (void)toleranceDefined;
    (void)tolerance; /* the substep follows from stability, not from an error estimate */
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2SetupExperiment))
        return fmi2Error;
    if (!isfinite(startTime))
        return error(instance, "fmi2SetupExperiment: startTime is %g, it must be finite. Nothing was changed", startTime);
    if (stopTimeDefined && !(isfinite(stopTime) && stopTime >= startTime))
        return error(instance,
                     "fmi2SetupExperiment: stopTime is %g, it must be finite and not before startTime %g. Nothing was "
                     "changed",
                     stopTime, startTime);
    clock_start(&instance->clock, startTime);
    instance->stop_defined = stopTimeDefined;
    instance->stop_time = stopTime;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2EnterInitializationMode))
        return fmi2Error;
    instance->mode = MODE_INITIALIZATION;
    instance->stale = true;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2ExitInitializationMode))
        return fmi2Error;
    if (instance->stale && refresh(instance) != fmi2OK)
        return fmi2Error; /* still in Initialization Mode: what is wrong can be set right */
    instance->mode = MODE_STEP;
    log_message(instance, fmi2OK, LOG_EVENTS, "initialized at time %.17g", clock_now(&instance->clock));
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2Terminate))
        return fmi2Error;
    instance->mode = MODE_TERMINATED;
    log_message(instance, fmi2OK, LOG_EVENTS, "terminated at time %.17g", clock_now(&instance->clock));
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2Reset))
        return fmi2Error;
    start_over(instance);
    return fmi2OK;
}
