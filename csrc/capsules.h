/* Private, for the binding to Python: what ends its capsules that hold Arrow's structs. Python.h
 * is included before. */
#ifndef CANSER_CAPSULES_H
#define CANSER_CAPSULES_H

#include "canser.h"

/* The names that Arrow's PyCapsule interface gives to capsules. */
enum { CAPSULE_SCHEMA, CAPSULE_ARRAY, CAPSULE_STREAM };

static const char *const capsule_names[] = {"arrow_schema", "arrow_array", "arrow_array_stream"};

static void end_schema(PyObject *capsule)
{
    canser_schema_free(
        (struct ArrowSchema *)PyCapsule_GetPointer(capsule, capsule_names[CAPSULE_SCHEMA]));
}

static void end_array(PyObject *capsule)
{
    canser_array_free(
        (struct ArrowArray *)PyCapsule_GetPointer(capsule, capsule_names[CAPSULE_ARRAY]));
}

static void end_stream(PyObject *capsule)
{
    canser_array_stream_free(
        (struct ArrowArrayStream *)PyCapsule_GetPointer(capsule, capsule_names[CAPSULE_STREAM]));
}

static void (*const capsule_ends[])(PyObject *) = {end_schema, end_array, end_stream};

/* The addresses of a capsule's name and of its destructor, for PyCapsule_New. The binding makes
 * capsules by itself: cffi's calls run without Python's lock. */
static uintptr_t capsule_name(int kind)
{
    return (uintptr_t)capsule_names[kind];
}

static uintptr_t capsule_end(int kind)
{
    return (uintptr_t)capsule_ends[kind];
}

#endif
