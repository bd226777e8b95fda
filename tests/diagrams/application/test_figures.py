"""Pictures: what they show, not how they look."""

from __future__ import annotations

import re
from dataclasses import replace
from html import unescape
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from slipmap.diagrams.application.campaigns.trials import Estimate
from slipmap.diagrams.application.figures import (
    calibration_figure,
    effect_figure,
    maps_figure,
    measured_figure,
    push_figures,
    save,
)
from slipmap.diagrams.application.figures.study_figures import curves_figure, inside_share
from slipmap.diagrams.application.figures.style import (
    PlainNumbers,
    keep_labels_inside,
    outline_path,
    placed,
    round_length,
)
from slipmap.diagrams.systems.look import FINGER, PAPER, top_of_scale
from slipmap.models.effects import LIBRARY
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.rollout import Maps
from slipmap.planners.exploration import candidate_pushes
from tests.made_predictions import made_prediction


def coloured(figure):
    """Axes with coloured cells: (values, norm) in the order of drawing, column by column."""
    found = []
    for axes in figure.axes:
        for collection in axes.collections:
            if (
                isinstance(collection, PolyCollection)
                and collection.get_array() is not None
                and axes.axison is False
            ):
                found.append((np.asarray(collection.get_array()), collection.norm))
    return found


def test_maps_show_the_most_probable_hypotheses_and_the_mean(belief):
    cells = coloured(maps_figure(belief, hypotheses=2))
    assert len(cells) == 3 * 3
    for column, k in enumerate((1, 2)):
        mass, mu, force = (values for values, _ in cells[3 * column : 3 * column + 3])
        np.testing.assert_allclose(mass, 1e3 * belief.maps.mass[k])
        np.testing.assert_allclose(mu, belief.maps.mu[k])
        np.testing.assert_allclose(force, 9.81 * belief.maps.mass[k] * belief.maps.mu[k])
    mass, mu, force = (values for values, _ in cells[6:])
    np.testing.assert_allclose(mass, 1e3 * belief.probability @ belief.maps.mass)
    np.testing.assert_allclose(force, 9.81 * belief.probability @ (belief.maps.mass * belief.maps.mu))


def test_each_row_has_one_scale_and_titles_give_probabilities(belief):
    truth = Maps(np.full((1, 24), 0.02), np.full((1, 24), 0.3), np.array([0.3]))
    figure = maps_figure(belief, truth=truth)
    norms = [norm for _, norm in coloured(figure)]
    assert len(norms) == 3 * 6
    for row in range(3):
        assert len({(norm.vmin, norm.vmax) for norm in norms[row::3]}) == 1
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert [title.split("\n")[0] for title in titles] == [
        "truth", "hypothesis 1", "hypothesis 2", "hypothesis 3", "hypothesis 4", "mean of",
    ]  # fmt: skip
    assert "40.0 %" in titles[1]
    labels = {axes.get_ylabel() for axes in figure.axes}
    assert {"g per cell", "N per cell"} <= labels


def test_neither_a_cell_nor_a_map_leaves_all_others_pale():
    values = np.linspace(0.5, 1.0, 24) * np.ones((7, 1))
    assert 0.95 < top_of_scale(values) <= 1.0
    one_cell, one_map = values.copy(), values.copy()
    one_cell[:, 3] = 100.0
    assert top_of_scale(one_cell) <= 1.5
    one_map[2] *= 100.0
    assert top_of_scale(one_map) <= 1.5
    assert top_of_scale(np.zeros((3, 4))) == 1.0


def test_marks_hide_no_centre_and_squares_no_outline(belief):
    """Nothing white lies over the dots of a footprint, and its outline is drawn after its squares."""
    (panel, *_) = maps_figure(belief).axes
    assert len(panel.lines[0].get_xdata()) == len(belief)
    assert all(line.get_color() != "white" for line in panel.lines)
    (squares,) = panel.collections
    outlines = [patch for patch in panel.patches if patch.get_edgecolor()[3] > 0]
    children = panel.get_children()
    assert [children.index(outline) > children.index(squares) for outline in outlines] == [True]


