"""The last words of a run name the pushes that ended outside their intervals."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from slipmap.diagrams.application.commands.cell_run import CellRun
from slipmap.diagrams.application.commands.explore import (
    _monitor_words,
    _next_step,
    _show_pregrasp,
    _show_surprises,
    _show_truth,
)
from slipmap.diagrams.application.reports.tables import show_errors
from slipmap.diagrams.systems.model_monitor import Judged, Watch
from slipmap.diagrams.testing import assert_held
from slipmap.models.inference.end_region import beyond_in_millimetres
from slipmap.models.measurements import Noise
from tests.made_predictions import SQUARE, made_prediction


def told(capsys: pytest.CaptureFixture[str], *pushes: Any) -> str:
    run: Any = SimpleNamespace(identification=SimpleNamespace(pushes=pushes), repair=None)
    _show_surprises(run, Path("demo"))
    return " ".join(capsys.readouterr().out.split())


def test_the_run_ends_with_the_push_that_surprised(capsys: pytest.CaptureFixture[str]) -> None:
    taught = made_prediction("trials/000.json")
    off = made_prediction("trials/005.json", "heldout", final_add=0.0221, excess=9.0)
    said = told(capsys, taught, off)
    assert "push 005 ended 22.1 mm from the final belief's prediction" in said and "within 2.5 mm" in said
    assert "`slipmap diagnose demo/pushes`" in said
    assert told(capsys, taught, made_prediction("trials/005.json", "heldout")) == ""


def test_the_monitor_says_which_push_was_worst_though_it_gives_no_alarm() -> None:
    usual = Judged(4, 1.0, 0.5, 1.0, False, 2e-3, 5e-3, False)
    off = Judged(6, 2.0, 0.03, 3.0, False, 12.1e-3, 10e-3, True)
    said = _monitor_words(Watch(2, np.zeros(3), (usual, off)))
    assert "no alarm" in said
    assert "1 outside the 95 % region, the worst being push 006, which ended 12.1 mm from" in said
    assert "the prediction of the belief at that time (10.0 mm at most were expected)" in said
    assert "region" not in _monitor_words(Watch(1, np.zeros(3), (usual,)))
    alarm = Judged(6, 2.0, 0.03, 3.0, True, 12.1e-3, 10e-3, True)
    alarmed = Watch(2, np.zeros(3), (usual, alarm))
    assert "ALARM from push 006 on" in _monitor_words(alarmed)
    assert _monitor_words(alarmed).endswith(
        "`slipmap explore --after` continues with the effect that it names."
    )
    assert _monitor_words(alarmed, goes_on=False).endswith("`slipmap diagnose` may say why.")


@pytest.mark.parametrize(("count", "words"), [(0, "0 pushes"), (1, "1 push"), (2, "2 pushes")])
def test_pushes_to_the_edge_are_counted(capsys: pytest.CaptureFixture[str], count: int, words: str) -> None:
    run: Any = SimpleNamespace(
        to_json=lambda: {"pushes": []}, held=True, pushes=(None,) * count, true_height=None, reason=""
    )
    _show_pregrasp(run)
    assert f"After {words}, the gripper" in " ".join(capsys.readouterr().out.split())
    run.held = False
    with pytest.raises(AssertionError, match=f"after {words} to the edge"):
        assert_held(run)


@pytest.mark.parametrize(
    ("error", "allowed", "words"),
    [
        (3.0e-3, 1.8e-3, ("3.0", "1.8")),
        (3.0e-3, 2.98e-3, ("3.00", "2.98")),
        (1.04e-3, 0.998e-3, ("1.04", "1.00")),
        (3.04e-3, 3.0399e-3, ("3.0400", "3.0399")),
        (0.5e-3, 0.25e-3, ("0.50", "0.25")),
        (2.0e-3, 2.0e-3, ("2.0", "2.0")),
    ],
)
def test_an_error_is_seen_to_exceed_what_was_expected(error, allowed, words) -> None:
    assert beyond_in_millimetres(error, allowed) == words


def test_a_push_just_outside_its_interval_reads_so_in_every_line(capsys) -> None:
    off = made_prediction("trials/005.json", "heldout", final_add=3.04e-3, excess=3.04 / 3.02)
    show_errors([off], SimpleNamespace(noise=Noise(), grid=SQUARE), None)
    rows = " ".join(capsys.readouterr().out.split())
    assert "005 held out 3.04 2.0" in rows and "SURPRISING: at most 3.02 mm expected" in rows
    assert "ended 3.04 mm from the final belief's prediction" in told(capsys, off)


def test_a_zero_has_no_sign(capsys) -> None:
    believed, true = [0.0664, -2e-5], [0.0664, -1e-9]
    _show_truth({"center_of_mass_believed": believed, "center_of_mass": true, "center_of_mass_error": 2e-5})
    said = capsys.readouterr().out
    assert "66.4     0.0" in said and "-0.0" not in said


def test_a_run_ends_with_what_to_do_next() -> None:
    cell = CellRun(False, "", False, None, Path("my run"))
    usual = _next_step(cell, wrong=False)
    assert "open my run/report.html" in usual
    assert "`slipmap predict DATASET --belief 'my run/belief.npz'`" in usual
    assert "`slipmap explore --after 'my run' --output FOLDER`" in usual
    wrong = _next_step(cell._replace(hardware=True), wrong=True)
    assert wrong.startswith("`slipmap diagnose 'my run/pushes'`; ")
    assert "`slipmap explore --after 'my run' --output FOLDER --hardware` with `--effect`" in wrong


def test_the_monitor_says_by_which_criterion_it_gives_the_alarm() -> None:
    far = Judged(3, 2.7, 0.021, 3.36, True, 17.3e-3, 10.5e-3, True, outside=True)
    after = Judged(4, 1.0, 0.5, 2.4, True, 2e-3, 5e-3, False)
    said = _monitor_words(Watch(2, np.zeros(3), (far, after)))
    assert "ALARM from push 003 on (ended 17.3 mm off, 10.5 mm allowed; outside its 99 % region):" in said
    assert after.criterion == "evidence still above 1"
    many = Judged(5, 2.0, 0.01, 134.0, True, 6e-3, 7e-3, False)
    assert many.cause == "ended 6.0 mm off, 7.0 mm allowed; evidence 134, at least 100"
