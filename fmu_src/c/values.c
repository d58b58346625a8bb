/* Getting and setting variables. All of them are Real. */
#include "instance.h"

#include <math.h>

/* The variable behind a value reference; NULL, with a message, if there is none. */
static const Variable *find(Instance *instance, const char *call, fmi2ValueReference reference)
{
    if (reference < instance->scene.variable_count)
        return &instance->scene.variables[reference];
    error(instance, "%s: there is no Real variable with value reference %u; the last one is %llu. Nothing was changed",
          call, reference, (unsigned long long)instance->scene.variable_count - 1);
    return NULL;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2GetReal))
        return fmi2Error;
    if (nvr == 0)
        return fmi2OK;
    if (vr == NULL || value == NULL)
        return error(instance, "fmi2GetReal: a vector is NULL");
    bool outputs = false;
    for (size_t i = 0; i < nvr; i++) {
        const Variable *v = find(instance, "fmi2GetReal", vr[i]);
        if (v == NULL)
            return fmi2Error;
        outputs = outputs || v->block == BLOCK_OUTPUTS;
    }
    if (outputs && instance->mode == MODE_INITIALIZATION && instance->stale && refresh(instance) != fmi2OK)
        return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        const Variable *v = &instance->scene.variables[vr[i]];
        value[i] = instance->values[v->block][v->slot];
    }
    return fmi2OK;
}

static fmi2Status check(Instance *instance, fmi2ValueReference reference, double value)
{
    const Variable *v = find(instance, "fmi2SetReal", reference);
    if (v == NULL)
        return fmi2Error;
    const char *name = variable_name(&instance->scene, v);
    if (v->block == BLOCK_OUTPUTS)
        return error(instance, "fmi2SetReal: %s is an output and cannot be set. Nothing was changed", name);
    if (!isfinite(value))
        return error(instance, "fmi2SetReal: %s = %g, it must be finite. Nothing was changed", name, value);
    /* Inputs come from another simulator that may overshoot a little: only parameters are held to their range. */
    if (v->block == BLOCK_PARAMETERS && !(value >= v->minimum && value <= v->maximum))
        return error(instance, "fmi2SetReal: %s = %.17g lies outside [%g, %g]. Nothing was changed", name, value,
                     v->minimum, v->maximum);
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2SetReal))
        return fmi2Error;
    if (nvr == 0)
        return fmi2OK;
    if (vr == NULL || value == NULL)
        return error(instance, "fmi2SetReal: a vector is NULL. Nothing was changed");
    for (size_t i = 0; i < nvr; i++)
        if (check(instance, vr[i], value[i]) != fmi2OK)
            return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        const Variable *v = &instance->scene.variables[vr[i]];
        instance->values[v->block][v->slot] = value[i];
    }
    instance->stale = true;
    return fmi2OK;
}

/* No variable is an Integer, a Boolean or a String: only an empty list can be served. */
static fmi2Status serve_none(Instance *instance, Call call, const char *name, size_t nvr)
{
    if (!allowed(instance, call))
        return fmi2Error;
    if (nvr == 0)
        return fmi2OK;
    return error(instance, "%s: every variable of this FMU is a Real", name);
}

#define NONE(function, type)                                                                                           \
    fmi2Status function(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, type value[])                      \
    {                                                                                                                  \
        (void)vr;                                                                                                      \
        (void)value;                                                                                                   \
        return serve_none(c, CALL_##function, #function, nvr);                                                         \
    }

NONE(fmi2GetInteger, fmi2Integer)
NONE(fmi2GetBoolean, fmi2Boolean)
NONE(fmi2GetString, fmi2String)
NONE(fmi2SetInteger, const fmi2Integer)
NONE(fmi2SetBoolean, const fmi2Boolean)
NONE(fmi2SetString, const fmi2String)