def test_scales_are_logarithmic_where_totals_differ_widely(belief):
    wide = Maps(
        belief.maps.mass * np.array([[1.0], [10.0], [100.0], [1.0]]), belief.maps.mu, belief.maps.mu_finger
    )
    mass, mu, _ = coloured(maps_figure(replace(belief, maps=wide)))[:3]
    assert isinstance(mass[1], LogNorm) and not isinstance(mu[1], LogNorm)


def pushes_of(belief, count):
    rng = np.random.default_rng(0)
    candidates = candidate_pushes(
        belief.grid, belief.finger_radius, rng, count, speed=(0.2, 0.2), length=(0.02, 0.03)
    )
    pushes = [candidate.push([0.0, 0.0, 0.4]) for candidate in candidates]
    dataset = record_pushes(belief.slider, belief.maps[1], pushes, rng, heldout=1, name="block")
    predictions = []
    for trial in dataset.trials:
        poses = trial.object_pose.values[10::20]
        hypotheses = np.stack([poses + np.array([0.0, 0.001 * (k + 1), 0.0]) for k in range(4)])
        predictions.append(
            made_prediction(
                trial.name,
                trial.role,
                times=trial.object_pose.time[10::20],
                measured=poses,
                hypotheses=hypotheses,
                final_add=0.0123,
                spread=0.0045,
            )
        )
    return predictions, dataset


def test_pushes_fill_pages_of_24_with_their_errors_in_the_titles(belief):
    predictions, dataset = pushes_of(belief, 26)
    first, second = push_figures(predictions, dataset)
    titles = [[axes.get_title() for axes in figure.axes] for figure in (first, second)]
    assert [len(page) for page in titles] == [24, 2]
    assert titles[0][0] == "000, fit\nADD 12.3 mm, spread 4.5 mm"
    assert titles[1][1].startswith("025, held out")


def test_a_push_panel_holds_measurement_hypotheses_and_finger(belief):
    predictions, dataset = pushes_of(belief, 2)
    (figure,) = push_figures(predictions, dataset)
    axes = figure.axes[0]
    shapes = [patch.get_path() for patch in axes.patches]
    shapes += [shape for many in axes.collections for shape in many.get_paths()]
    outlines = [shape.vertices for shape in shapes if len(shape.vertices) == 5]
    expected = [
        outline_path(dataset.grid, pose).vertices
        for pose in (
            dataset.trials[0].object_pose.values[0],
            predictions[0].measured[-1],
            *predictions[0].hypotheses[:, -1],
        )
    ]
    for shape in expected:
        assert any(np.allclose(shape, drawn) for drawn in outlines)
    assert len(outlines) == 1 + 2 * (1 + 4)
    tip = dataset.trials[0].tip_pose.values
    assert any(
        len(line.get_xydata()) == len(tip) and np.allclose(line.get_xydata(), tip) for line in axes.lines
    )
    low, high = np.array([axes.get_xlim(), axes.get_ylim()]).T
    everything = np.vstack([*expected, tip])
    assert (everything >= low).all() and (everything <= high).all()


def test_all_panels_of_a_page_have_one_scale(belief):
    predictions, dataset = pushes_of(belief, 3)
    (figure,) = push_figures(predictions, dataset)
    spans = {round(float(np.diff(axes.get_xlim())[0]), 9) for axes in figure.axes}
    assert len(spans) == 1


def test_only_what_was_measured_has_axes(belief):
    """Table and gap, and force over time where a push has it."""
    _, dataset = pushes_of(belief, 2)
    bare = replace(dataset, trials=tuple(replace(trial, ft_wrench=None) for trial in dataset.trials))
    assert [axes.get_ylabel() for axes in measured_figure(dataset).axes] == ["y, m", "gap, mm", "force, N"]
    alone = measured_figure(bare).axes
    assert [axes.get_ylabel() for axes in alone] == ["y, m", "gap, mm"]
    assert alone[1].get_xlabel().startswith("time")


def test_a_ring_is_where_the_finger_starts_and_a_dot_where_it_ends(belief):
    """Measured pushes are drawn like predicted ones, and the legend says so."""
    _, dataset = pushes_of(belief, 1)
    figure = measured_figure(dataset)
    marks = [line for line in figure.axes[0].get_lines() if line.get_marker() == "o"]
    for trial, (first, last) in zip(dataset.trials, zip(marks[::2], marks[1::2], strict=True), strict=True):
        pose, tip = trial.object_pose, trial.tip_pose
        np.testing.assert_allclose(np.ravel(first.get_data()), tip.at(pose.time[0]), atol=1e-9)
        np.testing.assert_allclose(np.ravel(last.get_data()), tip.at(pose.time[-1]), atol=1e-9)
        assert first.get_markerfacecolor() == PAPER and last.get_markerfacecolor() == FINGER
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["finger path:", "start", "end"]


