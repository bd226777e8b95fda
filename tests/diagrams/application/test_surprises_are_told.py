"""The last words of a run name the pushes that ended outside their intervals."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from slipmap.diagrams.application.commands.explore import _monitor_words, _show_surprises
from slipmap.diagrams.systems.model_monitor import Judged, Watch
from tests.made_predictions import made_prediction


def told(capsys: pytest.CaptureFixture[str], *pushes: Any) -> str:
    run: Any = SimpleNamespace(identification=SimpleNamespace(pushes=pushes), repair=None)
    _show_surprises(run, Path("demo"))
    return " ".join(capsys.readouterr().out.split())


def test_the_run_ends_with_the_push_that_surprised(capsys: pytest.CaptureFixture[str]) -> None:
    taught = made_prediction("trials/000.json")
    off = made_prediction("trials/005.json", "heldout", final_add=0.0221, excess=9.0)
    said = told(capsys, taught, off)
    assert "push 005 ended 22.1 mm from its prediction" in said and "within 2.5 mm" in said
    assert "`slipmap diagnose demo/pushes`" in said
    assert told(capsys, taught, made_prediction("trials/005.json", "heldout")) == ""


def test_the_monitor_says_which_push_was_worst_though_it_gives_no_alarm() -> None:
    usual = Judged(4, 1.0, 0.5, 1.0, False, 2e-3, 5e-3, False)
    off = Judged(6, 2.0, 0.03, 3.0, False, 12.1e-3, 10e-3, True)
    said = _monitor_words(Watch(2, np.zeros(3), (usual, off)))
    assert "no alarm" in said
    assert "1 outside the 95 % region, the worst being push 7" in said
    assert "an error of 12.1 mm where at most 10.0 mm were expected" in said
    assert "region" not in _monitor_words(Watch(1, np.zeros(3), (usual,)))
