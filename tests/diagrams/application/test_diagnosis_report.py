"""What the report, the tables and the pictures of a diagnosis say."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from browser import assert_legible
from hidden_effects import tilted_pushes
from report_page import assert_alone

from slipmap.diagrams.application.figures import gain_figure, locked_figure
from slipmap.diagrams.application.reports.diagnosis_report import compared, diagnosis_report
from slipmap.diagrams.application.reports.diagnosis_words import (
    evidence,
    improvement,
    locked_table,
    push_facts,
    show_diagnosis,
    standing,
)
from slipmap.models.effects import LIBRARY
from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.diagnosis.locked import LockedErrors
from slipmap.models.inference.diagnosis.procedure import diagnose
from slipmap.models.inference.diagnosis.results import CandidateResult, ParameterEstimate
from slipmap.models.inference.effect_words import READERS, effect_in_words, parameter_rows
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.planners.exploration import candidate_pushes

ROOT = Path(__file__).resolve().parents[3]
EFFECTS = effects_named(["table_tilt", "sensor_latency"])

PUSH = {
    "pose": [0.1, -0.05, np.pi / 2],
    "contact": [-0.03, 0.0],
    "direction_deg": 90.0,
    "speed": 0.05,
    "length": 0.1,
    "dwell": 0.5,
    "tip_start": [0.1, -0.095],
    "tip_end": [0.1, 0.005],
    "separates": ["table_tilt", "sensor_latency"],
    "separation": 7.26,
    "sentence": "Push the object along +y & wait.",
}


@pytest.fixture(scope="module")
def tilted():
    """The pushes on the tilted table, and a quick diagnosis with three candidates."""
    dataset = tilted_pushes()
    return dataset, diagnose(dataset, effects=EFFECTS, quick=True)


def estimate(name, value, low, high, unit="1", effect="e"):
    return ParameterEstimate(effect, name, unit, value, low, high)


def words(effect, *estimates):
    grid = cells_from_polygon(np.array([[0, 0], [6, 0], [6, 4], [0, 4]]) * 0.01, width=0.01)
    return effect_in_words(effect, estimates, grid)


@pytest.mark.parametrize(
    ("refitted", "said"),
    [
        (1.0, "does not stand when the effect is refitted"),
        (9.0, "locked pushes are predicted to within"),
        (None, "locked pushes are predicted to within"),
    ],
)
def test_an_adequate_model_beside_a_gain_beyond_chance_is_explained(tilted, refitted, said):
    _, diagnosis = tilted
    candidate = replace(diagnosis.candidates[0], gain=9.0, p_value=0.005, fitted_gain=refitted)
    left = replace(diagnosis, verdict="adequate", p_value=0.005, candidates=(candidate,))
    assert said in evidence(left)


@pytest.mark.parametrize("effects", [(), EFFECTS[:1]])
@pytest.mark.parametrize("way", [2e-3, 1e-3])
def test_no_error_along_the_path_is_told_where_only_ends_were_measured(effects, way):
    """Two rows a push: its only pose is its end, whose error had been given twice."""
    measured = way != 1e-3
    errors = LockedErrors(np.full(3, way), np.full(3, 1e-3), np.ones(3), np.zeros(3))
    found = SimpleNamespace(before=errors, after=errors, locked=("a", "b", "c"), effect_objects=effects)
    said, (_, rows) = improvement(found), locked_table(found)
    assert ("along the path" in said) == measured and "1.0 mm" in said and "at the end" in said
    assert [row[0].split(" (")[0] for row in rows][:1] == ["along the path" if measured else "at the end"]


def test_every_effect_of_the_library_has_words_for_its_size():
    assert set(READERS) == {effect.name for effect in LIBRARY}
    for effect in LIBRARY:
        estimates = [
            estimate(p.name, p.center + p.scale, p.center + 0.9 * p.scale, p.center + 1.1 * p.scale)
            for p in effect.parameters
        ]
        assert "{" not in words(effect.name, *estimates)


def test_a_parameter_that_a_bound_holds_is_told():
    tether = {effect.name: effect for effect in LIBRARY}["tether"]
    values = {
        "stiffness": 0.3,
        "anchor_x": 0.8,
        "anchor_y": 2.0,
        "slack": 0.0,
        "point_x": 0.0,
        "point_y": 0.0,
    }
    estimates = [replace(estimate(n, v, v - 0.1, v + 0.1), effect="tether") for n, v in values.items()]
    held = [row[0] for row in parameter_rows([tether], estimates) if "at the end of its range" in row[3]]
    assert held == ["anchor_y"]


def test_sizes_in_the_units_of_a_person():
    slope = np.sin(np.radians(3.0))
    tilt = words(
        "table_tilt",
        estimate("down_x", 0.0, -0.001, 0.001),
        estimate("down_y", slope, slope - 0.01, slope + 0.01),
    )
    assert tilt.startswith("tilt 3.0° (2.4 to 3.6), downhill towards 90.0°")
    # A length does not exclude zero where both of its parameters may be zero.
    faint = words("table_tilt", estimate("down_x", 0.04, -0.002, 0.08), estimate("down_y", 0.0, -0.03, 0.03))
    assert faint.startswith("tilt 2.3° (0.0 to ")
    faint = words(
        "table_tilt", estimate("down_x", 0.04, -0.002, 0.06), estimate("down_y", 0.02, -0.001, 0.03)
    )
    assert faint.startswith("tilt 2.6° (0.0 to ")
    assert words("sensor_latency", estimate("latency", 0.06, 0.058, 0.062)) == (
        "the tracker is 60.0 ms late (58.0 to 62.0)"
    )
    assert words("sensor_latency", estimate("latency", -0.006, -0.008, 0.001)) == (
        "the tracker is 6.0 ms early (-1.0 to 8.0)"
    )
    # Eigenvalues of the stretch are (1 + ρ)/(1 - ρ) and its inverse: 1.5 / 0.5 at ρ = 0.5, at half the angle.
    grain = words(
        "anisotropic_table", estimate("along_x", 0.0, -0.1, 0.1), estimate("along_xy", 0.5, 0.4, 0.6)
    )
    assert grain.startswith("friction 3.0 times as high (2.3 to 4.0), along 45° of the table")
    patch = [estimate("patch", np.log(2.0), np.log(1.5), np.log(3.0))]
    patch += [estimate(name, 0.1, 0.09, 0.11) for name in ("patch_x", "patch_y", "patch_radius")]
    level = [estimate(name, 0.01, -0.1, 0.1) for name in ("gradient_x", "gradient_y")]
    field = words("table_friction_field", *level, *patch)
    assert "2.0 times as high on a round patch (1.5 to 3.0)" in field and "x 100 mm (90 to 110)" in field
    assert "towards" not in field  # a slope that may be none has no direction
    none = [estimate("patch", 0.0, -0.1, 0.1), *patch[1:]]
    assert "centre" not in words("table_friction_field", *level, *none)
    # 24 cells of 1 cm² and 100 N s/m³ give 0.24 N s/m, at 100 mm/s 0.024 N.
    drag = words("viscous_friction", estimate("drag_per_area", 100, 90, 110))
    assert "0.0240 N on the whole object per 100 mm/s" in drag
    assert words("fan", estimate("blow", 0.5, 0.4, 0.6, "N")) == "blow 0.50 N (0.40 to 0.60)"


def test_standing_tells_why_each_is_ruled_out(tilted):
    _, found = tilted
    ambiguous = replace(found, verdict="ambiguous", effects=("table_tilt", "tether"))
    pair = replace(found, effects=("table_tilt", "skate"), together=True)

    def of(diagnosis, name, **more):
        return standing(CandidateResult(name, 1.0, 0.5, **more), diagnosis)

    assert of(ambiguous, "tether") == "not ruled out"
    assert of(pair, "skate") == "needed, together with table_tilt"
    assert (
        of(found, "tether", rejected_by="table_tilt", remaining_gain=859.3)
        == "table_tilt on top gains 859 nats more"
    )
    probed = of(found, "tether", rejected_by="force_by_time", remaining_gain=12.34)
    assert probed == "“a force on the object that comes and goes with time” on top gains 12.3 nats more"
    assert of(found, "tether") == "gains no more than chance"
    best = max(c.fitted_gain for c in found.candidates if c.fitted_gain is not None)
    assert of(found, "tether", fitted_gain=best - 859.3) == "explains 859 nats less than the best"
    assert of(replace(found, verdict="adequate", effects=()), "tether") == "gains no more than chance"
    undecided = replace(found, verdict="undecided", effects=(), motion_error=0.1)
    assert of(undecided, "tether") == "gains no more than chance"
    rare = CandidateResult("tether", 20.0, 0.005)
    assert standing(rare, found) == "far from the best"
    assert standing(rare, undecided) == "the pushes do not agree on it"
    one = replace(undecided, open_trials=undecided.open_trials[:1])
    assert standing(rare, one) == "no other push to agree with"
    refuted = replace(
        undecided, objections={"tether": "its 90 % interval is consistent with no effect at all"}
    )
    assert of(refuted, "tether", fitted_gain=best) == "its 90 % interval is consistent with no effect at all"


def test_no_gain_that_counts_is_called_chance(tilted):
    """A quick look has no p-values, and a first-order gain says little of what a refit gains."""
    _, found = tilted
    undecided = replace(found, verdict="undecided", effects=(), motion_error=0.1)
    for candidate in (
        CandidateResult("tether", 2280.0, None),
        CandidateResult("tether", 42.7, 0.3, fitted_gain=14994.0),
    ):
        for diagnosis in (found, undecided):
            assert "chance" not in standing(candidate, diagnosis)


@pytest.mark.parametrize(
    ("verdict", "command"),
    [
        ("adequate", "slipmap identify my/pushes -o"),
        ("effect", "slipmap fit my/pushes --effect table_tilt"), ("ambiguous", "slipmap diagnose my/pushes"),
        ("unknown", "slipmap compare my/pushes"),
        ("undecided", "slipmap compare my/pushes"),
    ],
)  # fmt: skip
def test_every_verdict_ends_with_a_command(tilted, verdict, command, capsys):
    dataset, found = tilted
    told = replace(found, verdict=verdict, quick=False)
    assert f"`{command}" in told.next_step("my/pushes")
    show_diagnosis(told, dataset, EFFECTS, "my/pushes")
    assert " ".join(capsys.readouterr().out.split()).endswith(told.next_step("my/pushes"))
    assert told.to_json("my/pushes")["next_step"] == told.next_step("my/pushes")
    with_own = told.next_step("my.csv --object block.yaml --effect-file fan.py")
    assert f"{command} ".replace("my/pushes", "my.csv --object block.yaml") in with_own + " "
    assert ("--effect-file fan.py" in with_own) == (verdict not in ("adequate", "effect"))
    assert ("imported" in told.next_step()) == (verdict in ("ambiguous", "undecided"))


def test_without_more_pushes_the_simplest_of_several_effects_predicts(tilted):
    """A tether has more parameters than a tilt, and a pair more than one of its effects."""
    _, found = tilted
    tilt, tether, latency = effects_named(["table_tilt", "tether", "sensor_latency"])
    for rivals, command in (
        ([[tether], [tilt]], "--effect table_tilt -o with-table_tilt.npz"),
        (
            [[tilt, tether], [tilt, latency]],
            "--effect table_tilt --effect sensor_latency -o with-table_tilt-sensor_latency.npz",
        ),
    ):
        fitted = tuple(replace(found.best, effects=tuple(effects)) for effects in rivals)
        told = replace(found, verdict="ambiguous", rivals=fitted, quick=False)
        step = told.next_step("my/pushes")
        assert step.endswith(f"fewest parameters: run `slipmap fit my/pushes {command}`."), step
        assert "run `slipmap diagnose my/pushes` again" in step


def test_what_may_be_wrong_with_the_dataset_comes_before_the_command(tilted):
    _, found = tilted
    sure = replace(found, quick=False)
    doubted = replace(sure, first=("weigh the object",), doubts=("contact",))
    assert doubted.next_step("my/pushes") == (
        "weigh the object; correct what `slipmap check my/pushes` finds wrong (contact); then run `slipmap"
        f" diagnose my/pushes` again. If nothing can be corrected, {sure.next_step('my/pushes')}"
    )


def test_every_key_of_the_json_is_documented(tilted):
    _, found = tilted
    section = (ROOT / "docs" / "diagnose.md").read_text().split("## JSON")[1].split("## Limits")[0]
    document = found.to_json()
    for key in (*document, *document["candidates"][0], *PUSH):
        shown = f"`{key}`" if not key.endswith("_after") else key.replace("after", "before")
        assert shown in section, key


def test_report_and_tables_of_one_effect(tilted, capsys):
    dataset, found = tilted
    assert found.effects == ("table_tilt",)
    told = replace(found, next_push=PUSH)
    page = assert_alone(diagnosis_report(told, dataset, EFFECTS))
    assert {"answer", "ranking", "locked", "next", "errors", "pushes", "where", "reading"} <= set(page.ids)
    data = json.loads(page.scripts[0][1])["pushes"]
    assert data["labels"] == ["without effects", "with table_tilt"]
    for fact in (
        "x 100 mm, y -50 mm, turned by 90°",
        "table_tilt, sensor_latency",
        f"{1e3 * PUSH['length']:.0f} mm after first touch",
        "7.3 standard deviations",
    ):
        assert fact in page.text
    assert dict(push_facts(PUSH))["pause half-way"] == "0.5 s"
    assert "pause half-way" not in dict(push_facts({**PUSH, "dwell": 0.0}))
    show_diagnosis(told, dataset, EFFECTS)
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 80
    for text in (out, page.text):
        assert found.sentence in text and "Chance was not simulated" in " ".join(text.split())
        assert "Push the object along +y & wait." in text
        assert f"{1e3 * found.before.path.mean():.1f}" in text
        assert f"{found.after.total_misfit:.2f}" in text


def test_the_report_is_legible_in_a_browser(tilted, browser, tmp_path):
    dataset, found = tilted
    page = tmp_path / "report.html"
    page.write_text(diagnosis_report(replace(found, next_push=PUSH), dataset, EFFECTS), encoding="utf-8")
    assert_legible(browser.opened(page), page)


def test_both_models_of_the_report_are_those_of_the_diagnosis(tilted):
    dataset, found = tilted
    before, after = compared(found, dataset)
    locked = [push for push in after.pushes if push.role == "heldout"]
    assert [push.trial for push in locked] == list(found.locked)
    np.testing.assert_allclose([p.errors.final_add for p in locked], found.after.final, rtol=0.02, atol=2e-5)
    assert before.totals["heldout"].model.final_add > 3 * after.totals["heldout"].model.final_add


def test_pushes_locked_by_lot_are_shown_as_held_out(tilted):
    """Roles of the report are those of the diagnosis, also where the dataset holds nothing out."""
    dataset, found = tilted
    unlocked = replace(dataset, trials=tuple(replace(trial, role="fit") for trial in dataset.trials))
    (before, _) = compared(found, unlocked)
    assert {p.trial for p in before.pushes if p.role == "heldout"} == set(found.locked) != set()


def test_reports_of_the_other_verdicts(tilted, capsys):
    dataset, found = tilted
    plain = dict(effects=(), best=found.base, with_effects=None, rivals=())
    unknown = replace(
        found, verdict="unknown", depends_on="friction_by_speed: Friction that depends on speed.", **plain
    )
    page = assert_alone(diagnosis_report(unknown, dataset, EFFECTS))
    assert "Friction that depends on speed." in page.text and "--effect-file" in page.text
    assert json.loads(page.scripts[0][1])["pushes"]["labels"] == ["the model"]
    taught = replace(
        found.without_effects, pushes=tuple(p for p in found.without_effects.pushes if p.role == "fit")
    )
    nothing = replace(found, verdict="adequate", without_effects=taught, locked=(), **plain)
    page = assert_alone(diagnosis_report(nothing, dataset, EFFECTS))
    assert "locked" not in page.ids
    show_diagnosis(nothing, dataset, EFFECTS)
    assert "No push was locked away" in capsys.readouterr().out
    with pytest.raises(ValueError, match="locked away"):
        locked_figure(nothing)


def test_a_set_is_named_and_names_cannot_break_the_report(tilted):
    dataset, found = tilted
    odd = replace(
        found,
        verdict="ambiguous",
        sentence="<script>alert(1)</script>",
        effects=("table_tilt", "sensor_latency"),
        next_push={**PUSH, "sentence": "<b>"},
    )
    page = assert_alone(diagnosis_report(odd, replace(dataset, name="<i>"), EFFECTS))
    assert "the pushes cannot rule out sensor_latency" in page.text
    assert "<script>alert(1)</script>" in page.text and "<b>" in page.text


def test_pictures_show_the_numbers(tilted):
    _, found = tilted
    bars = gain_figure(found).axes[0].patches
    assert [bar.get_width() for bar in bars] == pytest.approx([max(c.gain, 0.0) for c in found.candidates])
    dots = {line.get_label(): line for line in locked_figure(found).axes[0].get_lines()}
    assert sorted(dots["with the answer"].get_xdata()) == pytest.approx(sorted(1e3 * found.after.path))


def test_what_is_left_is_drawn_on_the_scale_of_the_gain(tilted):
    _, found = tilted
    candidates = [CandidateResult("right", 104.0, 0.01, fitted_gain=6918.0, remaining_gain=1.0)]
    gain, fitted, left = gain_figure(replace(found, candidates=candidates)).axes
    assert gain.get_xlim() == left.get_xlim() and fitted.get_xlim()[1] > 6918.0
    assert not gain.figure.texts  # no dash needs a word
    candidates += [
        CandidateResult("wrong", 37.0, 0.01, fitted_gain=9.0, remaining_gain=859.0, rejected_by="right")
    ]
    gain, _, left = gain_figure(replace(found, candidates=candidates)).axes
    assert gain.get_xlim() == left.get_xlim() and left.get_xlim()[1] > 859.0
    (alone,) = gain_figure(replace(found, candidates=[CandidateResult("none", -2.0, 0.9)])).axes
    assert alone.get_xlim()[1] > 0.0


def test_a_dash_in_the_picture_of_gains_is_explained(tilted):
    _, found = tilted
    refitted = CandidateResult("right", 104.0, 0.01, fitted_gain=6918.0, remaining_gain=1.0)
    figure = gain_figure(replace(found, candidates=[refitted, CandidateResult("weak", 2.0, 0.5)]))
    assert [text.get_text() for text in figure.texts] == ["– not computed"]


def test_a_belief_of_a_diagnosis_survives_its_file(tilted, tmp_path):
    _, found = tilted
    belief = found.with_effects.belief
    belief.save(tmp_path / "b.npz")
    again = Belief.load(tmp_path / "b.npz")
    assert again.effects[0].name == "table_tilt"
    np.testing.assert_array_equal(again.maps.effects, belief.maps.effects)


def test_an_answer_that_leaves_the_locked_pushes_far_off_says_so(tilted):
    _, found = tilted
    assert "times the sensor noise" not in improvement(found)
    pushes = [
        replace(push, errors=replace(push.errors, misfit=48.0)) if push.role == "heldout" else push
        for push in found.with_effects.pushes
    ]
    off = replace(found, with_effects=replace(found.with_effects, pushes=tuple(pushes)))
    assert "Even with table_tilt, the typical locked push is 48 times the sensor noise off" in improvement(
        off
    )


@pytest.mark.parametrize(("different", "words"), [(1, "repeats of one push"), (2, "repeats of 2 pushes")])
def test_repeats_of_few_pushes_cannot_clear_the_model(different, words):
    grid = cells_from_polygon(np.array([[-3, -2], [3, -2], [3, 2], [-3, 2]]) * 0.01, width=0.02)
    maps = Maps(np.full((1, len(grid)), 0.08), np.full((1, len(grid)), 0.3), np.array([0.3]))
    rng = np.random.default_rng(0)
    made = candidate_pushes(grid, 0.005, rng, different, length=(0.06, 0.09), speed=(0.03, 0.1))
    pushes = [candidate.push(np.zeros(3)) for candidate in made] * (8 // different)
    dataset = record_pushes(Slider(grid, 0.005), maps, pushes, rng, heldout=2)
    found = diagnose(dataset, effects=EFFECTS, quick=True)
    assert found.verdict == "undecided"
    assert f"{words} could not have revealed most effects" in found.sentence
