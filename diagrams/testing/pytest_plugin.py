"""The pytest plugin for scripted tests of a cell: options, marker and fixtures.

Heavy modules are imported only when a test uses a fixture.
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
    """Add the options that choose the cell for tests."""
    group = parser.getgroup("slipmap", "scripted tests of a robot cell")
    group.addoption(
        "--cell", metavar="twin|lockstep|URL",
        help="the cell that tests drive: a twin in a separate process, a new one for each test; a twin that"
        " steps in lockstep with its driver and needs no real time; or the LCM address of a real cell"
        " [default: the ini option slipmap_cell, or twin]",
    )  # fmt: skip
    group.addoption(
        "--cell-scenario", type=Path, metavar="FILE",
        help="scenario of the cell; required for a real one",
    )  # fmt: skip
    parser.addini("slipmap_cell", "the cell that tests drive if --cell is not given", default="twin")


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker of tests that take minutes."""
    config.addinivalue_line("markers", "twin: drives a cell for minutes")


@pytest.fixture
def scenario(pytestconfig: pytest.Config) -> Scenario:
    """The cell's scenario: that of --cell-scenario, else a small one. Override this fixture in a test module
    to put something else on the table."""
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
    """The cell with an object on its table; for a real one, a person is asked to put it there."""
    from slipmap.diagrams.perception.renderer import RendererUnavailable, require_renderer
    from slipmap.diagrams.testing.cell import LOCKSTEP, TWIN, check_where, open_cell

    where = _where(request.config)
    try:
        check_where(where)
    except ValueError as error:
        raise pytest.UsageError(f"--cell: {error}") from error
    if where in (TWIN, LOCKSTEP):
        try:
            require_renderer()
        except RendererUnavailable as reason:
            pytest.skip(str(reason))
    elif request.config.getoption("--cell-scenario") is None:
        raise pytest.UsageError(f"--cell {where}: give that cell's scenario with --cell-scenario FILE")
    else:
        _ask_for(request, scenario)
    with open_cell(where, tmp_path, scenario, faulty="faults" in request.fixturenames) as opened:
        yield opened


@pytest.fixture
def faults(cell: Cell) -> Faults:
    """Faults to inject into the cell's messages."""
    return cell.faults


@pytest.fixture
def exploration() -> LoopOptions:
    """Options of `explored`; override this fixture for other numbers of pushes."""
    from slipmap.diagrams.loops.exploration_loop import LoopOptions

    return LoopOptions(pushes=3, checks=1)


@pytest.fixture
def explored(cell: Cell, exploration: LoopOptions) -> ExplorationRun:
    """The robot's exploration of the object on the table."""
    return cell.explore(**vars(exploration))


@pytest.fixture
def pushes(explored: ExplorationRun) -> PushDataset:
    """The pushes that it recorded."""
    return explored.dataset


def _where(config: pytest.Config) -> str:
    return str(config.getoption("--cell") or config.getini("slipmap_cell"))


def _ask_for(request: pytest.FixtureRequest, scenario: Scenario) -> None:
    """Ask a person to put the object on a real table and to set up the scenario's hidden effects."""
    hidden = "" if scenario.hidden.is_null else f" and set up {scenario.hidden}"
    sentence = f"Put the {scenario.object.called} on the table{hidden}, then press Enter."
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
        pytest.skip("nobody is at the terminal to set up the scenario's hidden effects")
