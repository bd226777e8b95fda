"""What an object's coasting tells that slow pushing does not: where its weight is."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from slipmap.models.inference.belief import Belief
from slipmap.models.inference.error_model import sensor_noise
from slipmap.models.inference.identification import identify
from slipmap.models.inference.observations import observe_all
from slipmap.models.inference.prediction import drawn_ends, predicted_motion
from slipmap.models.inference.prior import slider_for
from slipmap.models.measurements import Noise
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Maps, Push, Slider
from slipmap.planners.table_push import TablePush

RADIUS = 0.008


def pushes(speed: float, creep: float) -> list[Push]:
    """Against the sides of a bar of 200 by 60 mm, away from its middle."""
    result = []
    for x, side in ((-0.07, -1), (0.06, 1), (-0.03, 1), (0.08, -1)):
        begin = np.array([x, side * (0.03 + RADIUS + 0.01)])
        push = TablePush(begin, begin - [0.0, side * 0.06], speed, creep)
        pace = push.pace(1.0, 1.0)
        times = 1e-3 * np.arange(int(1e3 * (pace.duration + 0.6)))
        result.append(Push(1e-3, begin + np.outer(pace.at(times - 0.1), push.direction), np.zeros(3)))
    return result


def test_the_noise_of_the_fingers_track_widens_where_a_tapped_object_may_stop():
    grid = cells_from_polygon([[-0.1, -0.03], [0.1, -0.03], [0.1, 0.03], [-0.1, 0.03]], count=40)
    slider, n = Slider(grid, RADIUS), len(grid)
    truth = Maps(np.full((1, n), 1.0 / n), np.full((1, n), 0.15), np.array([0.3]))
    spread = {}
    for jitter in (0.0, 1e-4):
        for name, speed, creep in (("slow", 0.05, 0.0), ("taps", 0.3, 0.014)):
            rng, sensors = np.random.default_rng(0), Noise(position=1e-5, angle=1e-5, tip=jitter)
            dataset = record_pushes(slider, truth, pushes(speed, creep), rng, noise=sensors)
            observations = observe_all(dataset)
            sure = Maps(*(np.repeat(part, 16, axis=0) for part in (truth.mass, truth.mu, truth.mu_finger)))
            belief = Belief.learned(
                dataset, slider_for(dataset), sure, np.full(16, 1 / 16), method="gauss-newton", seed=0,
                trials=[], settings={},
            )  # fmt: skip
            ends = drawn_ends(belief, observations, sensor_noise(dataset))
            spread[name, jitter] = np.median(ends[..., 1].std(axis=0))
    assert spread["taps", 1e-4] > 2e-4 > 10 * spread["taps", 0.0]
    assert spread["slow", 1e-4] < 3e-5
    middle = predicted_motion(belief, observations)
    for b, motion in enumerate(middle):
        assert ends[:, b].mean(axis=0) == pytest.approx(motion.middle_poses[-1], abs=2e-5)
    # Opposites are neighbours, so that few hypotheses see both.
    first, opposite = (
        np.concatenate([o.likely_pushes[i].tip - o.push.tip for o in observations]) for i in (0, 1)
    )
    assert np.std(first + opposite) < 0.7 * np.std(first - opposite)
    # They would take more memory than all the rest, so they are drawn anew, the same.
    again = observations[0].likely_pushes
    assert all((a.tip == b.tip).all() for a, b in zip(again, observations[0].likely_pushes, strict=True))
    assert len(pickle.dumps(observations[0])) < sum(push.tip.nbytes for push in again)
    few = replace(belief, maps=belief.maps[:3], probability=np.full(3, 1 / 3))
    assert drawn_ends(few, observations, sensor_noise(dataset)).shape == (3, 4, 3)


def test_taps_find_a_heavy_end_that_slides_easily():
    grid = cells_from_polygon([[-0.1, -0.03], [0.1, -0.03], [0.1, 0.03], [-0.1, 0.03]], count=40)
    heavy = grid.centers[:, 0] < 0
    mass = np.where(heavy, 3.0, 1.0)
    mass *= 0.6 / mass.sum()
    truth = Maps(mass, np.where(heavy, 0.2, 0.4), np.array([0.3]))
    slider = Slider(grid, RADIUS)
    true = mass @ grid.centers[:, 0] / mass.sum()
    off = {}
    for name, speed, creep in (("slow", 0.05, 0.0), ("taps", 0.3, 0.014)):
        rng = np.random.default_rng(0)
        belief = identify(record_pushes(slider, truth, pushes(speed, creep), rng), friction_laws=False).belief
        off[name] = abs(belief.probability @ belief.centers_of_mass[:, 0] - true)
    assert off["taps"] < 0.005
    assert off["slow"] > 2 * off["taps"]
