"""The parts of the build that pyproject.toml cannot say: the extension and its ABI tag."""

import shutil
import sys
import sysconfig
from pathlib import Path

from setuptools import setup
from setuptools.command.build_ext import build_ext
from setuptools.errors import PlatformError

# How to get a C compiler, by sys.platform.
GET_COMPILER = {
    "darwin": "xcode-select --install",
    "win32": "install the Build Tools for Visual Studio, 'Desktop development with C++'",
}
GET_COMPILER_LINUX = "on Debian or Ubuntu: apt install build-essential"
GET_HEADERS = "on Debian or Ubuntu: apt install python3-dev"


class BuildExt(build_ext):
    """Builds the extension, and says in a line what is missing where it cannot."""

    def build_extensions(self) -> None:
        """Look for the compiler and Python's headers, then build."""
        # The words of its command; Microsoft's compiler has none, and is looked for by the build.
        command = getattr(self.compiler, "compiler_so", None)
        if command and shutil.which(command[0]) is None:
            self._end_without_compiler(f"there is no {command[0]}")
        header = Path(sysconfig.get_path("include"), "Python.h")
        if not header.exists():
            sys.exit(f"canser: the headers of Python are missing ({header}); {GET_HEADERS}")
        try:
            super().build_extensions()
        except PlatformError as error:
            self._end_without_compiler(str(error).splitlines()[0])

    @staticmethod
    def _end_without_compiler(why: str) -> None:
        remedy = GET_COMPILER.get(sys.platform, GET_COMPILER_LINUX)
        sys.exit(f"canser: a C compiler is needed, and {why}; {remedy}")


# One wheel for every CPython from 3.11 on. A free-threaded build has no stable
# ABI before 3.15, and cffi then builds for that one version.
free_threaded = bool(sysconfig.get_config_var("Py_GIL_DISABLED"))
options = {} if free_threaded else {"bdist_wheel": {"py_limited_api": "cp311"}}

setup(
    cffi_modules=["csrc/build_ffi.py:ffibuilder"],
    cmdclass={"build_ext": BuildExt},
    options=options,
)
