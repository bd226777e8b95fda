"""What is learned depends on the pushes and the seed, not on how many threads compute it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

SOURCES = Path(__file__).resolve().parents[3] / ".src"
SCRIPT = """
import hashlib
import json
import numba
import numpy as np
from slipmap.diagrams.application.demonstration import simulated_hammer
from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.diagnosis.procedure import diagnose
from slipmap.models.inference.identification import identify
from slipmap.models.measurements.push_dataset import Table
from slipmap.planners.settings import PushSettings
from slipmap.planners.robust_push import plan_push

def digest(*arrays):
    return hashlib.sha256(b"".join(np.asarray(array).tobytes() for array in arrays)).hexdigest()

dataset, _ = simulated_hammer(seed=1, fit=4, heldout=2)
belief = identify(dataset.with_fit_pushes(2), hypotheses=4, seed=0).belief
print(numba.get_num_threads())
print(digest(belief.maps.mass, belief.maps.mu, belief.maps.mu_finger, belief.probability))
table = Table("round", (0.0, 0.0), radius=0.5)
push = plan_push(
    belief, np.zeros(3), np.array([0.1, 0.05, 0.3]), table, PushSettings(), np.random.default_rng(2)
)
print(digest(push.predicted, push.gap, push.pushes))
effects = effects_named(["table_tilt", "sensor_latency"])
found = diagnose(dataset, effects=effects, quick=True, seed=0).to_json()
found.pop("seconds", None)
print(digest(json.dumps(found, sort_keys=True)))
"""
"""Fits and the predictions that weigh them, candidates of a push, and a diagnosis: many pushes of many models
in one parallel call."""


def learned_with(threads: int) -> list[str]:
    """Threads that there were, and digests of the belief, the planned push and the diagnosis."""
    result = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env={**os.environ, "PYTHONPATH": str(SOURCES), "NUMBA_NUM_THREADS": str(threads)},
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return result.stdout.split()


def test_one_thread_and_two_learn_plan_and_diagnose_the_same_to_the_bit():
    (one, *alone), (two, *together) = learned_with(1), learned_with(2)
    assert (one, two) == ("1", "2")
    assert len(alone) == 3
    assert alone == together
