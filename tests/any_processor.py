"""Imported before numpy and numba, this lets x86 processors since Haswell round numbers alike.

BLAS and NumPy have code of their own for each processor, and Numba compiles for the one at hand. Sums are
rounded in another order there: a search of many steps ends elsewhere within the noise, and recorded outputs
differ in their second digit.

`python tests/any_processor.py COMMAND …` runs a command so.
"""

import os
import platform
import sys

if platform.machine().lower() in ("x86_64", "amd64"):
    os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")
    os.environ.setdefault("OPENBLAS_L2_SIZE", "512")
    os.environ.setdefault("NUMBA_CPU_NAME", "haswell")
    os.environ.setdefault("NUMBA_CPU_FEATURES", "+avx2,+bmi,+bmi2,+f16c,+fma,+lzcnt,+movbe,+popcnt,+sse4.2")
    # By the names of several versions; those that a version or a processor does not have are ignored.
    os.environ.setdefault(
        "NPY_DISABLE_CPU_FEATURES",
        "X86_V4 AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR",
    )

if __name__ == "__main__":
    os.execv(sys.argv[1], sys.argv[1:])
