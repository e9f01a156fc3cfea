/* What canser.h promises of memory: nothing is read outside the input, nothing
 * is written outside the arrays, and the caller's mistakes are found before a
 * byte is touched. Every input and every array lies against a page that may not
 * be touched, once with its end and once with its start. POSIX only.
 *
 *     guard           all but more than 4 GiB in one call
 *     guard --huge    only that: it takes some seconds
 */
#include "checks.h"
#include "streams.h"
#include "tests.h"

#include <stdio.h>
#include <string.h>

int main(int argc, char **argv)
{
    const bool huge = argc > 1 && strcmp(argv[1], "--huge") == 0;

    if (argc > 2 || (argc == 2 && !huge)) {
        fprintf(stderr, "usage: guard [--huge]\n");
        return 2;
    }
    set_up_streams();
    catch_faults();
    if (huge && sizeof(size_t) < sizeof(uint64_t)) {
        printf("skipped: an address space of 32 bits has no 4 GiB\n");
    } else if (huge) {
        test_huge();
    } else {
        test_decode();
        test_ends();
        test_chunks();
        test_chunk_clocks();
        test_chunk_chains();
        test_encode();
        test_refusals();
        test_configure();
        test_explain();
        test_row_packets();
        test_times();
        test_decoder_arguments();
        test_advance();
        test_full_controls();
        test_chunk_arguments();
        test_join_arguments();
        test_encode_arguments();
        test_refuse_arguments();
        test_adapter_arguments();
        test_times_arguments();
        test_tables();
    }
    return report_checks();
}
