"""The parts of the build that pyproject.toml cannot say: the extension and its ABI tag."""

import sysconfig

from setuptools import setup

# One wheel for every CPython from 3.11 on. A free-threaded build has no stable
# ABI before 3.15, and cffi then builds for that one version.
free_threaded = bool(sysconfig.get_config_var("Py_GIL_DISABLED"))
options = {} if free_threaded else {"bdist_wheel": {"py_limited_api": "cp311"}}

setup(cffi_modules=["csrc/build_ffi.py:ffibuilder"], options=options)
