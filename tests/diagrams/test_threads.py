"""What is learned depends on the pushes and the seed, not on how many threads compute it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = """
import hashlib
import numba
from diagrams.demonstration import simulated_hammer
from models.inference.identification import identify

dataset, _ = simulated_hammer(seed=1)
belief = identify(dataset.with_fit_pushes(2), hypotheses=4, seed=0).belief
numbers = (belief.maps.mass, belief.maps.mu, belief.maps.mu_finger, belief.probability)
print(numba.get_num_threads(), hashlib.sha256(b"".join(array.tobytes() for array in numbers)).hexdigest())
"""
"""The fits, and the predictions that weigh them, are many pushes of many models in one parallel call."""


def learned_with(threads: int) -> tuple[str, str]:
    """Threads that there were, and a digest of the belief."""
    result = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env={**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_NUM_THREADS": str(threads)},
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    count, digest = result.stdout.split()
    return count, digest


def test_one_thread_and_two_learn_the_same_to_the_bit():
    (one, alone), (two, together) = learned_with(1), learned_with(2)
    assert (one, two) == ("1", "2")
    assert alone == together
