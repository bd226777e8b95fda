"""Commands run in this process, and a belief that needs no fitting."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from schemas import assert_json_as_described

from slipmap.diagrams.application.command_line import run
from slipmap.models.inference.belief import Belief
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Maps, Smoothing


@dataclass(frozen=True)
class Said:
    """Exit code of a command and what it wrote."""

    code: int
    out: str
    err: str


@pytest.fixture
def slipmap(capsys: pytest.CaptureFixture[str]) -> Callable[..., Said]:
    """Runs `slipmap` with arguments in this process; what it writes with --json must fit its schema."""

    def command(*arguments: object) -> Said:
        words = [str(argument) for argument in arguments]
        code = run(words)
        if code == 0:
            assert_json_as_described(words)
        return Said(code, *capsys.readouterr())

    return command


@pytest.fixture
def belief() -> Belief:
    """Four hypotheses about a block of 6 × 4 cells whose masses lean to different sides."""
    grid = cells_from_polygon(np.array([[-3, -2], [3, -2], [3, 2], [-3, 2]]) * 0.01, width=0.01)
    lean = np.array([-0.5, 0.0, 0.3, 0.6])[:, None]
    mass = 0.02 * (1.0 + lean * grid.centers[:, 0] / 0.03)
    mu = 0.3 * (1.0 - 0.5 * lean * grid.centers[:, 1] / 0.02)
    return Belief(
        grid=grid,
        finger_radius=0.005,
        gravity=9.81,
        maps=Maps(mass, mu, np.full(4, 0.3)),
        probability=np.array([0.1, 0.4, 0.3, 0.2]),
        smoothing=Smoothing(),
        dataset="block",
        fingerprint="0",
        method="gauss-newton",
        seed=0,
    )
