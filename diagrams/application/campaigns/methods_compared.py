"""Objects by methods, as in figures 6 and 7: how often each succeeds, by how many pushes, how trials end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slipmap.diagrams.application.campaigns.experiments import TableText, as_json
from slipmap.planners.settings import METHODS
from slipmap.planners.trials import Estimate, TrialOutcome, mean, share

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ALL = "all"
"""Row of every object together."""

Paper = Mapping[str, Mapping[str, float]]
"""Object, method, success in %; not every object or method need be there."""


@dataclass(frozen=True, eq=False)
class MethodsCompared:
    """What trials of all `METHODS` say; each has a `fate` and `pushes`.

    Attributes:
        success: object, method, share of trials.
        pushes: method, their mean number.
        fates: method, how many trials had which.
    """

    success: dict[str, dict[str, Estimate]]
    pushes: dict[str, Estimate]
    fates: dict[str, Counter[str]]

    def success_table(self, title: str, paper: Paper) -> TableText:
        """Success in %, with the paper's below."""
        rows = []
        for name, of_methods in self.success.items():
            rows.append([name, *(one.percent() for one in of_methods.values())])
            if name in paper:
                theirs = paper[name]
                rows.append(["  paper", *(f"{theirs[m]:.0f}" if m in theirs else "–" for m in METHODS)])
        return TableText(title, ("object", *METHODS), rows)

    def ways_table(
        self, title: str, label: str, fates: Sequence[str], paper: Mapping[str, float] | None = None
    ) -> TableText:
        """Pushes, with the paper's below, and how many trials had each of the fates."""
        rows = [[label, *(self.pushes[method].short(digits=2) for method in METHODS)]]
        if paper is not None:
            rows.append(["  paper", *(f"{paper[method]:.2f}" for method in METHODS)])
        tried = {method: bool(self.fates[method]) for method in METHODS}
        rows += [
            [fate, *(str(self.fates[method][fate]) if tried[method] else "–" for method in METHODS)]
            for fate in fates
        ]
        return TableText(title, ("", *METHODS), rows)

    def to_json(self, success: str) -> dict[str, Any]:
        """For programs; the shares under the key `success`."""
        fates = {method: dict(of) for method, of in self.fates.items()}
        return {success: as_json(self.success), "pushes": as_json(self.pushes), "fates": fates}

    def figures(self, title: str, paper: Paper) -> list[Figure]:
        """Bars of success, marked with the paper's."""
        from slipmap.diagrams.application.figures.campaign_figures import shares_figure

        marks = {name: {method: (value, value) for method, value in of.items()} for name, of in paper.items()}
        return [shares_figure(title, self.success, marks)]


def results_of(
    outcomes: Sequence[TrialOutcome], parameter: str, values: Sequence[str]
) -> tuple[dict[str, dict[str, list[dict[str, Any]]]], dict[str, list[dict[str, Any]]]]:
    """Results by object and by the value of a trial's parameter, and those of all objects together.

    Args:
        outcomes: of the trials; failed ones have no result and are left out.
        parameter: such as `method`.
        values: that it may have, in the order of the columns.
    """
    results: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for outcome in outcomes:
        if outcome.result is not None:
            told = outcome.spec.parameters
            of_object = results.setdefault(told["object_name"], {value: [] for value in values})
            of_object[told[parameter]].append(outcome.result)
    return results, {value: [one for of in results.values() for one in of[value]] for value in values}


def compare_methods(
    outcomes: Sequence[TrialOutcome], *, good: str, pushes: Callable[[Any], int], together: bool = False
) -> MethodsCompared:
    """Sum up trials; failed ones have no result and do not count.

    Args:
        outcomes: of the trials.
        good: the fate that is success.
        pushes: number of them, of a result.
        together: whether to add a row `ALL`.
    """
    results, every = results_of(outcomes, "method", METHODS)
    rows = [*results.items(), (ALL, every)] if together else list(results.items())
    return MethodsCompared(
        {
            name: {
                method: share(sum(one["fate"] == good for one in of[method]), len(of[method]))
                for method in METHODS
            }
            for name, of in rows
        },
        {method: mean([pushes(one) for one in every[method]]) for method in METHODS},
        {method: Counter(one["fate"] for one in every[method]) for method in METHODS},
    )
