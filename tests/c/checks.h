/* Checks that are counted, and the first ones that fail printed. */
#ifndef CHECKS_H
#define CHECKS_H

#include <stdbool.h>
#include <stdio.h>

static unsigned long passed, failed;

static void check(bool holds, const char *what)
{
    passed += holds;
    failed += !holds;
    if (!holds && failed < 10)
        printf("FAILED %s\n", what);
}

/* Print both numbers; return the exit status of the program. */
static int told(void)
{
    printf("%lu passed, %lu failed\n", passed, failed);
    return failed != 0;
}

#endif
