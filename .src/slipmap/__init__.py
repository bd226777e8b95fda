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

from typing import Any

import lazy_loader

_offered, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version(__name__)
    try:
        return _offered(name)
    except AttributeError as error:
        if name.startswith("_") or name in __all__:
            raise
        from difflib import get_close_matches

        near = get_close_matches(name, __all__, n=1)
        hint = f"did you mean {near[0]}?" if near else "dir(slipmap) lists what there is"
        raise AttributeError(f"slipmap has no {name}; {hint}") from error
