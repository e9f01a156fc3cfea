"""The cffi builder that setup.py names: reads what it binds out of canser.h."""

import re
import sys
from pathlib import Path

import cffi

HERE = Path(__file__).parent
ROOT = HERE.parent

header = (HERE / "canser.h").read_text(encoding="utf-8")
bound = re.search(r"/\* cffi: begin \*/(.*)/\* cffi: end \*/", header, re.DOTALL)
assert bound, "canser.h has lost its cffi region"

ffibuilder = cffi.FFI()
# What follows from the list of protocols is computed by the C compiler.
ffibuilder.cdef("#define CANSER_PACKET_MAX ...\n#define CANSER_BEHIND ...")
ffibuilder.cdef(re.sub(r"\[CANSER_(PACKET_MAX|CONTROL_ROOM)\]", "[...]", bound.group(1)))
# The capsules of Python for tables.
ffibuilder.cdef("""
enum { CAPSULE_SCHEMA, CAPSULE_ARRAY, CAPSULE_STREAM };
uintptr_t capsule_name(int kind);
uintptr_t capsule_end(int kind);
""")
ffibuilder.set_source(
    "canser._core._lib",
    '#include "canser.h"\n#include "capsules.h"',
    sources=sorted(path.relative_to(ROOT).as_posix() for path in HERE.rglob("*.c")),
    include_dirs=[HERE.relative_to(ROOT).as_posix()],
    depends=sorted(path.relative_to(ROOT).as_posix() for path in HERE.glob("*.h")),
    # Times are computed with floats. Without joint steps of multiplication and addition they are
    # the same on every processor.
    extra_compile_args=(
        ["/O2", "/std:c11"] if sys.platform == "win32" else ["-O3", "-std=c11", "-ffp-contract=off"]
    ),
)
