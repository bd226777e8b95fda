"""`slipmap compare` and its report: what it writes, says and refuses, and that the page stands by itself."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from browser import assert_legible
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from report_page import Page, assert_alone

from slipmap.diagrams.application.figures import (
    correlation_figure,
    error_figure,
    factor_figure,
    object_figure,
    table_figure,
)
from slipmap.diagrams.application.figures.residual_figures import CONDITIONS, residual_figures
from slipmap.diagrams.application.reports.comparison_report import comparison_report as report
from slipmap.diagrams.application.reports.comparison_words import (
    doubts,
    finding,
    mean_error,
    millimetres,
    pushes_needed,
    sentence_part,
    short_name,
    summary,
    summary_of_two,
    warning,
)
from slipmap.diagrams.application.reports.html_page import Section, page, part, table
from slipmap.diagrams.application.reports.tables import show_comparison
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.comparison import compare
from slipmap.models.measurements import read_dataset
from tests.made_predictions import region_left_by


@pytest.fixture(scope="module")
def learned(demo_folder):
    """The demo's pushes, and what its belief makes of them."""
    dataset = read_dataset(demo_folder / "demo" / "pushes")
    belief = Belief.load(demo_folder / "demo" / "belief.npz")
    return dataset, belief, compare(dataset, belief)


@pytest.fixture(scope="module")
def single(learned):
    dataset, _, result = learned
    return Page(report([result], dataset)), report([result], dataset)


@pytest.fixture(scope="module")
def both(learned):
    dataset, belief, before = learned
    heavier = replace(belief, maps=replace(belief.maps, mu_finger=0.3 * belief.maps.mu_finger))
    return [replace(before, label="before"), compare(dataset, heavier, label="after")]


def test_the_page_needs_nothing_else(single):
    assert_alone(single[1])


def test_the_page_begins_with_what_was_found(single, learned):
    parsed, _ = single
    _, _, result = learned
    assert parsed.text.index(summary(result)) < parsed.text.index("Prediction errors")
    assert finding(result) in parsed.text
    assert f"{1e3 * result.totals['heldout'].model.final_add:.1f} mm" in summary(result)


def test_the_page_holds_every_push_with_its_course(single, learned):
    parsed, _ = single
    dataset, _, result = learned
    (kind, text), _ = parsed.scripts
    data = json.loads(text)["pushes"]
    assert kind == "application/json"
    assert parsed.rows == len(data["pushes"]) == len(dataset.trials)
    for shown, push in zip(data["pushes"], result.pushes, strict=True):
        np.testing.assert_allclose(shown["measured"][0], push.observation.push.start_pose, atol=1e-5)
        np.testing.assert_allclose(shown["predicted"][0][1:], push.predicted, atol=1e-5)
        assert shown["add"][0][-1] == pytest.approx(push.errors.final_add, abs=1e-5)
        assert len(shown["times"]) == len(shown["finger"]) == len(shown["measured"])
    assert result.pushes[data["first"]].role == "heldout"


def test_the_page_is_legible_in_a_browser(single, both, learned, browser, tmp_path):
    for name, text in (("one", single[1]), ("two", report(both, learned[0]))):
        page = tmp_path / f"{name}.html"
        page.write_text(text, encoding="utf-8")
        seen = browser.opened(page, 'document.querySelector(".course path") ? document.images.length : null')
        assert_legible(seen, page)
        assert seen.answer > 10


def test_two_models_stand_side_by_side(both, learned):
    parsed = Page(report(both, learned[0]))
    data = json.loads(parsed.scripts[0][1])["pushes"]
    assert data["labels"] == ["before", "after"]
    assert all(len(push["predicted"]) == len(push["add"]) == 2 for push in data["pushes"])
    assert summary_of_two(*both) in parsed.text and f"after: {finding(both[1])}" in parsed.text
    errors = [comparison.totals["heldout"].model.final_add for comparison in both]
    for error in errors:
        assert f"{1e3 * error:.1f} mm" in summary_of_two(*both)


def test_models_over_different_pushes_are_refused(both, learned):
    fewer = replace(both[1], pushes=both[1].pushes[:-1])
    with pytest.raises(ValueError, match="same pushes"):
        report([both[0], fewer], learned[0])
    with pytest.raises(ValueError, match="one model or two"):
        report([*both, both[0]], learned[0])


