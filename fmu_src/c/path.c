/* From fmuResourceLocation to the content of a file in it.

   The standard asks for an encoded URI; importers also pass un-encoded URIs and plain paths, so the name is tried
   decoded first and then as it stands. */
#include "instance.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>

static FILE *open_utf8(const char *path)
{
    /* Some importers pass a plain path in the system's code page instead of UTF-8. */
    UINT page = CP_UTF8;
    int n = MultiByteToWideChar(page, MB_ERR_INVALID_CHARS, path, -1, NULL, 0);
    if (n == 0) {
        page = CP_ACP;
        n = MultiByteToWideChar(page, 0, path, -1, NULL, 0);
    }
    wchar_t *wide = calloc((size_t)n + 1, sizeof *wide);
    if (wide == NULL)
        return NULL;
    MultiByteToWideChar(page, 0, path, -1, wide, n);
    FILE *file = _wfopen(wide, L"rb");
    free(wide);
    return file;
}
#else
static FILE *open_utf8(const char *path) { return fopen(path, "rb"); }
#endif

static int hex(char c)
{
    if (c >= '0' && c <= '9')
        return c - '0';
    c |= 0x20;
    return c >= 'a' && c <= 'f' ? c - 'a' + 10 : -1;
}

static void percent_decode(char *text)
{
    char *to = text;
    for (const char *from = text; *from != '\0'; to++) {
        if (from[0] == '%' && hex(from[1]) >= 0 && hex(from[2]) >= 0) {
            *to = (char)(16 * hex(from[1]) + hex(from[2]));
            from += 3;
        } else {
            *to = *from++;
        }
    }
    *to = '\0';
}

static bool has_scheme(const char *location)
{
    static const char scheme[] = "file:";
    for (size_t i = 0; scheme[i] != '\0'; i++)
        if ((location[i] | 0x20) != (scheme[i] | 0x20))
            return false;
    return true;
}

/* The path in a location; what it returns points into the location. */
static const char *strip_uri(const char *location)
{
    if (!has_scheme(location))
        return location;
    const char *path = location + strlen("file:");
    if (path[0] == '/' && path[1] == '/') {
        const char *host = path + 2;
        const char *slash = strchr(host, '/');
        size_t n = slash == NULL ? strlen(host) : (size_t)(slash - host);
        bool local = n == 0 || (n == 9 && strncmp(host, "localhost", 9) == 0);
#ifdef _WIN32
        bool drive = n == 2 && host[1] == ':'; /* file://C:/..., a common slip */
        if (drive)
            path = host;
        else if (local && slash != NULL)
            path = slash; /* else //host/share stays as it is: a UNC path */
#else
        (void)local; /* a file can only be read here, whatever the host is called */
        if (slash != NULL)
            path = slash;
#endif
    }
#ifdef _WIN32
    if (path[0] == '/' && path[1] != '\0' && path[2] == ':')
        path++; /* "/C:/..." */
#endif
    return path;
}

static void *read_all(FILE *file, size_t *bytes)
{
    if (fseek(file, 0, SEEK_END) != 0)
        return NULL;
    long size = ftell(file);
    if (size < 0 || fseek(file, 0, SEEK_SET) != 0)
        return NULL;
    *bytes = (size_t)size;
    void *memory = malloc(*bytes + 1);
    if (memory != NULL && fread(memory, 1, *bytes, file) != *bytes) {
        free(memory);
        memory = NULL;
    }
    return memory;
}

void *read_resource(const char *location, const char *file, size_t *bytes, char *why, size_t why_size)
{
    if (location == NULL || location[0] == '\0') {
        snprintf(why, why_size,
                 "fmuResourceLocation is %s: this FMU reads %s from its resources directory. Pass the location of the "
                 "unpacked resources, for example file:///unpacked/resources",
                 location == NULL ? "NULL" : "empty", file);
        return NULL;
    }
    const char *path = strip_uri(location);
    size_t n = strlen(path) + strlen(file) + 2;
    char *full = malloc(n);
    if (full == NULL) {
        snprintf(why, why_size, "out of memory");
        return NULL;
    }
    FILE *opened = NULL;
    for (int decoded = path == location ? 0 : 1; decoded >= 0 && opened == NULL; decoded--) {
        strcpy(full, path);
        if (decoded)
            percent_decode(full);
        size_t end = strlen(full);
        snprintf(full + end, n - end, "%s%s", end > 0 && full[end - 1] == '/' ? "" : "/", file);
        opened = open_utf8(full);
    }
    void *memory = NULL;
    if (opened == NULL) {
        snprintf(why, why_size, "cannot open %s (fmuResourceLocation is %s). Unpack the whole FMU, resources included",
                 full, location);
    } else {
        memory = read_all(opened, bytes);
        if (memory == NULL)
            snprintf(why, why_size, "cannot read %s", full);
        fclose(opened);
    }
    free(full);
    return memory;
}
