"""Scripted tests of a cell, real or its twin: see docs/hardware-tests.md.

In pytest, `pytest_plugins = ["slipmap.diagrams.testing.pytest_plugin"]` in the outermost conftest.py gives
the fixtures `cell`, `scenario`, `faults`, `explored` and `pushes`. Without it, `open_cell` gives the cell.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slipmap.diagrams.testing.assertions import (
        assert_alarm,
        assert_better_than_uniform,
        assert_held,
        assert_limits_kept,
        assert_names,
        assert_predicts,
        assert_quiet,
    )
    from slipmap.diagrams.testing.cell import LOCKSTEP, TWIN, Cell, Faults, open_cell, small_scenario
    from slipmap.diagrams.testing.command_log import CommandLog
    from slipmap.diagrams.testing.faults import Fault

__all__ = [
    "LOCKSTEP", "TWIN", "Cell", "CommandLog", "Fault", "Faults", "assert_alarm", "assert_better_than_uniform",
    "assert_held", "assert_limits_kept", "assert_names", "assert_predicts", "assert_quiet", "open_cell",
    "small_scenario",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    # The processes that modules of this package run as need little of it, and should start fast.
    if name not in __all__:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    home = {"CommandLog": "command_log", "Fault": "faults"}
    module = "assertions" if name.startswith("assert_") else home.get(name, "cell")
    return getattr(import_module(f"{__name__}.{module}"), name)
