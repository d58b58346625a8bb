/* What the driver is told while it watches fmi2DoStep; nothing where watch.c is not linked in. */
#ifndef TC_WATCH_H
#define TC_WATCH_H

#include <stdbool.h>

#ifdef TC_WATCHED
bool watch_ready(void);  /* false if this kernel cannot tell of system calls */
bool watch(bool on);     /* returns what it was */
#else
static inline bool watch_ready(void) { return true; }
static inline bool watch(bool on)
{
    (void)on;
    return false;
}
#endif

#endif
