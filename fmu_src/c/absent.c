/* Functions of the standard for what modelDescription.xml declares absent: they exist and refuse. */
#include "instance.h"

static fmi2Status refuse(fmi2Component c, const char *call, const char *reason)
{
    if (c != NULL)
        error(c, "%s: %s", call, reason);
    return fmi2Error;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t nUnknown,
                                        const fmi2ValueReference known[], size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[])
{
    (void)unknown, (void)nUnknown, (void)known, (void)nKnown, (void)dvKnown, (void)dvUnknown;
    return refuse(c, "fmi2GetDirectionalDerivative", "providesDirectionalDerivative is false");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr, (void)nvr, (void)order, (void)value;
    return refuse(c, "fmi2SetRealInputDerivatives", "canInterpolateInputs is false");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)nvr, (void)order, (void)value;
    return refuse(c, "fmi2GetRealOutputDerivatives", "maxOutputDerivativeOrder is 0");
}

static const char co_simulation[] = "this FMU is for co-simulation only";

fmi2Status fmi2EnterEventMode(fmi2Component c) { return refuse(c, "fmi2EnterEventMode", co_simulation); }

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    (void)info;
    return refuse(c, "fmi2NewDiscreteStates", co_simulation);
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    return refuse(c, "fmi2EnterContinuousTimeMode", co_simulation);
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSet, fmi2Boolean *enterEventMode,
                                       fmi2Boolean *terminateSimulation)
{
    (void)noSet, (void)enterEventMode, (void)terminateSimulation;
    return refuse(c, "fmi2CompletedIntegratorStep", co_simulation);
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    (void)time;
    return refuse(c, "fmi2SetTime", co_simulation);
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx)
{
    (void)x, (void)nx;
    return refuse(c, "fmi2SetContinuousStates", co_simulation);
}

#define REFUSE_VECTOR(function)                                                                                        \
    fmi2Status function(fmi2Component c, fmi2Real x[], size_t nx)                                                      \
    {                                                                                                                  \
        (void)x, (void)nx;                                                                                             \
        return refuse(c, #function, co_simulation);                                                                    \
    }

REFUSE_VECTOR(fmi2GetDerivatives)
REFUSE_VECTOR(fmi2GetEventIndicators)
REFUSE_VECTOR(fmi2GetContinuousStates)
REFUSE_VECTOR(fmi2GetNominalsOfContinuousStates)
