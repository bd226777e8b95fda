"""What one of several datasets says by itself about an effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import slipmap
from slipmap.models.effects.library import TableTilt
from slipmap.models.inference.observations import observe_all
from slipmap.models.inference.together import Taught, Together, alone

TILT = TableTilt()


def pushed(slope: float, seed: int, half: tuple[float, float]) -> slipmap.PushDataset:
    """Pushes of a rectangle on a table with a slope along x, each predicted by the model."""
    rng = np.random.default_rng(seed)
    x, y = half
    grid = slipmap.cells_from_polygon([[-x, -y], [x, -y], [x, y], [-x, y]])
    masses = np.exp(0.3 * rng.standard_normal(len(grid.centers)))
    truth = slipmap.Maps(0.6 * masses[None] / masses.sum(), np.full((1, len(masses)), 0.3), np.array([0.2]))
    truth = replace(truth, effects=np.array([[slope, 0.0]]))
    slider = slipmap.Slider(grid, finger_radius=0.008, effects=(TILT,))
    pushes = [
        one.push(np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(-3.0, 3.0)]))
        for one in slipmap.candidate_pushes(grid, 0.008, rng, 6)
    ]
    return slipmap.record_pushes(slider, truth, pushes, rng, heldout=0, name=f"slope {slope}")


@pytest.fixture(scope="module")
def datasets():
    return [pushed(0.04, 3, (0.06, 0.03)), pushed(0.0, 2, (0.045, 0.045))]


def silent(done: int, total: int) -> None:
    """Report nothing."""


def test_a_level_table_is_level_though_maps_were_bent_to_a_slope(datasets):
    """The joint slope lies between the two; each dataset by itself knows better."""

    taught = [Taught.of(one, observe_all(one), silent) for one in datasets]
    together = Together(taught)
    (first,) = together.first_gains([TILT], silent)
    found = together.refined(together.fitted([TILT], [first.start]), silent)
    before = found.values(0).copy(), found.found.z.copy()
    for k, slope in enumerate((0.04, 0.0)):
        values, deviations = alone(found, k)
        assert abs(values[0] - slope) < 3.0 * deviations[0] and deviations[0] < 0.015
        assert abs(found.values(k)[0] - slope) > 0.005
        # A fit of this dataset alone, with the prior of the effect.
        single = Together(taught[k : k + 1])
        own = single.refined(single.fitted([TILT], [first.start]), silent)
        precision = deviations[0] ** -2, TILT.parameters[0].scale ** -2
        assert own.values(0)[0] == pytest.approx(values[0] * precision[0] / sum(precision), abs=3e-3)
    assert found.values(0) == pytest.approx(before[0]) and found.found.z == pytest.approx(before[1])


def test_one_push_alone_may_know_less_than_the_prior(datasets):
    """What a dataset says is its own, and not what is expected of tables."""
    one = replace(datasets[0], trials=datasets[0].trials[:1])
    together = Together([Taught.of(each, observe_all(each), silent) for each in (datasets[0], one)])
    (first,) = together.first_gains([TILT], silent)
    _, deviations = alone(together.refined(together.fitted([TILT], [first.start]), silent), 1)
    assert deviations[0] > TILT.parameters[0].scale
