"""Datasets of very many pushes or cells: part of the pushes teach, and neighbouring cells are merged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slipmap.diagrams.application.commands.identify import show
from slipmap.diagrams.application.reports.diagnosis_words import evidence
from slipmap.models.effects import LIBRARY
from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.diagnosis.procedure import diagnose
from slipmap.models.inference.diagnosis.several import fit_together
from slipmap.models.inference.identification import identify, spread_out, with_fewer_cells
from slipmap.models.inference.observations import to_learn_from
from slipmap.models.inference.prediction import predict
from slipmap.models.inference.prior import STRUCTURES, MapPrior, slider_for
from slipmap.models.measurements import KnownMaps
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects.footprints import cells_from_polygon
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.rollout import Slider
from slipmap.planners import telling_push
from slipmap.planners.exploration import candidate_pushes


def test_of_very_many_pushes_some_teach_wherever_one_asks(recorded, monkeypatch, capsys) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setattr("slipmap.models.inference.observations.MOST_PUSHES", 4)
    learned = identify(recorded.dataset, hypotheses=2, friction_laws=False)
    taught = learned.belief.settings["fit_trials"]
    fit = [trial.name for trial in recorded.dataset.fit_trials]
    assert len(taught) == 4 and taught == [name for name in fit if name in taught]
    assert len(learned.pushes) == len(recorded.dataset.trials)
    diagnosis = diagnose(recorded.dataset, draws=99, effects=effects_named(["table_tilt"], LIBRARY))
    assert list(diagnosis.open_trials) == taught
    assert evidence(diagnosis).startswith("Based on 4 pushes, drawn at random from 6; 4 more were")
    show(learned, recorded.dataset, None)
    said = " ".join(capsys.readouterr().out.split())
    assert "6 pushes to fit (4 of them, drawn at random, were learned from), 4 held out" in said


def test_pushes_are_drawn_from_all_and_keep_their_order() -> None:
    drawn = to_learn_from(range(3000))
    assert len(drawn) == 400 and drawn == sorted(set(drawn))
    assert 1350 < np.mean(drawn) < 1650 and drawn == to_learn_from(range(3000))
    assert to_learn_from(range(400)) == list(range(400))


def test_merged_cells_cover_the_object(recorded) -> None:  # type: ignore[no-untyped-def]
    fine = replace(recorded.dataset, grid=cells_from_polygon(recorded.slider.grid.exterior, count=1000))
    few = with_fewer_cells(fine)
    assert 0.25 * len(fine.grid) <= len(few.grid) < 0.35 * len(fine.grid)
    assert few.grid.width == pytest.approx(2.0 * fine.grid.width)
    apart = np.hypot(*(fine.grid.centers[:, None] - few.grid.centers).transpose(2, 0, 1)).min(axis=1)
    assert apart.max() <= np.sqrt(0.5) * fine.grid.width * (1.0 + 1e-9)
    assert with_fewer_cells(recorded.dataset) is recorded.dataset
    finger = replace(fine, known=KnownMaps(finger_friction=0.3))
    assert len(with_fewer_cells(finger).grid) == len(few.grid)
    known = replace(
        fine, known=KnownMaps(mass=np.full(len(fine.grid), float(recorded.dataset.mass) / len(fine.grid)))
    )
    assert with_fewer_cells(known) is known


def test_cells_too_small_for_their_distance_are_merged_all_the_same(recorded) -> None:  # type: ignore[no-untyped-def]
    grid = cells_from_polygon(recorded.slider.grid.exterior, count=1000)
    tiny = CellGrid(grid.centers, 1e-9, grid.exterior)
    assert len(with_fewer_cells(replace(recorded.dataset, grid=tiny)).grid) <= 800


@pytest.mark.parametrize("sides", [(29, 28), (41, 21), (31, 27), (900, 1)])
def test_the_prior_of_merged_cells_expects_a_uniform_object(recorded, sides) -> None:  # type: ignore[no-untyped-def]
    """Blocks at the edges hold fewer cells than the others."""
    x, y = (4e-3 * (np.arange(count) - 0.5 * (count - 1)) for count in sides)
    half = 2e-3 * np.array(sides)
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    grid = CellGrid(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2), 4e-3, corners)
    fine = replace(recorded.dataset, grid=grid, mass=1.0)
    few = with_fewer_cells(fine)
    prior = MapPrior(slider_for(few), STRUCTURES["smooth"], few.mass)
    middle = prior.maps(np.zeros((1, prior.size)))
    belief = Belief.learned(
        few, prior.slider, middle, np.ones(1), method="gauss-newton", seed=0, trials=(), settings={}
    )
    spread = spread_out(belief, fine)
    np.testing.assert_allclose(spread.maps.mass, 1.0 / len(grid), rtol=1e-9)
    np.testing.assert_allclose(spread.centers_of_mass, 0.0, atol=1e-9)
    # Coordinates found from maps give these maps again.
    z = prior.near(middle)
    np.testing.assert_allclose(z, 0.0, atol=1e-6)


def test_a_belief_from_merged_cells_is_about_the_datasets_own(recorded, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    fine = replace(recorded.dataset, grid=cells_from_polygon(recorded.slider.grid.exterior, count=240))
    all_cells = identify(fine, hypotheses=4, friction_laws=False)
    monkeypatch.setattr("slipmap.models.inference.identification.MOST_CELLS", 100)
    learned = identify(fine, hypotheses=4, friction_laws=False)
    belief = learned.belief
    assert len(belief.grid) == len(fine.grid) and belief.fingerprint == fine.fingerprint
    assert spread_out(belief, fine) is belief
    # What is learned is what all cells would have taught, and `predict` gives the same ends.
    assert belief.probability @ belief.friction_forces == pytest.approx(recorded.friction, rel=0.02)
    load, truth = (maps.mass * maps.mu for maps in (belief.maps, recorded.truth))
    center = belief.probability @ (load @ fine.grid.centers / load.sum(axis=1, keepdims=True))
    true_center = truth[0] @ recorded.slider.grid.centers / truth.sum()
    np.testing.assert_allclose(center, true_center, atol=1e-3)
    assert learned.errors("heldout").mean() < all_cells.errors("heldout").mean() + 2e-4
    ends = [push.predicted[-1] for push in learned.pushes]
    again = [push.predicted[-1] for push in predict(belief, fine)]
    np.testing.assert_allclose(again, ends, atol=1e-12)


def test_fits_and_diagnoses_merge_cells_too(recorded, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    tilt, rng = effects_named(["table_tilt"], LIBRARY)[0], np.random.default_rng(3)
    grid = recorded.slider.grid
    candidates = candidate_pushes(grid, 0.006, rng, 10, length=(0.06, 0.1))
    pushes = [one.push([0.05, -0.02, 0.7]) for one in candidates]
    tilted = replace(recorded.truth, effects=np.array([[0.08, 0.0]]))
    slider = Slider(grid, 0.006, effects=[tilt])
    dataset = record_pushes(slider, tilted, pushes, rng, heldout=3, mass=recorded.dataset.mass)
    fine = replace(dataset, grid=cells_from_polygon(grid.exterior, count=100))
    monkeypatch.setattr("slipmap.models.inference.identification.MOST_CELLS", 50)
    fitted = identify(fine, ["table_tilt"], hypotheses=2)
    assert len(fitted.belief.grid) == len(fine.grid)
    assert fitted.effect_estimates["table_tilt"]["down_x"]["value"] == pytest.approx(0.08, rel=0.1)
    found = telling_push.diagnose(
        fine, quick=True, effects=effects_named(["table_tilt", "sensor_latency"], LIBRARY)
    )
    assert found.effects == ("table_tilt",)
    assert found.with_effects is not None and len(found.with_effects.belief.grid) == len(fine.grid)
    assert found.next_push is not None
    unsure = telling_push.diagnose(fine.with_fit_pushes(3), quick=True)
    assert unsure.verdict == "undecided" and unsure.next_push is not None
    assert telling_push.rivals_of(unsure, fine)
    halves = [replace(fine, trials=fine.trials[k::2], name=str(k)) for k in range(2)]
    together = fit_together(halves, ["table_tilt"], hypotheses=2)
    assert [len(one.belief.grid) for one in together.learned] == [len(fine.grid)] * 2
