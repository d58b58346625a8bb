/* Messages for the importer, only through its callback. */
#include "instance.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

enum { TEXT_SIZE = 1024 };

static const struct {
    Category category;
    const char *name;
} categories[] = {TC_CATEGORIES};

enum { CATEGORY_COUNT = sizeof categories / sizeof categories[0] };

static const char *category_name(Category category)
{
    for (int i = 0; i < CATEGORY_COUNT; i++)
        if (categories[i].category == category)
            return categories[i].name;
    return "";
}

static void log_list(Instance *instance, fmi2Status status, Category category, const char *format, va_list arguments)
{
    if (instance->callbacks.logger == NULL || !(instance->categories & category))
        return;
    char text[TEXT_SIZE];
    vsnprintf(text, sizeof text, format, arguments);
    /* '#' begins a variable reference in an FMI message, "##" is the character itself. */
    char escaped[2 * TEXT_SIZE];
    size_t n = 0;
    for (const char *c = text; *c != '\0'; c++) {
        if (*c == '#')
            escaped[n++] = '#';
        escaped[n++] = *c;
    }
    escaped[n] = '\0';
    /* The text goes as an argument: a '%' in it must not be read as a format. */
    instance->callbacks.logger(instance->callbacks.componentEnvironment, instance->name, status,
                               category_name(category), "%s", escaped);
}

void log_message(Instance *instance, fmi2Status status, Category category, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    log_list(instance, status, category, format, arguments);
    va_end(arguments);
}

fmi2Status error(Instance *instance, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    log_list(instance, fmi2Error, LOG_ERROR, format, arguments);
    va_end(arguments);
    return fmi2Error;
}

fmi2Status discard(Instance *instance, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    log_list(instance, fmi2Discard, LOG_DISCARD, format, arguments);
    va_end(arguments);
    return fmi2Discard;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String names[])
{
    Instance *instance = c;
    if (!allowed(instance, CALL_fmi2SetDebugLogging))
        return fmi2Error;
    if (!loggingOn) {
        instance->categories = 0;
        return fmi2OK;
    }
    if (nCategories == 0) {
        instance->categories = LOG_ALL;
        return fmi2OK;
    }
    if (names == NULL)
        return error(instance, "fmi2SetDebugLogging: the list of categories is NULL. Nothing was changed");
    unsigned chosen = 0;
    for (size_t i = 0; i < nCategories; i++) {
        unsigned found = 0;
        for (int k = 0; k < CATEGORY_COUNT; k++)
            if (names[i] != NULL && strcmp(names[i], categories[k].name) == 0)
                found = categories[k].category;
        if (found == 0)
            return error(instance,
                         "fmi2SetDebugLogging: there is no log category \"%s\"; modelDescription.xml lists those there "
                         "are. Nothing was changed",
                         names[i] == NULL ? "NULL" : names[i]);
        chosen |= found;
    }
    instance->categories = chosen;
    return fmi2OK;
}
