"""Whether mass and moment of inertia count as shown."""

from dataclasses import replace

import numpy as np
import pytest

from slipmap.models.inference.identification import identify
from slipmap.models.inference.results import Quantity
from slipmap.models.measurements import PushDataset
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.planners.exploration import candidate_pushes

FRICTION = 4.0  # N
INERTIAL = ("total mass", "moment of inertia about the centre of mass")


def pushed(mu: float, speed: tuple[float, float]) -> tuple[PushDataset, float]:
    """Pushes of a block that always has the same friction force, and its mass, kg."""
    grid = cells_from_polygon([[-0.05, -0.03], [0.05, -0.03], [0.05, 0.03], [-0.05, 0.03]])
    slider = Slider(grid, finger_radius=0.006)
    mass, n = FRICTION / slider.gravity / mu, len(grid)
    maps = Maps(np.full((1, n), mass / n), np.full((1, n), mu), np.array([0.25]))
    rng = np.random.default_rng(1)
    pushes = [
        candidate.push([0.0, 0.0, rng.uniform(-3.0, 3.0)])
        for candidate in candidate_pushes(grid, 0.006, rng, 8, length=(0.03, 0.05), speed=speed)
    ]
    return record_pushes(slider, maps, pushes, rng, rate=100.0), mass


def learned(dataset: PushDataset) -> dict[str, Quantity]:
    result = identify(dataset, hypotheses=8, friction_laws=False)
    return {quantity.name: quantity for quantity in result.quantities}


@pytest.mark.parametrize("mu", [0.05, 1.2])
def test_slow_pushes_show_friction_but_neither_mass_nor_moment_of_inertia(mu):
    dataset, _ = pushed(mu, (0.004, 0.005))
    facts = learned(dataset)
    assert facts["total friction"].shown
    for name in INERTIAL:
        assert not facts[name].shown and "friction outweighs inertia" in facts[name].reason
    # What friction and its prior allow: 0.3 within a factor of three.
    mass = facts["total mass"]
    assert mass.low < FRICTION / 9.81 / 0.9 and mass.high > FRICTION / 9.81 / 0.1


def test_fast_pushes_show_mass_and_moment_of_inertia():
    dataset, mass = pushed(0.3, (0.2, 0.3))
    facts = learned(dataset)
    assert all(facts[name].shown for name in INERTIAL)
    assert facts["total mass"].low < mass < facts["total mass"].high
    assert facts["total mass"].high < 1.5 * facts["total mass"].low


def test_a_weighed_mass_is_shown_even_by_slow_pushes():
    dataset, mass = pushed(0.3, (0.004, 0.005))
    facts = learned(replace(dataset, mass=mass))
    assert facts["total mass"].shown
    assert not facts["moment of inertia about the centre of mass"].shown
