/* What C programs take of a C runtime and Windows itself does not have. mingw's has it, but zig would build that whole
 * runtime for it, which takes minutes. All else is in Windows: the libraries are listed in compile.py. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>

int __fpclassify(double x) { return __builtin_fpclassify(FP_NAN, FP_INFINITE, FP_NORMAL, FP_SUBNORMAL, FP_ZERO, x); }

int vsnprintf(char *text, size_t size, const char *format, va_list arguments)
{
    return __stdio_common_vsprintf(_CRT_INTERNAL_PRINTF_STANDARD_SNPRINTF_BEHAVIOR, text, size, format, NULL,
                                   arguments);
}

int snprintf(char *text, size_t size, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    int length = vsnprintf(text, size, format, arguments);
    va_end(arguments);
    return length;
}

int vfprintf(FILE *file, const char *format, va_list arguments)
{
    return __stdio_common_vfprintf(0, file, format, NULL, arguments);
}

int fprintf(FILE *file, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    int length = vfprintf(file, format, arguments);
    va_end(arguments);
    return length;
}

/* Called when the library is loaded; there is nothing to set up. */
int __stdcall DllMainCRTStartup(void *library, unsigned long reason, void *reserved)
{
    (void)library, (void)reason, (void)reserved;
    return 1;
}