def test_holes_are_part_of_an_outline_and_turn_with_it():
    ring = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.02
    grid = CellGrid(np.array([[0.015, 0.0]]), 0.01, ring, (0.5 * ring,))
    pose = [1.0, 2.0, np.pi / 2]
    np.testing.assert_allclose(placed(np.array([0.02, 0.0]), np.array(pose)), [1.0, 2.02])
    exterior, hole = outline_path(grid, pose).vertices.reshape(2, 5, 2)
    assert sorted(map(tuple, exterior[:4].round(9))) == [(x, y) for x in (0.98, 1.02) for y in (1.98, 2.02)]
    assert sorted(map(tuple, hole[:4].round(9))) == [(x, y) for x in (0.99, 1.01) for y in (1.99, 2.01)]
    # Opposite senses, so that the hole stays empty when filled.
    areas = [np.sum(ring[:-1, 0] * ring[1:, 1] - ring[1:, 0] * ring[:-1, 1]) for ring in (exterior, hole)]
    assert areas[0] > 0 > areas[1]


@pytest.mark.parametrize(("largest", "expected"), [(0.26, 0.2), (0.1, 0.1), (0.0999, 0.05), (7.0, 5.0)])
def test_bar_lengths_are_round(largest, expected):
    assert round_length(largest) == pytest.approx(expected)


def test_reliability_counts_truths_in_central_intervals():
    ranks = np.array([0.5, 0.26, 0.74, 0.9, 0.01])  # within 0, 48, 48, 80, 98 % of the middle
    np.testing.assert_allclose(inside_share(ranks, np.array([0.1, 0.5, 0.9, 1.0])), [0.2, 0.6, 0.8, 1.0])


def test_calibration_draws_a_curve_a_quantity(tmp_path):
    rng = np.random.default_rng(0)
    ranks = {name: rng.uniform(size=30) for name in ("centre of mass, x", "total friction", "position")}
    figure = calibration_figure(SimpleNamespace(objects=30, ranks=ranks))
    titles = [axes.get_title() for axes in figure.axes if axes.get_visible()]
    assert titles == ["centre of mass, x (30)", "total friction (30)", "position (30)"]
    curve = max(figure.axes[1].lines, key=lambda line: len(line.get_xydata())).get_xydata()
    np.testing.assert_allclose(curve[:, 1], inside_share(ranks["total friction"], curve[:, 0]))


@pytest.mark.parametrize("ending", ["png", "pdf", "svg"])
def test_figures_are_saved_and_leave_the_users_style_alone(belief, tmp_path, ending):
    with matplotlib.rc_context({"font.size": 33.0, "axes.spines.top": True}):
        save(maps_figure(belief), tmp_path / f"maps.{ending}")
        assert matplotlib.rcParams["font.size"] == 33.0 and matplotlib.rcParams["axes.spines.top"]
    start = (tmp_path / f"maps.{ending}").read_bytes()[:200]
    assert {"png": b"PNG", "pdf": b"%PDF", "svg": b"<?xml"}[ending] in start


COSTLY = "cost $5^{$ each"
"""A name that is no formula: matplotlib's parser of formulas refuses it."""


def words(figure, path):
    """What is written in a figure."""
    save(figure, path)
    return [unescape(text) for text in re.findall(r"<text[^>]*>([^<]*)</text>", path.read_text("utf-8"))]


def test_names_are_shown_as_they_are(belief, tmp_path):
    predictions, dataset = pushes_of(belief, 2)
    trials = (replace(dataset.trials[0], name=COSTLY), dataset.trials[1])
    dataset = replace(dataset, name=COSTLY, trials=trials)
    seen = replace(predictions[0].observation, trial=COSTLY)
    predictions[0] = replace(predictions[0], observation=seen)
    (figure,) = push_figures(predictions, dataset)
    written = words(figure, tmp_path / "pushes.svg")
    assert f"{COSTLY}: pushes as measured and as predicted" in written
    assert f"{COSTLY}, fit" in written
    written = words(maps_figure(replace(belief, dataset=COSTLY)), tmp_path / "maps.svg")
    assert any(text.startswith(f"{COSTLY}: belief with 4 hypotheses") for text in written)
    figure = curves_figure(COSTLY, {COSTLY: {COSTLY: [Estimate(0.01, 0.009, 0.011, 3)]}})
    assert words(figure, tmp_path / "curves.svg").count(COSTLY) == 3


