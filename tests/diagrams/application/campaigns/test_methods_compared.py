"""Figures 6 and 7 sum up trials by object and method; counted here by hand."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from slipmap.diagrams.application.campaigns import methods_compared
from slipmap.diagrams.application.campaigns.experiments import experiment_of
from slipmap.diagrams.application.campaigns.trials import TrialOutcome
from slipmap.diagrams.loops import pregrasp_loop as pregrasp_run
from slipmap.diagrams.loops.exploration_run import ExplorationFailed, ExplorationStopped
from slipmap.models.files import plain
from slipmap.planners.pregrasp import METHODS


def outcomes(figure: str, fates: dict[str, list[str | None]]) -> list[TrialOutcome]:
    """Three trials of the hammer and of the book with each method; a trial without a fate failed."""
    specs = experiment_of(figure).specs(["hammer", "book"], 3, 7, "plant")
    assert len({spec.name for spec in specs}) == len(specs) == 2 * 3 * len(METHODS)
    result = []
    for spec in specs:
        fate = fates[spec.parameters["object_name"]][spec.seed - 7]
        count = spec.seed - 7 + METHODS.index(spec.parameters["method"])
        told = {"fate": fate, "pushes": count if figure == "fig6" else [{}] * count}
        result.append(TrialOutcome(spec, told if fate else None, None if fate else "broke", 1.0))
    return result


def test_figure_6_counts_success_pushes_and_fates() -> None:
    fates = {"hammer": ["success", "fell", "success"], "book": ["success", None, "gave up"]}
    document = plain(experiment_of("fig6").summary(outcomes("fig6", fates)).document)
    assert document["success"]["hammer"]["true"]["value"] == 2 / 3
    assert document["success"]["book"]["true"]["value"] == 1 / 2
    assert document["success"]["all"]["true"]["value"] == 3 / 5
    assert document["fates"]["uniform"] == {"success": 3, "fell": 1, "gave up": 1}
    # Counts 0, 1, 2 and 0, 2, and one more for each place in the list of methods.
    for place, method in enumerate(METHODS):
        assert document["pushes"][method]["value"] == 1.0 + place


def test_figure_7_counts_what_is_held_and_shows_the_paper() -> None:
    fates = {"hammer": ["held", "dropped", "held"], "book": ["held", "held", "held"]}
    summary = experiment_of("fig7").summary(outcomes("fig7", fates))
    assert plain(summary.document)["held"]["hammer"]["true"]["value"] == 2 / 3
    assert "all" not in summary.document["held"]
    table = {row[0]: row[1:] for row in summary.tables[0].rows}
    assert table["  paper"] == ["100", "80", "30", "–"]
    ways = {row[0]: row[1:] for row in summary.tables[1].rows}
    assert ways["dropped"] == ["1"] * len(METHODS)


@pytest.mark.parametrize("late", [False, True])
def test_ctrl_c_is_no_result_of_the_whole_procedure(monkeypatch, late: bool) -> None:
    def stopped(scenario, options):  # type: ignore[no-untyped-def]
        if late:
            return SimpleNamespace(interrupted=True, to_json=lambda: {"fate": "gave up"})
        raise ExplorationStopped("stopped before anything was recorded")

    monkeypatch.setattr(pregrasp_run, "pregrasp", stopped)
    with pytest.raises(KeyboardInterrupt):
        methods_compared.fetch_trial(seed=0, object_name="hammer", method="true")


def test_a_run_that_fails_gave_up(monkeypatch) -> None:
    def fails(scenario, options):  # type: ignore[no-untyped-def]
        raise ExplorationFailed("nothing was recorded: lost")

    monkeypatch.setattr(pregrasp_run, "pregrasp", fails)
    told = methods_compared.fetch_trial(seed=0, object_name="hammer", method="true")
    assert (told["fate"], told["reason"]) == ("gave up", "nothing was recorded: lost")
