"""Objects by methods, as in figures 6 and 7: success rates, numbers of pushes, and how trials end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slipmap.diagrams.application.campaigns.experiments import TableText, as_json
from slipmap.diagrams.application.campaigns.trials import Estimate, TrialOutcome, mean, share
from slipmap.planners.settings import METHODS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ALL = "all"  # row of all objects together
Paper = Mapping[str, Mapping[str, float]]  # success in % by object and method; not all need be present


@dataclass(frozen=True, eq=False)
class MethodsCompared:
    """Results of trials with several methods or models; each result has a `fate` and `pushes`."""

    # results of trials by object and method, with the row `ALL` if requested
    results: dict[str, dict[str, list[dict[str, Any]]]]
    success: dict[str, dict[str, Estimate]]  # share of trials by object and method
    pushes: dict[str, Estimate]  # mean number by method
    fates: dict[str, Counter[str]]  # numbers of trials by method and fate

    @property
    def methods(self) -> tuple[str, ...]:
        """Methods, in the order of the columns."""
        return tuple(self.pushes)

    def success_table(self, title: str, paper: Paper) -> TableText:
        """Table of success in %, with the paper's below."""
        rows = []
        for name, of_methods in self.success.items():
            rows.append([name, *(one.percent() for one in of_methods.values())])
            if name in paper:
                theirs = paper[name]
                rows.append(["  paper", *(f"{theirs[m]:.0f}" if m in theirs else "–" for m in self.methods)])
        return TableText(title, ("object", *self.methods), rows)

    def ways_table(
        self, title: str, label: str, fates: Sequence[str], paper: Mapping[str, float] | None = None
    ) -> TableText:
        """Table of the numbers of pushes, with the paper's below, and of trials with each fate."""
        rows = [[label, *(one.short(digits=2) for one in self.pushes.values())]]
        if paper is not None:
            rows.append(["  paper", *(f"{paper[method]:.2f}" for method in self.methods)])
        rows += [
            [fate, *(str(counts[fate]) if counts else "–" for counts in self.fates.values())]
            for fate in fates
        ]
        return TableText(title, ("", *self.methods), rows)

    def to_json(self, success: str) -> dict[str, Any]:
        """As JSON, with the shares of success under the key `success`."""
        fates = {method: dict(of) for method, of in self.fates.items()}
        return {success: as_json(self.success), "pushes": as_json(self.pushes), "fates": fates}

    def figures(self, title: str, paper: Paper) -> list[Figure]:
        """Bars of success, with marks for the paper's."""
        from slipmap.diagrams.application.figures.study_figures import shares_figure

        marks = {name: {method: (value, value) for method, value in of.items()} for name, of in paper.items()}
        return [shares_figure(title, self.success, marks)]


def compare_methods(
    outcomes: Sequence[TrialOutcome],
    *,
    good: str,
    pushes: Callable[[Any], int],
    together: bool = False,
    parameter: str = "method",
    methods: Sequence[str] = METHODS,
) -> MethodsCompared:
    """Summarise trials; failed ones have no result and do not count.

    Args:
        good: the fate that counts as success.
        pushes: number of pushes of a result.
        together: whether to add a row `ALL`.
        parameter: of a trial, which holds its method.
        methods: in the order of the columns.
    """
    results: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for outcome in outcomes:
        if outcome.result is not None:
            told = outcome.spec.parameters
            of_object = results.setdefault(told["object_name"], {method: [] for method in methods})
            of_object[told[parameter]].append(outcome.result)
    every = {method: [one for of in results.values() for one in of[method]] for method in methods}
    if together:
        results[ALL] = every
    return MethodsCompared(
        results,
        {
            name: {
                method: share(sum(one["fate"] == good for one in of[method]), len(of[method]))
                for method in methods
            }
            for name, of in results.items()
        },
        {method: mean([pushes(one) for one in every[method]]) for method in methods},
        {method: Counter(one["fate"] for one in every[method]) for method in methods},
    )
