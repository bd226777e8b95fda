"""slipmap finds out how an unknown object slides: maps of mass and friction from a few pushes.

What most scripts and notebooks need is offered here, each name loaded when it is first used:

>>> import slipmap
>>> dataset, truth = slipmap.simulated_hammer(seed=1)
>>> len(dataset.fit_trials), len(dataset.grid)
(6, 60)

`docs/python.md` has a line on each name; `__init__.pyi` says where each lies. The rest lies in
`slipmap.models` (what the world is), `slipmap.planners` (what to do) and `slipmap.diagrams` (Drake blocks and
the application).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