def test_sections_of_other_commands_fit_in_and_cannot_break_the_page():
    extra = Section(
        "verdict", "Verdict <b>", table(["a"], [["<script>alert(1)</script>"]]), {"x": "</script>"}
    )
    text = page("tom & <i>jerry</i>", "", ["a < b", "`slipmap fit <x>` next"], [extra])
    parsed = Page(text)
    assert "tom & <i>jerry</i>" in parsed.text and "a < b" in parsed.text
    assert "<script>alert(1)</script>" in parsed.text
    assert "<p><code>slipmap fit &lt;x&gt;</code> next</p>" in text
    assert json.loads(parsed.scripts[0][1]) == {"verdict": {"x": "</script>"}}
    with pytest.raises(ValueError, match="keys must differ"):
        page("t", "", [], [extra, extra])


def test_the_script_is_javascript(tmp_path):
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed; it would check the report's script")
    (tmp_path / "pushes.js").write_text(part("pushes.js"))
    subprocess.run([node, "--check", tmp_path / "pushes.js"], check=True, capture_output=True)


def test_few_pushes_are_told_as_such(learned):
    _, _, result = learned
    assert not result.testable
    assert "4 pushes cannot show whether" in finding(result)
    alone = tuple(replace(pattern, pushes=1) for pattern in result.structure)
    assert finding(replace(result, structure=alone)).startswith("One push cannot show whether")
    assert f"at least {pushes_needed(len(result.structure))}" in finding(result)
    assert pushes_needed(20) == 10  # 20 tests × 2/2^10 is the first below 5 %


def test_an_error_of_many_times_the_noise_that_a_uniform_object_makes_too_is_told(learned):
    """It is no "pattern beyond chance", and it is not passed over: the ratios are named, and what to do."""
    dataset, _, result = learned
    assert warning(result) == ""
    quiet = tuple(replace(pattern, p=0.5, p_corrected=1.0, pushes=12) for pattern in result.structure)
    totals, floor = result.totals["heldout"], result.floor
    errors = replace(totals.model, final_add=23 * floor.add)
    even = replace(totals.uniform, final_add=22 * floor.add)
    wrong = replace(totals, model=errors, uniform=even)
    bad = replace(result, structure=quiet, totals={**result.totals, "heldout": wrong})
    said = warning(bad, "demo/pushes")
    assert "23 times what sensor noise alone explains, and as much as a uniform object" in said
    guessed = replace(bad, floor=replace(floor, source="estimated noise"))
    assert "23 times what the estimated sensor noise alone explains" in warning(guessed)
    assert said.endswith("diagnose demo/pushes` searches for the physical effect that the model misses.")
    assert "significant pattern" not in finding(bad)
    assert finding(bad).startswith("No single condition explains the remaining error")
    shown = Page(report([bad], dataset, "demo/pushes")).text
    large, others = said.replace("`", "").split(". ", maxsplit=1)
    assert shown.index(f"{large}.\n") < shown.index(others) < shown.index(summary(bad))
    better = replace(wrong, uniform=replace(even, final_add=30 * floor.add))
    fine = replace(bad, totals={**result.totals, "heldout": better})
    assert warning(fine) == "" and "no significant pattern" in finding(fine)


@pytest.mark.parametrize(("spread", "said"), [(0.1, "The model is wrong."), (20.0, "too few to show")])
def test_a_model_is_wrong_only_where_its_hypotheses_do_not_allow_the_error(learned, spread, said):
    """One push to learn from leaves the maps open: the next may end as far off, with nothing hidden."""
    _, _, result = learned
    totals, floor = result.totals["heldout"], result.floor.add
    far = replace(totals.model, final_add=23 * floor)
    held = [
        replace(push, errors=replace(push.errors, final_add=23 * floor), spread=spread * floor)
        for push in result.pushes
        if push.role == "heldout"
    ]
    even = {"heldout": replace(totals, model=far, uniform=replace(totals.uniform, final_add=20 * floor))}
    found = warning(replace(result, pushes=tuple(held), totals=even))
    assert found.startswith("The held-out push ends ") and said in found
    assert ("The model is wrong." in found) == (spread < 1.0)
    two = {"heldout": replace(even["heldout"], pushes=2)}
    assert warning(replace(result, pushes=(*held, *held), totals=two)).startswith("Held-out pushes end ")


def test_a_model_that_does_not_explain_what_taught_it_is_told_as_by_identify(learned):
    dataset, _, result = learned
    missed = replace(result, unexplained=0.1)
    said = warning(missed, "demo/pushes")
    assert said.startswith("THE MODEL DOES NOT EXPLAIN THESE PUSHES: with the best maps, it is off by 10 %")
    assert said.endswith("diagnose demo/pushes` searches for the physical effect that the model misses.")
    assert headline_of(report([missed], dataset)).startswith("THE MODEL DOES NOT EXPLAIN")
    # Of pushes that taught another belief nothing is known here.
    assert warning(replace(missed, learnt_from="elsewhere")) == ""


