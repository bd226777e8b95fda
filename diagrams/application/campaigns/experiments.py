"""The experiments that `slipmap campaign` knows, what each has, and what the paper reports of them.

Naming them loads nothing that is large. The paper's numbers are read off the figures and tables of Song and
Boularias (IROS 2020).
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from slipmap.planners.trials import TrialOutcome, TrialSpec


ABOUT = {
    "fig3": "error after pushes chosen by three strategies",
    "fig4": "error of identified maps, a uniform object, and Algorithm 1 as printed",
    "fig5": "stable goals at the table's edge",
    "fig6": "pushing to the table's edge by four methods",
    "fig7": "the whole procedure with arm and camera",
    "tilt": "pushing over a tilted table without and with the tilt in the model",
}
"""Every experiment, named after the paper's figure, and what goes beyond the paper."""

_PLACES = {
    "fig3": "learning_curves:FIGURE_3",
    "fig4": "learning_curves:FIGURE_4",
    "fig5": "stable_goals:FIGURE_5",
    "fig6": "pregrasp_success:FIGURE_6",
    "fig7": "whole_procedure:FIGURE_7",
    "tilt": "tilted_table:TILTED_TABLE",
}


def experiment_of(name: str) -> Experiment:
    """An experiment by its name.

    Raises:
        ValueError: an unknown name.
    """
    if name not in _PLACES:
        raise ValueError(f"experiment {name!r} is unknown; there are {', '.join(_PLACES)}")
    module, attribute = _PLACES[name].split(":")
    experiment: Experiment = getattr(importlib.import_module(f"{__package__}.{module}"), attribute)
    return experiment


@dataclass(frozen=True)
class TableText:
    """A table as it is shown.

    Attributes:
        title: line above it.
        columns: headings.
        rows: cells.
    """

    title: str
    columns: tuple[str, ...]
    rows: list[list[str]]


@dataclass(frozen=True, eq=False)
class Summary:
    """What the trials of a campaign say.

    Attributes:
        tables: with the paper's numbers where it has any.
        remark: on the comparison.
        document: the same for programs.
        figures: draws them.
    """

    tables: list[TableText]
    remark: str
    document: dict[str, Any]
    figures: Callable[[], list[Figure]]


@dataclass(frozen=True)
class Experiment:
    """One experiment of the paper.

    Attributes:
        name: of the figure, such as `fig3`.
        trials: of each object, unless told otherwise.
        specs: trials of (objects, number of trials, first seed, truth).
        summary: of their outcomes; failed ones have no result.
        objects: that are tried, unless told otherwise; all six where empty.
    """

    name: str
    trials: int
    specs: Callable[[Sequence[str], int, int, str], list[TrialSpec]]
    summary: Callable[[Sequence[TrialOutcome]], Summary]
    objects: tuple[str, ...] = ()


def specs_of(
    trial: str,
    objects: Sequence[str],
    trials: int,
    seed: int,
    varied: Mapping[str, Sequence[str]],
    more: Callable[[int], dict[str, Any]] = lambda number: {},
) -> list[TrialSpec]:
    """A trial for every seed, object and variant; all objects early, so that an unfinished campaign has
    something of each.

    Args:
        trial: where its function is, `module:function`.
        objects: names, which it takes as `object_name`.
        trials: of each object and variant.
        seed: the first one.
        varied: a parameter and its values, such as the methods that are compared; or nothing.
        more: further parameters of the trials of a seed.
    """
    from slipmap.planners.trials import TrialSpec

    variants = [{parameter: value} for parameter, values in varied.items() for value in values] or [{}]
    return [
        TrialSpec(
            "-".join([name, *(value.split()[0] for value in variant.values()), str(number)]),
            trial,
            {"object_name": name, **variant, **more(number)},
            number,
        )
        for number in range(seed, seed + trials)
        for name in objects
        for variant in variants
    ]


def as_json(estimates: Any) -> Any:
    """Mappings and lists of estimates for programs."""
    if isinstance(estimates, Mapping):
        return {name: as_json(one) for name, one in estimates.items()}
    return [as_json(one) for one in estimates] if isinstance(estimates, list) else estimates.to_json()


STABLE_GOALS: dict[str, tuple[float, float]] = {
    "probabilistic": (100.0, 100.0),
    "deterministic": (44.0, 78.0),
    "uniform": (35.0, 54.0),
}
"""Figure 5: stable among the goals chosen, %, from the worst object to the best; real objects."""

_OBJECTS = ("book", "box", "hammer", "wrench", "snack", "spray_gun")
_PERCENT = {
    "probabilistic": (87, 91, 100, 97, 81, 89),
    "deterministic": (64, 73, 79, 77, 61, 65),
    "uniform": (42, 56, 58, 58, 42, 41),
    "true": (87, 96, 98, 96, 76, 89),
}
PREGRASP_SUCCESS: dict[str, dict[str, float]] = {
    name: {method: float(shares[index]) for method, shares in _PERCENT.items()}
    for index, name in enumerate(_OBJECTS)
}
"""Figure 6 (a): object, method, success in %; simulated in Bullet."""

PREGRASP_ACTIONS: dict[str, float] = {
    "probabilistic": 6.27,
    "deterministic": 5.69,
    "uniform": 6.05,
    "true": 5.46,
}
"""Figure 6 (b): mean number of pushes."""

WHOLE_PROCEDURE: dict[str, dict[str, float]] = {
    "hammer": {"probabilistic": 100.0, "deterministic": 80.0, "uniform": 30.0}
}
"""Figure 7: object, method, successful grasps in %; real robot, 10 starts."""
