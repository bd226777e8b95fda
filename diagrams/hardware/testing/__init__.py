"""Scripted tests of a cell, real or its twin: see docs/hardware-tests.md.

In pytest, `pytest_plugins = ["diagrams.hardware.pytest_plugin"]` in the outermost conftest.py gives the
fixtures `cell`, `scenario`, `faults`, `explored` and `pushes`. Without pytest, `open_cell` gives the cell.
"""

from diagrams.hardware.testing.assertions import (
    assert_alarm,
    assert_better_than_uniform,
    assert_held,
    assert_limits_kept,
    assert_names,
    assert_predicts,
    assert_quiet,
)
from diagrams.hardware.testing.cell import LOCKSTEP, TWIN, Cell, Faults, open_cell, small_scenario
from diagrams.hardware.testing.command_log import CommandLog
from diagrams.hardware.testing.faults import Fault

__all__ = [
    "LOCKSTEP",
    "TWIN",
    "Cell",
    "CommandLog",
    "Fault",
    "Faults",
    "assert_alarm",
    "assert_better_than_uniform",
    "assert_held",
    "assert_limits_kept",
    "assert_names",
    "assert_predicts",
    "assert_quiet",
    "open_cell",
    "small_scenario",
]
