/* The compiled kernels: which instruction set to use, and one run of them. */
#include "instance.h"

#include <stdio.h>
#include <string.h>

extern TcEntry tc_initialize_baseline, tc_step_baseline;

#ifdef __x86_64__
#include <cpuid.h>

extern TcEntry tc_initialize_v3, tc_step_v3;

/* x86-64-v3 of the System V ABI supplement: AVX2, BMI, FMA and their kin, with the upper halves of the registers kept
   by the operating system. */
static bool has_v3(void)
{
    unsigned a, b, c, d;
    const unsigned leaf1 = bit_SSE3 | bit_SSSE3 | bit_FMA | bit_CMPXCHG16B | bit_SSE41 | bit_SSE42 | bit_MOVBE |
                           bit_POPCNT | bit_OSXSAVE | bit_AVX | bit_F16C;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & leaf1) != leaf1)
        return false;
    unsigned low, high;
    __asm__("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    const unsigned sse_and_avx_state = 6;
    if ((low & sse_and_avx_state) != sse_and_avx_state)
        return false;
    const unsigned leaf7 = bit_BMI | bit_AVX2 | bit_BMI2;
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || (b & leaf7) != leaf7)
        return false;
    return __get_cpuid(0x80000001, &a, &b, &c, &d) && (c & bit_LZCNT);
}
#endif

Kernel kernel_choose(void)
{
#ifdef __x86_64__
    if (has_v3())
        return (Kernel){tc_initialize_v3, tc_step_v3, "x86-64-v3"};
    return (Kernel){tc_initialize_baseline, tc_step_baseline, "x86-64"};
#else
    return (Kernel){tc_initialize_baseline, tc_step_baseline, "aarch64"};
#endif
}

static const struct {
    const char *name;
    bool discard;
    int slot_block; /* block that the first figure is a slot of; -1: none */
    const char *message;
} statuses[] = {TC_STATUSES};

enum { STATUS_COUNT = sizeof statuses / sizeof statuses[0] };

/* Name of the variable that lies in a slot; "" if there is none. */
static const char *slot_name(const Scene *scene, int block, double slot)
{
    for (uint64_t i = 0; i < scene->variable_count; i++)
        if ((int)scene->variables[i].block == block && scene->variables[i].slot == slot)
            return variable_name(scene, &scene->variables[i]);
    return "";
}

static fmi2Status report(Instance *instance, int32_t code)
{
    if (code < 0 || code >= STATUS_COUNT)
        return error(instance, "the kernels returned the unknown status %d. Please report this", (int)code);
    const double *detail = instance->scratch_real + instance->scene.spans[2 * TC_FIELD_DETAIL];
    char text[512];
    snprintf(text, sizeof text, statuses[code].message, detail[0], detail[1]);
    const char *name =
        statuses[code].slot_block < 0 ? "" : slot_name(&instance->scene, statuses[code].slot_block, detail[0]);
    const char *colon = name[0] == '\0' ? "" : ": ";
    if (statuses[code].discard)
        return discard(instance, "%s%s%s", name, colon, text);
    return error(instance, "%s%s%s", name, colon, text);
}

/* Run an entry; if it fails, everything that persists is as it was and the log says why. h in s. */
fmi2Status kernel_run(Instance *instance, TcEntry *entry, double h)
{
    const Scene *scene = &instance->scene;
    memcpy(instance->backup, instance->live, scene->start_bytes);
    int32_t code = 0;
    void *exception = NULL;
    /* The kernels read the model only; they take all blocks by the same kind of pointer. */
    int32_t raised = entry(&code, &exception, (uint32_t *)(uintptr_t)scene->model_index,
                           (double *)(uintptr_t)scene->model_real, instance->state_index, instance->state_real,
                           instance->scratch_index, instance->scratch_real, (uint64_t *)(uintptr_t)scene->spans,
                           (uint64_t *)(uintptr_t)&scene->sizes, instance->values[BLOCK_PARAMETERS],
                           instance->values[BLOCK_INPUTS], instance->values[BLOCK_OUTPUTS], h);
    if (raised == 0 && code == 0)
        return fmi2OK;
    memcpy(instance->live, instance->backup, scene->start_bytes);
    return report(instance, raised == 0 ? code : -1);
}
