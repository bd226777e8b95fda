"""What friction may follow besides the plain law.

The plain model lets each cell carry the weight of its mass, however it is pushed, and slide against Coulomb's
friction. Two things are left out that hold for some recorded pushes and not for others:

- a finger that pushes above the table loads the object's front, by about its height times friction. How
  high the finger was is seldom recorded; half the object's height is the guess;
- a simulator that solves for friction impulse by impulse makes it lean to the axis of the world along which
  an impulse meets more mass, as Bullet's solver for articulated bodies does.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slipmap.models.effects.effect import Effect, bounds
from slipmap.models.effects.library import LIBRARY
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import FloatArray

PLAIN = "plain"

TOGETHER = " + "
"""Between the effects in a law's name."""

_EXPECTED = {
    "push_height": (0.5, 0.15),
    "mass_height": (0.5, 0.05),
    "share": (1.0, 0.01),
}
"""Prior mean and standard deviation of the laws' parameters; heights in those of the object. Friction leans
as in Bullet, or not at all."""


def effect_prior(effects: Sequence[Effect], height: float | None) -> tuple[FloatArray, FloatArray]:
    """Prior means and standard deviations (P,) of the laws' parameters, for an object of some height, m."""
    every = [parameter for effect in effects for parameter in effect.parameters]
    if not every:
        return np.zeros(0), np.zeros(0)
    units = [height if parameter.unit == "m" else 1.0 for parameter in every]
    rows = np.array([_EXPECTED[parameter.name] for parameter in every])
    means, deviations = (rows * np.array(units, dtype=float)[:, None]).T
    return np.clip(means, *bounds(effects)), deviations


def combinations(dataset: PushDataset, given: Sequence[Effect]) -> list[tuple[Effect, ...]]:
    """Effects of each law but the plain one that the dataset can be asked about beside the given ones."""
    known = {effect.name: effect for effect in LIBRARY}
    transfer, lean = known["load_transfer"], known["impulse_friction"]
    # The load shifts by height times force over weight: of an object that nobody weighed, other faults of the
    # model would be taken for a small weight.
    if dataset.height is None or dataset.mass is None:
        laws: list[tuple[Effect, ...]] = [(lean,)]
    else:
        laws = [(lean,), (transfer,), (transfer, lean)]
    return [law for law in laws if not set(law) & set(given)]


def name_of(effects: Sequence[Effect]) -> str:
    """Name of the law with these effects."""
    return TOGETHER.join(effect.name for effect in effects) or PLAIN
