"""Scripted tests of a real cell or its twin: see docs/hardware-tests.md.

In pytest, `pytest_plugins = ["slipmap.diagrams.testing.pytest_plugin"]` in the outermost conftest.py provides
the fixtures `cell`, `scenario`, `faults`, `explored` and `pushes`. Without pytest, `open_cell` opens the
cell.
"""

import lazy_loader

# Modules of this package also run as processes, which need little of it and should start fast.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
