"""Threads of the workers, and fixtures shared by all tests."""

import os
from pathlib import Path

import pytest

# Before numpy and numba are loaded: two workers have two cores. With BLAS threads that wait for each other,
# a diagnosis took 19 times as long on a machine that had something else to do.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture
def shared_data() -> Path:
    """Folder of measured pushes that lies beside the checkout; tests that need it skip where it is absent."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"no measured pushes at {SHARED_DATA}; they are not part of the project")
    return SHARED_DATA
