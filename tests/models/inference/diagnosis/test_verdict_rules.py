"""What decides where no single effect is accepted, and the last word of the locked pushes."""

from types import SimpleNamespace

import numpy as np
import pytest

from models.effects.library import LIBRARY
from models.effects.probes import PROBES
from models.inference.diagnosis import procedure
from models.inference.diagnosis.verdict_rules import locked_pushes_stay_off


@pytest.mark.parametrize(
    ("before", "after", "off"),
    [(18.0, 17.7, True), (18.0, 16.0, False), (18.0, 1.5, False), (1.4, 1.4, False), (2.5, 2.6, True)],
)
def test_locked_pushes_that_stay_far_off_refute_an_answer(before, after, off):
    errors = [SimpleNamespace(total_misfit=value) for value in (before, after)]
    assert locked_pushes_stay_off(*errors) is off


def test_without_locked_pushes_nothing_is_refuted():
    assert not locked_pushes_stay_off(None, None)


def verdict(monkeypatch, gain, pair=None):
    """Of an inquiry in which the largest gain is `gain` nats and no single effect is accepted."""
    candidates = (LIBRARY[0], PROBES[0])
    first = SimpleNamespace(candidates=candidates, gain=np.array([1.0, gain]))
    inquiry = object.__new__(procedure._Inquiry)
    refits = SimpleNamespace(error=None, fits={"some": None}, gains={"some": 1000.0})
    monkeypatch.setattr(procedure, "refit_candidates", lambda *arguments, **options: refits)
    for name, value in {
        "rules": SimpleNamespace(missing=lambda screening: True),
        "fitter": None, "base": None, "effects": (), "scene": None, "draws": 0, "report": print,
        "accepted": [], "_ask_every_effect": lambda: first, "_found_better_base": lambda: False,
        "_disagreement": lambda: None, "_ask_what_is_left": lambda: {"some": first},
        "_pair": lambda rest: pair,
    }.items():  # fmt: skip
        setattr(inquiry, name, value)
    return inquiry.run()


@pytest.mark.parametrize(("gain", "said"), [(15.0, "undecided"), (40.0, "undecided"), (60.0, "unknown")])
def test_only_a_clear_finding_is_called_unknown(monkeypatch, gain, said):
    assert verdict(monkeypatch, gain).verdict == said


def test_a_pair_is_named_though_neither_gains_much_alone(monkeypatch):
    """Two effects may hide each other from the first question, which asks for one."""
    pair = SimpleNamespace(effects=LIBRARY[:2])
    outcome = verdict(monkeypatch, 40.0, pair)
    assert (outcome.verdict, outcome.together) == ("effect", True)
    assert outcome.effects == tuple(effect.name for effect in LIBRARY[:2])
