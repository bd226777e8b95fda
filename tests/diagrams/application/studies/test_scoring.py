"""Scores of diagnoses written by hand."""

import json

import pytest

from slipmap.diagrams.application.studies.blind.generator import Truth
from slipmap.diagrams.application.studies.blind.scoring import COLUMNS, said, score


def truth(effect=None, *, strength="clear", outside=False, resembles=(), name="a"):
    change = {"mean": 3.0, "median": 2.0, "max": 9.0, "per_trial": [3.0]}
    return Truth(
        name, 0, "effect" if effect else "none", effect, bool(effect) and not outside, resembles,
        strength if effect else None, {}, change, 9.0, 0.1,
    )  # fmt: skip


def result(verdict, effect=None, effects=(), **more):
    return {"verdict": verdict, "effect": effect, "effects": list(effects), "parameters": {}, "p_value": 0.01,
            "heldout_misfit_before": 4.0, "heldout_misfit_after": 1.0, "seconds": 20.0, **more}  # fmt: skip


MAGNET = {"outside": True, "resembles": ("table_friction_field",)}
CASES = [
    (truth(), result("adequate")),
    (truth(), result("adequate")),
    (truth(), result("effect", "tether")),
    (truth(), result("undecided")),
    (truth("table_tilt"), result("effect", "table_tilt")),
    (truth("table_tilt"), result("effect", "table_tilt", heldout_misfit_before=8.0)),
    (truth("table_tilt"), result("ambiguous", None, ["tether", "table_tilt"])),
    (truth("table_tilt"), result("ambiguous", None, ["tether", "loose_mass"])),
    (truth("table_tilt", strength="weak"), result("adequate")),
    (truth("tether"), result("effect", "table_tilt")),
    (truth("magnet", **MAGNET), result("unknown")),
    (truth("magnet", **MAGNET), result("effect", "table_friction_field")),
    (truth("magnet", **MAGNET), result("ambiguous", None, ["table_friction_field", "tether"])),
    (truth("magnet", **MAGNET), result("effect", "tether")),
]


def rate(scored, what):
    (found,) = [rate for rate in scored.rates if rate.what == what]
    return found.hits, found.of


def test_the_table_counts_what_was_said_of_what():
    scored = score(CASES)
    none, tilt, tether, magnet = (
        scored.confusion[key] for key in ("none", "table_tilt", "tether", "magnet *")
    )
    assert {key: value for key, value in none.items() if value} == {"adequate": 2, "wrong": 1, "undec.": 1}
    assert {key: value for key, value in tilt.items() if value} == {
        "right": 2, "in set": 1, "not in": 1, "adequate": 1,
    }  # fmt: skip
    assert {key: value for key, value in tether.items() if value} == {"wrong": 1}
    assert {key: value for key, value in magnet.items() if value} == {
        "unknown": 1, "near": 1, "in set": 1, "wrong": 1,
    }  # fmt: skip
    assert scored.named == {
        "none": {"tether": 1},
        "table_tilt": {"table_tilt": 2},
        "tether": {"table_tilt": 1},
        "magnet *": {"table_friction_field": 1, "tether": 1},
    }
    assert list(scored.confusion) == ["none", "table_tilt", "tether", "magnet *"]


def test_the_figures_that_matter():
    scored = score(CASES)
    assert rate(scored, "false alarms where nothing is hidden") == (1, 4)
    assert rate(scored, "named effects that are right") == (2, 6)
    assert rate(scored, "ambiguous sets that hold the truth") == (1, 2)
    assert rate(scored, "clear effects named rightly") == (2, 5)
    assert rate(scored, "clear effects named or in the set") == (3, 5)
    assert rate(scored, "weak effects missed (adequate)") == (1, 1)
    assert rate(scored, "effects outside the library: unknown") == (1, 4)
    assert rate(scored, "effects outside: named a look-alike") == (2, 4)
    low, high = scored.rates[0].range
    assert low == pytest.approx(0.0063, abs=1e-3) and high == pytest.approx(0.806, abs=1e-3)  # 1 of 4


def test_text_fits_a_terminal_and_markdown_and_json_hold_the_same():
    scored = score(CASES, {"blind-00007": "ValueError: no pushes"})
    text, page, document = scored.text(), scored.markdown(), json.loads(json.dumps(scored.to_json()))
    assert max(map(len, text.splitlines())) <= 80
    for said_so in (text, page):
        assert "table_tilt" in said_so and "1 of 4, 25% (1% to 81%)" in said_so
        assert "blind-00007" in said_so and "6 → 1" in said_so
    assert document["confusion"]["none"]["adequate"] == 2
    assert document["failed"] == {"blind-00007": "ValueError: no pushes"}
    assert len(document["cases"]) == len(CASES)
    widths = {
        line.count("|") for line in page.splitlines() if line.startswith(("| hidden", "| none", "| tether"))
    }
    assert widths == {len(COLUMNS) + 3}


def test_nothing_to_score_and_a_verdict_that_does_not_exist():
    assert "hidden" in score([]).text() and "%" not in score([]).text()
    with pytest.raises(ValueError, match=r"'maybe'.*adequate"):
        said(truth(), "maybe", None, [])
