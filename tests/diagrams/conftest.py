"""A small demo, made once, and beliefs that need no fitting."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from browser import Browser, chromium
from hidden_effects import tilted_pushes
from schemas import assert_json_as_described

from slipmap.diagrams.application.command_line import run
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements import write_dataset
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


@pytest.fixture(scope="session")
def demo_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `slipmap demo` leaves behind with three pushes to learn from and one held out."""
    folder = tmp_path_factory.mktemp("demo")
    arguments = [
        "demo",
        "-o",
        folder / "demo",
        "--fit-pushes",
        3,
        "--heldout-pushes",
        1,
        "--json",
        folder / "demo.json",
    ]
    assert run([str(argument) for argument in arguments]) == 0
    return folder


@pytest.fixture(scope="session")
def tilted_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The pushes on a tilted table as a folder."""
    return write_dataset(tilted_pushes(), tmp_path_factory.mktemp("tilted") / "tilted")


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """A browser for all pages; tests that need one skip where there is none, and say what is missing."""
    if chromium() is None:
        pytest.skip("no chromium to open pages in; on Debian: apt-get install chromium")
    with Browser() as started:
        yield started


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
