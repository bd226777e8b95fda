"""What trials of the tests do."""

from __future__ import annotations

import os
import signal
import time
from typing import Any

import numpy as np


def draw(*, seed: int, scale: float) -> dict[str, Any]:
    return {"value": scale * float(np.random.default_rng(seed).standard_normal()), "process": "any"}


def slow_draw(*, seed: int, scale: float) -> dict[str, Any]:
    time.sleep(0.02 * (seed % 3))
    return draw(seed=seed, scale=scale)


def fail(*, seed: int, scale: float) -> dict[str, Any]:
    if seed == 2:
        raise RuntimeError(f"seed {seed}\nis bad")
    return draw(seed=seed, scale=scale)


def die(*, seed: int, scale: float) -> dict[str, Any]:
    if seed == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return draw(seed=seed, scale=scale)


def die_beside_another(*, seed: int, scale: float) -> dict[str, Any]:
    """Seed 2 dies while the other ones are under way."""
    time.sleep(0.1 if seed == 2 else 1.0)
    return die(seed=seed, scale=scale)


def not_plain(*, seed: int, scale: float) -> object:
    return float("nan")