def test_errors_that_the_hypotheses_do_not_allow_are_told_as_by_predict(learned):
    """A tilt found by no test of nine pushes: the errors were 14 times the noise, and nothing was said."""
    dataset, _, result = learned
    far = [
        replace(push, observation=replace(push.observation, role="heldout"), spread=0.0)
        for push in result.pushes
    ]
    far = [replace(p, errors=replace(p.errors, final_add=4.0 * result.floor.add)) for p in far]
    totals = {"heldout": replace(result.totals["heldout"], pushes=4)}
    (said,) = doubts(replace(result, pushes=tuple(far), totals=totals))
    assert said.startswith("The errors of held-out pushes are 4.0 times (median) what the spread")
    assert "The errors of held-out pushes" in report([replace(result, pushes=tuple(far))], dataset)


def test_an_error_along_the_way_is_not_told_where_only_ends_were_measured(learned, capsys):
    _, _, result = learned
    ends = {
        role: replace(own, model=replace(own.model, mean_add=own.model.final_add))
        for role, own in result.totals.items()
    }
    found = replace(result, totals=ends)
    assert "averaged along the path" in summary_of_two(result, result)
    assert "averaged along the path" not in summary_of_two(found, found)
    show_comparison([found])
    (row,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("held out, model")]
    assert row.split()[4] == "–"


def test_a_push_that_surprises_stands_in_the_warning(learned):
    dataset, _, result = learned
    last = result.pushes[-1]
    off = replace(last, end_region=region_left_by(9.0, last.measured[-1]))
    found = replace(result, pushes=(*result.pushes[:-1], off))
    said = warning(found, "demo/pushes")
    assert said.startswith(f"SURPRISING: push {short_name(last.trial)} ended")
    assert "slipmap diagnose demo/pushes" in said
    shown = Page(report([found], dataset, "demo/pushes")).text
    large, others = said.replace("`", "").split(". ", maxsplit=1)
    assert f"{large}.\n" in shown and others in shown
    (told,) = [push for push in found.to_json()["pushes"] if push["surprising"]]
    assert told["trial"] == last.trial and told["excess"] == pytest.approx(9.0)


def test_pushes_of_one_file_keep_the_names_that_tell_them_apart(learned):
    assert short_name("trials/003.json") == "003" and short_name("day.1.csv") == "day.1"
    assert short_name("csv/day.csv#7") == "day#7" and short_name("day.csv#slow/2.5") == "day#slow/2.5"
    *others, one, other = learned[2].pushes
    named = [
        replace(push, observation=replace(push.observation, role="heldout", trial=f"day.csv#{number}"))
        for number, push in ((7, one), (8, other))
    ]
    far = [replace(push, end_region=region_left_by(9.0, push.measured[-1])) for push in named]
    said = warning(replace(learned[2], pushes=(*others, *far)), "day.csv")
    assert {"day#7", "day#8"} <= set(re.findall(r"day#\d", said))


def headline_of(html):
    (large,) = re.findall('<p class="headline">(.*?)</p>', html)
    return large


def test_the_mean_error_is_the_headline_of_a_report_unless_pushes_surprise_beyond_chance(learned):
    dataset, _, result = learned
    assert headline_of(report([result], dataset)) == mean_error(result)
    # A run that recorded the pushes tells its story first, unless the model is doubted.
    told = report([result], dataset, run=("It added table_tilt.", ["Then it grasped."]))
    assert headline_of(told) == "It added table_tilt."
    assert f"<p>{mean_error(result)}</p>\n<p>Then it grasped.</p>" in told
    held = [replace(push, observation=replace(push.observation, role="heldout")) for push in result.pushes]
    *usual, last = held
    barely = replace(last, end_region=region_left_by(1.05, last.measured[-1]))
    four = {"heldout": replace(result.totals["heldout"], pushes=4)}
    found = replace(result, pushes=(*usual, barely), totals=four)
    assert warning(found) == ""
    (barely_out,) = doubts(found)
    assert barely_out.startswith(f"Surprising: push {short_name(last.trial)} ended")
    shown, error = report([found], dataset), millimetres(four["heldout"].model.final_add)
    large = f"Held-out pushes end {error} mm from their predicted ends on average."
    assert headline_of(shown) == large
    text = Page(shown).text
    assert text.index(summary(found)) < text.index("1 of 4 pushes may end outside by chance")
    two = report([found, replace(found, label="with table_tilt")], dataset)
    assert headline_of(two) == f"{large[:-1]} (with table_tilt)."
    alone = replace(result, totals={"fit": replace(result.totals["fit"], pushes=1)})
    assert mean_error(alone).startswith("The fitted push ends ")


