"""The experiments of `slipmap campaign`, their settings, and the paper's results.

Listing them loads nothing large. The paper's numbers are read off the figures and tables of Song and
Boularias (IROS 2020).
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import TYPE_CHECKING, Any

from slipmap.models.files import BadInput

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from slipmap.diagrams.application.campaigns.trials import TrialOutcome, TrialSpec


_EXPERIMENTS = {
    "fig3": ("learning_curves:FIGURE_3", "error after pushes chosen by three strategies"),
    "fig4": (
        "learning_curves:FIGURE_4", "error of identified maps, a uniform object, and Algorithm 1 as printed"
    ),
    "fig5": ("stable_goals:FIGURE_5", "stable goals at the table's edge"),
    "fig6": ("methods_compared:FIGURE_6", "pushing to the table's edge by four methods"),
    "fig7": ("methods_compared:FIGURE_7", "the whole procedure with arm and camera"),
    "tilt": (
        "tilted_table:TILTED_TABLE", "pushing over a tilted table, with and without the tilt in the model"
    ),
    "coverage": (
        "belief_coverage:COVERAGE", "share of pushes at the table's edge that end within the belief's regions"
    ),
    "adapt": ("adaptation:ADAPTATION", "a robot that repairs its model while an effect is hidden from it"),
}  # fmt: skip
"""Module and name of each experiment, and what it is: those of the paper by figure, then those beyond it."""

ABOUT = {name: about for name, (_, about) in _EXPERIMENTS.items()}
"""What each experiment is."""


def experiment_of(name: str) -> Experiment:
    """An experiment by its name.

    Raises:
        ValueError: an unknown name.
    """
    if name not in _EXPERIMENTS:
        raise ValueError(f"experiment {name!r} is unknown; there are {', '.join(_EXPERIMENTS)}")
    module, attribute = _EXPERIMENTS[name][0].split(":")
    experiment: Experiment = getattr(importlib.import_module(f"{__package__}.{module}"), attribute)
    return experiment


@dataclass(frozen=True)
class TableText:
    """A table to print."""

    title: str
    columns: tuple[str, ...]
    rows: list[list[str]]


@dataclass(frozen=True, eq=False)
class Summary:
    """Results of the trials of a campaign."""

    tables: list[TableText]  # with the paper's numbers, if any
    remark: str  # on the comparison
    document: dict[str, Any]  # the same for JSON
    figures: Callable[[], list[Figure]]  # draws them


@dataclass(frozen=True)
class Experiment:
    """One experiment of the paper or beyond it."""

    name: str  # of the figure, such as `fig3`
    trials: int  # default number for each object and variant
    # runs one trial; takes `seed`, `object_name`, `truth` (unless `plant_alone`), the keys of `varied`, and
    # `belief_seed` if `seeds_a_belief` is not 0
    trial: Callable[..., dict[str, Any]]
    summary: Callable[[Sequence[TrialOutcome]], Summary]  # of their outcomes; failed ones have no result
    # parameters and their values, such as the methods compared; all combinations are run
    varied: Mapping[str, Sequence[str]] = field(default_factory=dict)
    # trials that share one belief, whose seed they receive as `belief_seed`; 0 where each has its own
    seeds_a_belief: int = 0
    plant_alone: str = ""  # what only Drake's plant simulates; empty where any truth will do
    objects: tuple[str, ...] = ()  # default objects; all six where empty

    def specs(self, objects: Sequence[str], trials: int, seed: int, truth: str) -> list[TrialSpec]:
        """A trial for every seed, object and variant; seeds vary slowest, so that an unfinished campaign has
        results of every object.

        Args:
            trials: of each object and variant.
            truth: as in `worlds.world_of`.

        Raises:
            BadInput: a truth that the experiment cannot have.
        """
        from slipmap.diagrams.application.campaigns.trials import TrialSpec

        if self.plant_alone and truth != "plant":
            raise BadInput(f"{self.name}: only plant simulates {self.plant_alone}; leave out --truth")
        fixed = {} if self.plant_alone else {"truth": truth}
        variants = [dict(zip(self.varied, values, strict=True)) for values in product(*self.varied.values())]

        def belief(number: int) -> dict[str, int]:
            return {"belief_seed": number // self.seeds_a_belief} if self.seeds_a_belief else {}

        return [
            TrialSpec(
                "-".join([name, *(value.split()[0] for value in variant.values()), str(number)]),
                f"{self.trial.__module__}:{self.trial.__name__}",
                {"object_name": name, **variant, **fixed, **belief(number)},
                number,
            )
            for number in range(seed, seed + trials)
            for name in objects
            for variant in variants
        ]


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
