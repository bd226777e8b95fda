"""The pytest plugin for scripted tests of a cell: options, marker and fixtures.

Nothing heavy is imported before a test asks for a fixture.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from slipmap.diagrams.loops.exploration_loop import LoopOptions
    from slipmap.diagrams.loops.exploration_run import ExplorationRun
    from slipmap.diagrams.station.scenario import Scenario
    from slipmap.diagrams.testing.cell import Cell, Faults
    from slipmap.models.measurements import PushDataset


def pytest_addoption(parser: pytest.Parser) -> None:
    """The cell that tests get."""
    group = parser.getgroup("slipmap", "scripted tests of a robot's cell")
    group.addoption(
        "--cell", metavar="twin|lockstep|URL",
        help="what tests drive: a twin in a process of its own, for each test a new one; a twin that steps"
        " together with what drives it, which needs no real time; or the LCM address of a real cell"
        " [default: the ini option slipmap_cell, or twin]",
    )  # fmt: skip
    group.addoption(
        "--cell-scenario", type=Path, metavar="FILE",
        help="scenario that says what the cell is like; a real one needs it",
    )  # fmt: skip
    parser.addini("slipmap_cell", "what tests drive where --cell is not given", default="twin")


def pytest_configure(config: pytest.Config) -> None:
    """The marker of tests that take minutes."""
    config.addinivalue_line("markers", "twin: drives a cell for minutes")


@pytest.fixture
def scenario(pytestconfig: pytest.Config) -> Scenario:
    """What the cell is like: that of --cell-scenario, else a small one. A test module overrides this fixture
    to lay something else on the table."""
    from slipmap.diagrams.station.scenario import ScenarioError, read_scenario
    from slipmap.diagrams.testing.cell import small_scenario

    path = pytestconfig.getoption("--cell-scenario")
    if path is None:
        return small_scenario(_where(pytestconfig))
    try:
        return read_scenario(path)
    except ScenarioError as error:
        raise pytest.UsageError(f"--cell-scenario: {error}") from error


@pytest.fixture
def cell(request: pytest.FixtureRequest, scenario: Scenario, tmp_path: Path) -> Iterator[Cell]:
    """The cell, with an object on its table; on a real one somebody is asked to lay it there."""
    from slipmap.diagrams.perception.renderer import RendererUnavailable, require_renderer
    from slipmap.diagrams.testing.cell import LOCKSTEP, TWIN, open_cell

    where = _where(request.config)
    if where in (TWIN, LOCKSTEP):
        try:
            require_renderer()
        except RendererUnavailable as reason:
            pytest.skip(str(reason))
    elif request.config.getoption("--cell-scenario") is None:
        raise pytest.UsageError(f"--cell {where}: --cell-scenario FILE must say what that cell is like")
    else:
        _ask_for(request, scenario)
    with open_cell(where, tmp_path, scenario, faulty="faults" in request.fixturenames) as opened:
        yield opened


@pytest.fixture
def faults(cell: Cell) -> Faults:
    """What is to go wrong with the cell's messages."""
    return cell.faults


@pytest.fixture
def exploration() -> LoopOptions:
    """How `explored` explores; override it for other numbers of pushes."""
    from slipmap.diagrams.loops.exploration_loop import LoopOptions

    return LoopOptions(pushes=3, checks=1)


@pytest.fixture
def explored(cell: Cell, exploration: LoopOptions) -> ExplorationRun:
    """What the robot learned of the object on the table."""
    return cell.explore(**vars(exploration))


@pytest.fixture
def pushes(explored: ExplorationRun) -> PushDataset:
    """The pushes that it recorded."""
    return explored.dataset


def _where(config: pytest.Config) -> str:
    return str(config.getoption("--cell") or config.getini("slipmap_cell"))


def _ask_for(request: pytest.FixtureRequest, scenario: Scenario) -> None:
    """Have the object laid on a real table, and what the scenario hides be brought about."""
    hidden = "" if scenario.hidden.is_null else f" and bring about {scenario.hidden}"
    sentence = f"Lay the {scenario.object.called} on the table{hidden}, then press Enter."
    capture = request.config.pluginmanager.getplugin("capturemanager")
    assert capture is not None
    capture.suspend_global_capture(in_=True)
    try:
        if sys.stdin.isatty():
            input(f"\n{request.node.name}: {sentence} ")
            return
    finally:
        capture.resume_global_capture()
    if hidden:
        pytest.skip("nobody is at the terminal to bring about what the scenario hides")
