/* The tests, in the order in which main runs them. */
#ifndef TESTS_H
#define TESTS_H

/* decode.c */
void test_decode(void);
void test_ends(void);

/* chunk.c */
void test_chunks(void);
void test_chunk_clocks(void);
void test_chunk_chains(void);

/* encode.c */
void test_encode(void);
void test_refusals(void);

/* adapter.c */
void test_configure(void);
void test_explain(void);
void test_row_packets(void);

/* timing.c */
void test_times(void);

/* decoder_arguments.c */
void test_decoder_arguments(void);
void test_advance(void);
void test_full_controls(void);

/* chunk_arguments.c */
void test_chunk_arguments(void);
void test_join_arguments(void);

/* encode_arguments.c */
void test_encode_arguments(void);
void test_refuse_arguments(void);

/* adapter_arguments.c */
void test_adapter_arguments(void);

/* timing_arguments.c */
void test_times_arguments(void);

/* tables.c */
void test_tables(void);

/* huge.c */
void test_huge(void);

#endif
