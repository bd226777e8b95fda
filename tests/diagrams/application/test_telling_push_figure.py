"""The picture of the next push shows every rival's end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.patches import PathPatch

from slipmap.diagrams.application.figures import telling_push_figure
from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.diagnosis.correlated import CorrelatedLikelihood, FitData
from slipmap.models.inference.diagnosis.fitting import Fitted, Fitter
from slipmap.models.inference.diagnosis.results import Diagnosis
from slipmap.models.inference.error_model import ErrorModel, sensor_noise
from slipmap.models.inference.observations import observe_all
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.planners.exploration import candidate_pushes
from slipmap.planners.telling_push import next_push


def test_outlines_of_the_start_and_of_every_rivals_end():
    grid = cells_from_polygon(np.array([[-4, -2], [4, -2], [4, 2], [-4, 2]]) * 0.01, width=0.02)
    rng, n = np.random.default_rng(0), len(grid)
    maps = Maps(np.full((1, n), 0.5 / n), np.full((1, n), 0.3), np.array([0.35]))
    pushes = [c.push([0.0, 0.0, 0.2]) for c in candidate_pushes(grid, 0.006, rng, 3)]
    dataset = record_pushes(Slider(grid, 0.006), maps, pushes, rng, mass=0.5)
    observations, noise = observe_all(dataset), sensor_noise(dataset)
    fitter = Fitter(dataset, observations, noise)

    def model(names, values):
        effects = effects_named(names)
        prior = fitter.prior(effects)
        z = np.zeros(prior.size)
        z[prior.plain :] = prior.effect_coordinates(np.array(values))
        likelihood = CorrelatedLikelihood(
            prior, FitData(observations, prior.slider.grid), ErrorModel(noise, 0.03, 0.05)
        )
        return Fitted(effects, likelihood, z, np.zeros(prior.size), np.zeros((3, 3)), 0.0)

    rivals = (model(["table_tilt"], [0.08, 0.0]), model(["skate"], [0.3, 0.5, 0.0, 0.0]))
    diagnosis = Diagnosis(
        "ambiguous", "", rivals[0], ("table_tilt", "skate"), rivals=rivals, candidates=(), p_value=None,
        open_trials=(), locked=(), without_effects=None, with_effects=None, base=model([], []),
        motion_error=0.03, force_error=0.05, quick=True, seconds=0.0, seed=0,
    )  # fmt: skip
    told, _ = next_push(diagnosis, dataset, 0)
    figure = telling_push_figure(told, diagnosis, dataset)
    outlines = [patch for patch in figure.axes[0].patches if isinstance(patch, PathPatch)]
    assert len(outlines) == 3
    middles = [outline.get_path().vertices[:4].mean(axis=0) for outline in outlines]
    assert np.allclose(middles[0], told["pose"][:2], atol=1e-6)
    assert min(np.hypot(*(middle - middles[0])) for middle in middles[1:]) > 5e-3
    assert [text.get_text() for text in figure.legends[0].get_texts()][1:] == ["table_tilt", "skate"]

    crowded = telling_push_figure(told, replace(diagnosis, rivals=3 * rivals), dataset)
    crowded.draw_without_rendering()
    legend = crowded.legends[0].get_window_extent()
    assert len(crowded.legends[0].get_texts()) == 7
    assert all(axes.get_tightbbox().y0 >= legend.y1 for axes in crowded.axes)


def test_no_picture_without_a_proposed_push():
    with pytest.raises(ValueError, match="the diagnosis proposes no push"):
        telling_push_figure(None, None, None)
