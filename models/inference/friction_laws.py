"""Laws of friction besides the plain one.

In the plain model each cell carries the weight of its own mass, however the object is pushed, and slides with
Coulomb friction. It leaves out two things that hold for some recorded pushes and not for others:

- a finger that pushes above the table shifts load to the object's front, by about its height times friction.
  The finger's height is seldom recorded; half the object's height is assumed;
- a simulator that solves for friction impulse by impulse makes it lean towards the world axis along which an
  impulse meets more mass, as Bullet's solver for articulated bodies does.
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
"""Separator between the effects in a law's name."""

_EXPECTED = {
    "push_height": (0.5, 0.15),
    "mass_height": (0.5, 0.05),
    "share": (1.0, 0.01),
}
"""Prior mean and standard deviation of the laws' parameters; heights in units of the object's height.
Friction leans as in Bullet, or not at all."""


def effect_prior(effects: Sequence[Effect], height: float | None) -> tuple[FloatArray, FloatArray]:
    """Prior means and standard deviations (P,) of the laws' parameters, given the object's height, m."""
    every = [parameter for effect in effects for parameter in effect.parameters]
    if not every:
        return np.zeros(0), np.zeros(0)
    units = [height if parameter.unit == "m" else 1.0 for parameter in every]
    rows = np.array([_EXPECTED[parameter.name] for parameter in every])
    means, deviations = (rows * np.array(units, dtype=float)[:, None]).T
    return np.clip(means, *bounds(effects)), deviations


def combinations(dataset: PushDataset, given: Sequence[Effect]) -> list[tuple[Effect, ...]]:
    """Effects of each law, except the plain one, that the dataset can decide on besides the given ones."""
    known = {effect.name: effect for effect in LIBRARY}
    transfer, lean = known["load_transfer"], known["impulse_friction"]
    # The load shifts by height times force over weight: for an object that was not weighed, other model
    # errors would be mistaken for a small weight.
    if dataset.height is None or dataset.mass is None:
        laws: list[tuple[Effect, ...]] = [(lean,)]
    else:
        laws = [(lean,), (transfer,), (transfer, lean)]
    return [law for law in laws if not set(law) & set(given)]


def name_of(effects: Sequence[Effect]) -> str:
    """Name of the law with these effects."""
    return TOGETHER.join(effect.name for effect in effects) or PLAIN
