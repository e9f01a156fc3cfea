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

#endif
