"""What an object's coasting tells that slow pushing does not: where its weight is."""

import numpy as np

from slipmap.models.inference.identification import identify
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
