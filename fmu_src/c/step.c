/* One communication step and what can be asked about it. */
#include "instance.h"

#include <float.h>
#include <math.h>

/* How far an importer's time may be from ours, in s: an importer that adds h again and again is off by at most
   (steps taken) x epsilon x time; never more than half a step, so a lost or doubled step is always noticed. */
static double tolerance(const Clock *clock, double h)
{
    double reach = fmax(h, clock->h);
    double rounding = (double)(clock->steps + 8) * DBL_EPSILON * fmax(fabs(clock_now(clock)), fabs(clock->start));
    return fmin(0.5 * reach, 1e-6 * reach + rounding);
}

static void clock_advance(Clock *clock, double h)
{
    if (h == 0.0)
        return;
    if (h != clock->h) {
        clock->origin = clock_now(clock);
        clock->h = h;
        clock->steps_of_h = 0;
    }
    clock->steps_of_h++;
    clock->steps++;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    (void)noSetFMUStatePriorToCurrentPoint; /* nothing is kept for going back */
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2DoStep))
        return fmi2Error;
    double h = communicationStepSize;
    if (!isfinite(h) || h < 0.0)
        return error(instance,
                     "fmi2DoStep: communicationStepSize is %g, it must be finite and not negative. The step was not done",
                     h);
    double now = clock_now(&instance->clock);
    double slack = tolerance(&instance->clock, h);
    if (!(fabs(currentCommunicationPoint - now) <= slack))
        return error(instance,
                     "fmi2DoStep: currentCommunicationPoint is %.17g and this instance is at time %.17g. The step was "
                     "not done; begin at the time of the instance",
                     currentCommunicationPoint, now);
    if (instance->stop_defined && now + h > instance->stop_time + slack)
        return error(instance,
                     "fmi2DoStep: the step from %.17g to %.17g goes past the stopTime %.17g of fmi2SetupExperiment. The "
                     "step was not done",
                     now, now + h, instance->stop_time);
    instance->step_status = kernel_run(instance, instance->kernel.step, h);
    instance->mode = instance->step_status == fmi2Discard ? MODE_STEP_FAILED : MODE_STEP;
    if (instance->step_status == fmi2OK)
        clock_advance(&instance->clock, h);
    return instance->step_status;
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    if (c != NULL)
        error(c, "fmi2CancelStep: no step is in progress, fmi2DoStep returns when it is done");
    return fmi2Error;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
{
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2GetStatus))
        return fmi2Error;
    if (value == NULL)
        return error(instance, "fmi2GetStatus: value is NULL");
    if (s != fmi2DoStepStatus)
        return discard(instance, "fmi2GetStatus: only fmi2DoStepStatus is a status");
    *value = instance->step_status;
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2GetRealStatus))
        return fmi2Error;
    if (value == NULL)
        return error(instance, "fmi2GetRealStatus: value is NULL");
    if (s != fmi2LastSuccessfulTime)
        return discard(instance, "fmi2GetRealStatus: only fmi2LastSuccessfulTime is a Real");
    *value = clock_now(&instance->clock);
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value)
{
    (void)s;
    (void)value;
    if (!allowed(c, CALL_fmi2GetIntegerStatus))
        return fmi2Error;
    return discard(c, "fmi2GetIntegerStatus: no status is an Integer");
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2GetBooleanStatus))
        return fmi2Error;
    if (value == NULL)
        return error(instance, "fmi2GetBooleanStatus: value is NULL");
    if (s != fmi2Terminated)
        return discard(instance, "fmi2GetBooleanStatus: only fmi2Terminated is a Boolean");
    *value = fmi2False; /* this model never asks to end the simulation */
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    (void)s;
    (void)value;
    if (!allowed(c, CALL_fmi2GetStringStatus))
        return fmi2Error;
    return discard(c, "fmi2GetStringStatus: no step is ever pending");
}
