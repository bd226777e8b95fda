"""What every experiment of the paper has: trials to make, and a table and a figure of what came of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from planners.campaigns.tables import Estimate, mean
from planners.campaigns.trial import TrialOutcome, TrialSpec

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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


def names_and_seeds(objects: Sequence[str], trials: int, seed: int) -> Iterator[tuple[str, int]]:
    """Every object with every seed, all objects early: an unfinished campaign has something of each."""
    for number in range(seed, seed + trials):
        for name in objects:
            yield name, number


def curves_of(values: Mapping[str, Sequence[Sequence[float]]]) -> dict[str, list[Estimate]]:
    """For each label the means over trials, one for each place along the curve."""
    return {label: [mean(column) for column in zip(*trials, strict=True)] for label, trials in values.items()}
