"""The whole way: a model is seen to fail, the effect that it misses is named and added, and errors fall."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hidden_effects import LATENCY, late_pushes
from report_page import assert_alone

from slipmap.diagrams.application.commands.identify import _beside_one, _show_gain
from slipmap.diagrams.application.reports.comparison_words import millimetres
from slipmap.models.effects.library import LIBRARY
from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.results import Identification, Quantity
from slipmap.models.measurements import write_dataset


def test_from_a_model_that_fails_to_one_that_has_the_effect(slipmap, tmp_path):
    recorded = write_dataset(late_pushes(), tmp_path / "late")

    def numbers(*arguments):
        file = tmp_path / "numbers.json"
        said = slipmap(*arguments, "--json", file)
        assert said.code == 0, said.err
        assert max(map(len, said.out.splitlines())) <= 80
        return said, json.loads(file.read_text())

    html, belief = tmp_path / "report.html", tmp_path / "belief.npz"
    _, before = numbers("compare", recorded, "-o", html)
    error = before["totals"]["heldout"]["model"]["mean_add"]
    assert error > 5 * before["noise_floor"]["add"]
    assert "delay" in {test["factor"] for test in before["structure"] if test["significant"]}

    said, found = numbers("diagnose", recorded, "--draws", 99, "-o", html)
    assert (found["verdict"], found["effect"], found["calibrated"]) == ("effect", "sensor_latency", True)
    assert found["p_value"] == pytest.approx(1 / 100)
    assert found["parameters"]["sensor_latency"]["latency"]["value"] == pytest.approx(LATENCY, abs=0.004)
    assert found["heldout_error_after"] < 0.2 * found["heldout_error_before"]
    assert said.out.startswith("Verdict: effect. The model lacks one effect: sensor_latency.")
    assert "sensor_latency: the tracker is 7" in said.out or "sensor_latency: the tracker is 8" in said.out
    assert found["next_push"]["sentence"] in " ".join(said.out.split())
    assert "screening effects: done" in said.err and f"report: {html}" in said.err
    page = assert_alone(html.read_text())
    assert page.text.index(found["sentence"]) < page.text.index("Locked pushes")
    assert page.rows == 12

    said, fitted = numbers("fit", recorded, "--effect", "sensor_latency", "-o", belief)
    told = fitted["effects"]["sensor_latency"]["latency"]
    assert told["low"] < told["value"] < told["high"] and told["shown"] and told["unit"] == "s"
    assert told["value"] == pytest.approx(LATENCY, abs=0.004)
    assert "sensor_latency: the tracker is " in said.out
    without = fitted["without_effects"]["heldout_error_mean"]
    # Where pushes end the object rests, and a late tracker shows little.
    assert fitted["heldout_error_mean"] < 0.8 * without
    assert f"without sensor_latency, {millimetres(without)} mm" in " ".join(said.out.split())
    assert "The pushes support sensor_latency." in " ".join(said.out.split())
    paired = fitted["misfit_with_over_without"]
    assert paired["verdict"] == "for" and paired["low"] < paired["ratio"] < paired["high"] < 1.0
    assert found["heldout_final_error_before"] == without == before["totals"]["heldout"]["model"]["final_add"]
    assert (tmp_path / "belief.maps.png").exists() and (tmp_path / "belief.pushes.png").exists()

    _, after = numbers("compare", recorded, "--belief", belief, "-o", html)
    assert after["totals"]["heldout"]["model"]["mean_add"] < 0.2 * error
    assert after["totals"]["heldout"]["model"]["final_add"] == pytest.approx(fitted["heldout_error_mean"])


@pytest.mark.parametrize(
    ("factors", "low", "verdict", "sentence"),
    [
        ([0.5, 0.6, 0.4, 0.5], 0.01, "for", "The pushes support table_tilt."),
        (
            [0.5, 0.6, 0.4, 0.5], -0.01, "undecided",
            "The 90 % interval of table_tilt is consistent with no effect at all. These 4 pushes alone",
        ),
        ([0.5, 1.6, 0.7, 1.3], 0.01, "undecided", "pushes alone do not show whether table_tilt is present"),
        ([1.5, 1.6, 1.3, 1.8], -0.01, "against", "THE PUSHES SPEAK AGAINST table_tilt."),
    ],
)  # fmt: skip
def test_pushes_speak_for_an_effect_only_where_they_agree_and_its_size_is_clear(
    capsys, factors, low, verdict, sentence
) -> None:  # type: ignore[no-untyped-def]
    misfits = np.array([1.0, 3.0, 10.0, 2.0])
    effects = effects_named(["table_tilt"], LIBRARY)
    facts = tuple(
        Quantity(f"table_tilt: {name}", "rad", 0.02, own, 0.03, True, "")
        for name, own in (("down_x", low), ("down_y", -0.03))
    )

    def learned(factors, other=None):  # type: ignore[no-untyped-def]
        pushes = tuple(
            SimpleNamespace(role="heldout", final_add=1e-3, errors=SimpleNamespace(misfit=misfit))
            for misfit in misfits * factors
        )
        return Identification(SimpleNamespace(effects=effects), pushes, facts, 0.0, without_effects=other)  # type: ignore[arg-type]

    result = learned(factors, learned(np.ones(4)))
    assert result.verdict == verdict
    _show_gain(result, effects)
    said = " ".join(capsys.readouterr().out.split())
    assert sentence in said and ("90 % interval of" in said) == (low < 0.0 and verdict == "undecided")


def test_one_push_that_judges_is_told_as_one(capsys) -> None:  # type: ignore[no-untyped-def]
    effects = effects_named(["table_tilt"], LIBRARY)
    facts = (Quantity("table_tilt: down_x", "rad", 0.02, -0.01, 0.03, False, ""),)
    push = SimpleNamespace(role="heldout", final_add=1e-3, errors=SimpleNamespace(misfit=2.0))
    other = Identification(SimpleNamespace(effects=effects), (push,), facts, 0.0)  # type: ignore[arg-type]
    _show_gain(replace(other, without_effects=other), effects)
    said = " ".join(capsys.readouterr().out.split())
    assert said.startswith("The held-out push ends 1.0 mm from its prediction; without table_tilt, 1.0 mm.")
    assert "Its misfit is 1 times" in said and "This one push alone does not show whether" in said


@pytest.mark.parametrize(
    ("ratio", "shown"), [(0.5, "0.5"), (1.004, "1.004"), (0.9962, "0.996"), (1.23, "1.2"), (1.0, "1")]
)
def test_an_interval_that_decides_shows_on_which_side_of_one_it_ends(ratio, shown) -> None:  # type: ignore[no-untyped-def]
    """`1 to 1.1` had spoken against an effect."""
    assert _beside_one(ratio) == shown
