"""A simulated object, pushed and recorded, whose maps are known."""

from dataclasses import dataclass

import numpy as np
import pytest

from slipmap.models.measurements import PushDataset
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.planners.exploration import candidate_pushes


@dataclass(frozen=True)
class Recorded:
    """Pushes of an L whose one arm is heavier and rougher."""

    slider: Slider
    truth: Maps
    dataset: PushDataset

    @property
    def center_of_mass(self) -> np.ndarray:
        return self.truth.mass[0] @ self.slider.grid.centers / self.truth.mass.sum()

    @property
    def friction(self) -> float:
        return float((self.truth.mass * self.truth.mu).sum() * self.slider.gravity)


@pytest.fixture(scope="session")
def recorded() -> Recorded:
    """Six pushes to fit and four held out, with sensor noise."""
    rng = np.random.default_rng(5)
    grid = cells_from_polygon(
        [[-0.07, -0.05], [0.07, -0.05], [0.07, 0.0], [-0.02, 0.0], [-0.02, 0.06], [-0.07, 0.06]], count=36
    )
    slider = Slider(grid, 0.006)
    heavy = grid.centers[:, 0] < -0.02
    mass = np.where(heavy, 0.04, 0.012)
    truth = Maps(mass, np.where(heavy, 0.35, 0.25), np.array([0.3]))
    pushes = [
        candidate.push([0.05, -0.02, 0.7])
        for candidate in candidate_pushes(grid, 0.006, rng, 10, length=(0.06, 0.1))
    ]
    return Recorded(
        slider, truth, record_pushes(slider, truth, pushes, rng, heldout=4, mass=float(mass.sum()))
    )
