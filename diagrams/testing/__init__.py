"""Scripted tests of a cell, real or its twin: see docs/hardware-tests.md.

In pytest, `pytest_plugins = ["slipmap.diagrams.testing.pytest_plugin"]` in the outermost conftest.py gives
the fixtures `cell`, `scenario`, `faults`, `explored` and `pushes`. Without it, `open_cell` gives the cell.
"""

import lazy_loader

# The processes that modules of this package run as need little of it, and should start fast.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