def test_patterns_in_words(learned):
    pattern = replace(learned[2].structure[0], quantity="force", factor="table_drift", p_corrected=0.001)
    down = replace(pattern, strongest="along table y", size=-0.1)
    assert sentence_part(down) == "the force is off everywhere, towards table -y (10 %)"
    late = replace(pattern, quantity="delay", factor="delay", size=0.06)
    assert sentence_part(late) == "measured poses come 60 ms late"
    more = replace(pattern, quantity="motion", factor="overall", strongest="along the motion", size=0.1)
    assert sentence_part(more) == "the object moves farther than predicted everywhere (10 %)"
    less = replace(more, strongest="in the direction of its rotation", size=-0.1)
    assert sentence_part(less) == "the object turns less far than predicted everywhere (10 %)"
    found = finding(replace(learned[2], structure=(down, late)))
    assert found == f"The remaining error has a pattern: {sentence_part(down)}; and {sentence_part(late)}."


def test_long_names_of_pushes_stand_whole_below_their_errors(learned):
    result = learned[2]
    long = [
        replace(push, observation=replace(push.observation, trial=f"a_push_of_a_long_name_{k}.csv"))
        for k, push in enumerate(result.pushes)
    ]
    for pushes in (result.pushes, tuple(long)):
        figure = error_figure([replace(result, pushes=pushes)])
        figure.draw_without_rendering()
        labels = figure.axes[0].get_xticklabels()
        assert [label.get_text() for label in labels] != []
        assert min(label.get_window_extent().y0 for label in labels) >= 0


def test_figures_are_figures_and_refuse_what_is_not_there(both, learned):
    dataset, _, result = learned
    figures = residual_figures(both, dataset)
    assert {"motion.table_place", "motion.table_place.second", "force.contact_place", "motion.speed"} <= set(
        figures
    )
    assert all(isinstance(figure, Figure) for figure in figures.values())
    lines = [line for line in error_figure(both).axes[0].get_lines() if line.get_label() == "after"]
    order = sorted(both[0].pushes, key=lambda push: (push.role == "heldout", push.errors.final_add))
    second = {push.trial: 1e3 * push.errors.final_add for push in both[1].pushes}
    np.testing.assert_allclose(lines[0].get_ydata(), [second[push.trial] for push in order])
    assert len(correlation_figure([result]).axes) == 3
    without = replace(result, force=None, correlations=None)
    for draw in (
        lambda: table_figure(without, "force"),
        lambda: correlation_figure([without]),
        lambda: factor_figure([result], "colour"),
        lambda: object_figure(without, dataset.grid, "force"),
    ):
        with pytest.raises(ValueError):
            draw()


def test_two_models_have_one_scale(both, learned):
    """A model whose errors are ten times as large: arrows and colours tell it from the other."""
    first, second = both
    worse = replace(second, motion=replace(second.motion, values=10 * second.motion.values))
    figures = residual_figures([first, worse], learned[0])
    for name in ("motion.table_place", "motion.contact_place"):
        one, other = figures[name], figures[f"{name}.second"]
        assert one.axes[1].get_ylim() == other.axes[1].get_ylim()
        scales = [[text.get_text() for text in figure.axes[0].texts] for figure in (one, other)]
        assert scales[0] == scales[1]
    alone = residual_figures([first], learned[0])["motion.table_place"]
    assert alone.axes[1].get_ylim()[1] < figures["motion.table_place"].axes[1].get_ylim()[1]


def test_the_worse_of_two_models_is_drawn_whole(both, learned):
    """In curves and in fields, in whichever order the models come."""
    first, second = both
    worse = replace(second, motion=replace(second.motion, values=10 * second.motion.values))
    for pair in ([first, worse], [worse, first]):
        for factor in CONDITIONS:
            axes = factor_figure(pair, factor).axes[0]
            low, high = axes.get_ylim()
            drawn = np.concatenate(
                [line.get_ydata() for line in axes.get_lines() if line.get_marker() in (".", "o")]
            )
            bars = [bar for entry in axes.containers for bar in entry.lines[2][0].get_segments()]
            drawn = np.concatenate([drawn, *(bar[:, 1] for bar in bars)])
            assert low <= drawn.min() and drawn.max() <= high, factor
        figures = residual_figures(pair, learned[0])
        for name in ("motion.table_place", "motion.contact_place"):
            views = [(axes.get_xlim(), axes.get_ylim()) for axes in
                     (figures[name].axes[0], figures[f"{name}.second"].axes[0])]  # fmt: skip
            assert views[0] == views[1]
        assert figures["motion.table_place"].axes[0].get_title(loc="left").endswith(pair[0].label)


