"""Imported before numpy, this lets BLAS round alike on all processors of a kind.

BLAS has kernels of its own for each processor. A search of many steps then ends elsewhere within the noise,
and recorded outputs differ in their second digit. The kernels for Haswell run on all x86 processors of the
last ten years.
"""

import os
import platform

if platform.machine().lower() in ("x86_64", "amd64"):
    os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")
    os.environ.setdefault("OPENBLAS_L2_SIZE", "512")
