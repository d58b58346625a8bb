/* Saved states. A saved state and its serialized form are the same bytes: a header and everything that persists. */
#include "instance.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    char magic[8];
    uint64_t bytes;
    uint64_t layout;
    char guid[64];
    uint64_t checksum; /* of everything after it; 0 until serialized */
    Clock clock;
    uint32_t mode;
    uint32_t stale;
    uint64_t step_status;
} Saved;

static size_t saved_bytes(const Instance *instance) { return sizeof(Saved) + instance->scene.start_bytes; }

static uint64_t saved_checksum(const Saved *saved)
{
    size_t begin = offsetof(Saved, clock);
    return checksum((const unsigned char *)saved + begin, (size_t)saved->bytes - begin);
}

static bool belongs(Instance *instance, const char *call, const Saved *saved)
{
    if (memcmp(saved->magic, TC_STATE_MAGIC, sizeof saved->magic) != 0)
        error(instance, "%s: this is not a state of such an FMU. Nothing was changed", call);
    else if (saved->layout != TC_LAYOUT_HASH || memcmp(saved->guid, instance->scene.guid, sizeof saved->guid) != 0)
        error(instance, "%s: this is the state of another FMU, %.63s; this one is %s. Nothing was changed", call,
              saved->guid, instance->scene.guid);
    else if (saved->bytes != saved_bytes(instance))
        error(instance, "%s: the state has %llu bytes, %llu are expected. Nothing was changed", call,
              (unsigned long long)saved->bytes, (unsigned long long)saved_bytes(instance));
    else
        return true;
    return false;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2GetFMUstate))
        return fmi2Error;
    if (FMUstate == NULL)
        return error(instance, "fmi2GetFMUstate: the pointer is NULL");
    if (*FMUstate != NULL && !belongs(instance, "fmi2GetFMUstate", *FMUstate))
        return fmi2Error;
    Saved *saved = *FMUstate != NULL ? *FMUstate : calloc(1, saved_bytes(instance));
    if (saved == NULL)
        return error(instance, "fmi2GetFMUstate: out of memory");
    memcpy(saved->magic, TC_STATE_MAGIC, sizeof saved->magic);
    saved->bytes = saved_bytes(instance);
    saved->layout = TC_LAYOUT_HASH;
    memcpy(saved->guid, instance->scene.guid, sizeof saved->guid);
    saved->clock = instance->clock;
    saved->mode = instance->mode;
    saved->stale = instance->stale;
    saved->step_status = instance->step_status;
    memcpy(saved + 1, instance->live, instance->scene.start_bytes);
    *FMUstate = saved;
    return fmi2OK;
}

/* The time of fmi2SetupExperiment's stop is the experiment's and not the state's: it stays. */
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2SetFMUstate))
        return fmi2Error;
    if (FMUstate == NULL)
        return error(instance, "fmi2SetFMUstate: the state is NULL. Nothing was changed");
    const Saved *saved = FMUstate;
    if (!belongs(instance, "fmi2SetFMUstate", saved))
        return fmi2Error;
    instance->clock = saved->clock;
    instance->mode = (Mode)saved->mode;
    instance->stale = saved->stale;
    instance->step_status = (fmi2Status)saved->step_status;
    memcpy(instance->live, saved + 1, instance->scene.start_bytes);
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2FreeFMUstate))
        return fmi2Error;
    if (FMUstate == NULL || *FMUstate == NULL)
        return fmi2OK;
    if (!belongs(instance, "fmi2FreeFMUstate", *FMUstate))
        return fmi2Error;
    free(*FMUstate);
    *FMUstate = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2SerializedFMUstateSize))
        return fmi2Error;
    if (FMUstate == NULL || size == NULL)
        return error(instance, "fmi2SerializedFMUstateSize: a pointer is NULL");
    if (!belongs(instance, "fmi2SerializedFMUstateSize", FMUstate))
        return fmi2Error;
    *size = saved_bytes(instance);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte bytes[], size_t size)
{
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2SerializeFMUstate))
        return fmi2Error;
    if (FMUstate == NULL || bytes == NULL)
        return error(instance, "fmi2SerializeFMUstate: a pointer is NULL");
    Saved *saved = FMUstate;
    if (!belongs(instance, "fmi2SerializeFMUstate", saved))
        return fmi2Error;
    if (size < saved->bytes)
        return error(instance, "fmi2SerializeFMUstate: the vector has %llu bytes, %llu are needed",
                     (unsigned long long)size, (unsigned long long)saved->bytes);
    saved->checksum = saved_checksum(saved);
    memcpy(bytes, saved, (size_t)saved->bytes);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *FMUstate)
{
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2DeSerializeFMUstate))
        return fmi2Error;
    if (bytes == NULL || FMUstate == NULL)
        return error(instance, "fmi2DeSerializeFMUstate: a pointer is NULL");
    if (size < saved_bytes(instance))
        return error(instance, "fmi2DeSerializeFMUstate: the state has %llu bytes, %llu are expected: it is truncated",
                     (unsigned long long)size, (unsigned long long)saved_bytes(instance));
    if (*FMUstate != NULL && !belongs(instance, "fmi2DeSerializeFMUstate", *FMUstate))
        return fmi2Error;
    Saved *saved = malloc(saved_bytes(instance));
    if (saved == NULL)
        return error(instance, "fmi2DeSerializeFMUstate: out of memory");
    memcpy(saved, bytes, saved_bytes(instance)); /* aligned, unlike the caller's bytes */
    if (!belongs(instance, "fmi2DeSerializeFMUstate", saved)) {
        free(saved);
        return fmi2Error;
    }
    if (saved->checksum != saved_checksum(saved)) {
        free(saved);
        return error(instance, "fmi2DeSerializeFMUstate: the checksum differs: the state was altered");
    }
    free(*FMUstate);
    *FMUstate = saved;
    return fmi2OK;
}
