#define _DEFAULT_SOURCE /* sigaction, where -std=c11 hides it */
#define _DARWIN_C_SOURCE

#include "checks.h"
#include "plain.h"

#include <signal.h>
#include <stdio.h>
#include <string.h>

enum { FAILURES_SHOWN = 10 };

place_of_test now;

static unsigned long long passed, failed;

void begin_part(const char *part)
{
    now = (place_of_test){.part = part};
}

static void print_now(FILE *to)
{
    fprintf(to, "%s, %s, kind %d, len %zu, shift %zu, frame_cap %zu, control_cap %zu, at the %s\n",
            now.part, plain_format_of(now.protocol)->name, now.kind, now.len, now.shift,
            now.frame_cap, now.control_cap, now.at_end ? "end" : "start");
}

void check(bool holds, const char *what)
{
    if (holds) {
        passed++;
    } else if (failed++ < FAILURES_SHOWN) {
        printf("FAILED %s: ", what);
        print_now(stdout);
    }
}

bool report_checks(void)
{
    printf("%llu passed, %llu failed\n", passed, failed);
    return failed > 0;
}

static struct sigaction before_fault[2];

/* A guard page was touched: say where the test is, then let the fault happen
 * again for its former handler: that of the system or of a sanitizer. */
static void on_fault(int number)
{
    fprintf(stderr, "FAILED touched memory that is not its own: ");
    print_now(stderr);
    sigaction(SIGSEGV, &before_fault[0], NULL);
    sigaction(SIGBUS, &before_fault[1], NULL);
    (void)number;
}

void catch_faults(void)
{
    struct sigaction action;

    memset(&action, 0, sizeof action);
    action.sa_handler = on_fault;
    sigemptyset(&action.sa_mask);
    sigaction(SIGSEGV, &action, &before_fault[0]);
    sigaction(SIGBUS, &action, &before_fault[1]);
}