def test_only_an_effect_is_drawn_as_one():
    with pytest.raises(TypeError, match=r"effect_figure draws an Effect.*, not a Maps"):
        effect_figure(Maps(np.ones((1, 4)), np.ones((1, 4)), np.ones(1)))


def test_formulas_of_an_effect_are_set_as_formulas(tmp_path):
    tilt = next(effect for effect in LIBRARY if effect.name == "table_tilt")
    written = "".join(words(effect_figure(tilt), tmp_path / "tilt.svg"))
    assert "the plain model, mm" in written
    assert "$" not in written and "mathrm" not in written


def test_an_effect_is_drawn_with_its_size_and_its_places():
    """The tether's anchor stands where the caption says, and formulas stand below what they are."""
    tether = next(effect for effect in LIBRARY if effect.name == "tether")
    figure = effect_figure(tether)
    (size,) = (text.get_text() for text in figure.texts if text.get_text().startswith("Full size: "))
    told = dict(re.findall(r"(\w+) (-?[\d.]+)(?: [\w/]+)?[,.]", size.removeprefix("Full size: ")))
    assert set(told) == {parameter.name for parameter in tether.parameters} and float(told["stiffness"]) > 0
    table = figure.axes[0]
    crosses = {tuple(line.get_xydata()[0]) for line in table.lines if line.get_marker() == "X"}
    names = {text.get_text(): text.xy for text in table.texts}
    assert names["anchor"] == pytest.approx((float(told["anchor_x"]), float(told["anchor_y"])), abs=1e-3)
    assert {names["anchor"], names["point"]} == crosses
    inside = table.get_xlim()[0] < names["anchor"][0] < table.get_xlim()[1]
    assert inside and table.get_ylim()[0] < names["anchor"][1] < table.get_ylim()[1]
    heights = {text.get_text(): text.get_position()[1] for text in figure.texts}
    meaning = heights["Force on the object, and torque about its origin:"]
    formulas = [y for text, y in heights.items() if text.startswith("$")]
    assert meaning > max(formulas) > min(formulas) > 0.0


@pytest.mark.parametrize(("low", "high", "some"), [(2.0, 7.0, "3"), (0.01, 100.0, "0.1")])
def test_logarithmic_axes_have_plain_numbers(tmp_path, low, high, some):
    figure = Figure()
    axes = figure.add_subplot()
    axes.plot([low, high], [low, high])
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(PlainNumbers())
    axes.yaxis.set_minor_formatter(PlainNumbers())
    axes.set_xticks([])
    written = words(figure, tmp_path / "axes.svg")
    assert some in written
    assert all(re.fullmatch(r"[0-9.]+", text) for text in written)


def test_logarithmic_scales_have_plain_numbers(belief, tmp_path):
    wide = Maps(
        belief.maps.mass * np.array([[1.0], [10.0], [100.0], [1.0]]), belief.maps.mu, belief.maps.mu_finger
    )
    written = words(maps_figure(replace(belief, maps=wide)), tmp_path / "maps.svg")
    assert {"0.01", "0.1", "1"} <= set(written) and not any("math" in text or "$" in text for text in written)


def test_labels_of_long_numbers_stay_inside_their_figure():
    figure = Figure(figsize=(3.6, 2.4))
    axes = figure.add_axes((0.1, 0.1, 0.88, 0.8))
    axes.plot([0.0, 1.0], [-125000.0, 0.0])
    axes.set(xlabel="time, s", ylabel="% of the speed")
    assert min(axes.get_tightbbox().min) < 0.0  # else there is nothing to mend
    keep_labels_inside(figure)
    inside = axes.get_tightbbox()
    assert min(inside.min) > 0.0 and inside.x1 <= figure.bbox.x1
    place = axes.get_position()
    keep_labels_inside(figure)
    assert np.allclose(axes.get_position().extents, place.extents)
