"""The compiled module, as cffi makes it from csrc/canser.h."""

from typing import Any

ffi: Any
lib: Any