def test_curves_show_means_over_pushes(learned):
    """Dots of a curve: each push once in each bin, at the mean of its pieces there."""
    result = learned[2]
    motion = result.motion
    component = next(p for p in result.structure if (p.factor, p.quantity) == ("order", "motion")).strongest
    axes = factor_figure([result], "order").axes[0]
    assert axes.get_title(loc="left").lower() == component.split("; ")[0].lower()
    dots = np.concatenate([line.get_xdata() for line in axes.get_lines() if line.get_marker() == "."])
    assert len(dots) == len(np.unique(motion.at.push))
    assert set(CONDITIONS) == {"speed", "table_direction", "object_direction", "phase", "time", "order"}


def test_terminal_and_page_call_a_p_the_same(learned, capsys):
    """The terminal has only the p that counts, the page that of the single test too."""
    result = learned[2]
    show_comparison([result])
    said = capsys.readouterr().out
    assert re.search(r"size +p, all tests$", said, re.M)
    text = report([result], learned[0], "pushes")
    assert ">p, this test</th>" in text and ">p, all tests</th>" in text


def test_a_few_pushes_still_have_means_over_their_order(learned):
    """Pushes stand where they were made; those in a row share a bin, which so has a mean and an interval."""
    result = learned[2]
    pushes = np.unique(result.motion.at.push)
    axes = factor_figure([result], "order").axes[0]
    places = np.concatenate([line.get_xdata() for line in axes.get_lines() if line.get_marker() == "."])
    np.testing.assert_allclose(places, 1.0 + pushes)
    assert len(axes.containers) == max(1, len(pushes) // 3)


def test_no_arrow_leaves_its_picture(learned):
    """Short pushes at the corners of a square, whose residuals all point outwards."""
    motion = learned[2].motion
    place = 0.2 * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])[motion.at.push]
    values = np.column_stack([motion.scale[motion.at.push][:, None] * place, np.zeros(len(place))])
    outwards = replace(motion, at=replace(motion.at, place=place), values=values)
    axes = table_figure(replace(learned[2], motion=outwards)).axes[0]
    arrows = next(drawn for drawn in axes.collections if isinstance(drawn, Quiver))
    tips = arrows.XY + np.column_stack([arrows.U, arrows.V])
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    assert len(tips) == 4 and (tips > [x0, y0]).all() and (tips < [x1, y1]).all()


def test_compare_with_a_belief_writes_report_and_numbers(slipmap, demo_folder, tmp_path):
    folder = demo_folder / "demo"
    html, numbers = tmp_path / "r.html", tmp_path / "r.json"
    said = slipmap(
        "compare", folder / "pushes", "--belief", folder / "belief.npz", "-o", html, "--json", numbers
    )
    assert said.code == 0, said.err
    document = json.loads(numbers.read_text())
    add = document["totals"]["heldout"]["model"]["final_add"]
    assert f"{1e3 * add:.1f}" in said.out and "noise floor" in said.out
    assert "drawing: done" in said.err and f"report: {html}" in said.err
    assert max(map(len, said.out.splitlines())) <= 80
    assert "cannot show whether" in Page(html.read_text()).text
    predicted = json.loads((folder.parent / "demo.json").read_text())["heldout_error_mean"]
    assert add == pytest.approx(predicted, rel=1e-9)  # the demo judged the same belief on the same pushes


def test_compare_without_a_belief_learns_first(slipmap, demo_folder, tmp_path):
    said = slipmap("compare", demo_folder / "demo" / "pushes", "-o", tmp_path / "r.html")
    assert said.code == 0, said.err
    assert "hypotheses: done" in said.err and "predicting: done" in said.err


def test_compare_refuses_what_it_cannot_use(slipmap, demo_folder, tmp_path):
    hammer = demo_folder / "demo" / "pushes"
    said = slipmap("compare", hammer, "--belief", tmp_path / "no.npz", "-o", tmp_path / "r.html")
    assert said.code == 2 and "no.npz" in said.err
    heldout = tmp_path / "heldout"
    shutil.copytree(hammer, heldout)
    description = heldout / "dataset.yaml"
    description.write_text(description.read_text().replace("role: fit", "role: heldout"))
    said = slipmap("compare", heldout, "-o", tmp_path / "r.html")
    assert said.code == 2 and "--belief" in said.err and "fit" in said.err
    assert not (tmp_path / "r.html").exists()
