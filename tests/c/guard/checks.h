/* What is counted and printed: checks, and where the test is. */
#ifndef CHECKS_H
#define CHECKS_H

#include <stdbool.h>
#include <stddef.h>

/* Where the test is: what a failure and a fault print. Where its memory lies, as arena.h has it. */
typedef struct {
    const char *part;
    int protocol;
    int kind;
    size_t len, shift, frame_cap, control_cap;
    bool at_end;
} place_of_test;

extern place_of_test now;

/* Start a part of the test: all else of `now` is 0. */
void begin_part(const char *part);

/* Count, and print the first failures. */
void check(bool holds, const char *what);

/* From here on a guard page that is touched prints where the test is. */
void catch_faults(void);

/* Print the closing line. Returns whether a check has failed. */
bool report_checks(void);

#endif
