"""slipmap learns how an unknown object slides: maps of its mass and friction, from a few pushes.

The names that most scripts and notebooks need are here; each is loaded on first use:

>>> import slipmap
>>> dataset, truth = slipmap.simulated_hammer(seed=1)
>>> len(dataset.fit_trials), len(dataset.grid)
(6, 60)

`docs/python.md` describes each name in one line; `__init__.pyi` shows where each is defined. Everything else
is in `slipmap.models` (the world), `slipmap.planners` (what to do) and `slipmap.diagrams` (Drake blocks and
the application).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
