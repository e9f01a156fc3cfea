/* Private: memory for tables and blocks, which several own together. */
#ifndef CANSER_MEMORY_H
#define CANSER_MEMORY_H

#include <stddef.h>

/* Memory for `size` bytes, which are not set, at a multiple of 16; or NULL. */
void *canser_memory_get(size_t size);

/* Give memory back. NULL is allowed. From any thread. */
void canser_memory_release(void *p);

#endif
