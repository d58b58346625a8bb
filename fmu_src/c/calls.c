/* Which call is allowed in which mode. */
#include "instance.h"

#include <string.h>

static const struct {
    const char *name;
    unsigned modes;
} calls[] = {
#define CALL(name, modes) {#name, modes},
#include "calls.def"
#undef CALL
};

static const struct {
    Mode mode;
    const char *name;
} modes[] = {
    {MODE_INSTANTIATED, "Instantiated"},
    {MODE_INITIALIZATION, "Initialization Mode"},
    {MODE_STEP, "Step Mode"},
    {MODE_STEP_FAILED, "Step Mode after a discarded step"},
    {MODE_TERMINATED, "Terminated"},
};

enum { MODE_COUNT = sizeof modes / sizeof modes[0] };

/* True if the instance may be called so now; else says so in the log. */
bool allowed(Instance *instance, Call call)
{
    if (instance == NULL)
        return false;
    if (calls[call].modes & instance->mode)
        return true;
    const char *now = "";
    char where[160] = "";
    for (int i = 0; i < MODE_COUNT; i++) {
        if (modes[i].mode == instance->mode)
            now = modes[i].name;
        if (calls[call].modes & modes[i].mode) {
            if (where[0] != '\0')
                strcat(where, ", "); /* all names together fit */
            strcat(where, modes[i].name);
        }
    }
    error(instance, "%s may not be called in %s, only in: %s. Nothing was changed", calls[call].name, now, where);
    return false;
}
