"""Laws of friction besides the plain one.

In the plain model each cell carries the weight of its own mass, however the object is pushed, and slides with
Coulomb friction. It leaves out two things that hold for some recorded pushes and not for others:

- a finger that pushes above the table shifts load to the object's front, by about its height times friction.
  Where the object's height is known, half of it is assumed, with much doubt;
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

_UNMEASURED = {"push_height": (0.005, 0.005), "mass_height": (0.015, 0.01)}
"""The same for an object of unknown height, m, that of the push above the finger's lower end: most objects
on a table are a few centimetres high."""


def effect_prior(effects: Sequence[Effect], dataset: PushDataset) -> tuple[FloatArray, FloatArray]:
    """Prior means and standard deviations (P,) of the laws' parameters, given what is known of heights."""
    every = [parameter for effect in effects for parameter in effect.parameters]
    if not every:
        return np.zeros(0), np.zeros(0)
    rows = []
    for parameter in every:
        mean, deviation = _EXPECTED[parameter.name]
        if parameter.unit == "m" and dataset.height is not None:
            mean, deviation = mean * dataset.height, deviation * dataset.height
        elif parameter.unit == "m":
            mean, deviation = _UNMEASURED[parameter.name]
            mean += (dataset.finger_height or 0.0) * (parameter.name == "push_height")
        rows.append((mean, deviation))
    means, deviations = np.array(rows).T
    return np.clip(means, *bounds(effects)), deviations


def beside_slope(effects: Sequence[Effect], dataset: PushDataset) -> tuple[Effect, ...]:
    """What a slope brings with it if the finger's height is stated: `load_transfer`, unless it is given.

    On a slope gravity acts at the height of the centre of mass and shifts load downhill; a finger that pushes
    uphill shifts it back. Without either a slope is estimated up to a tenth too steep (docs/lab/adapt.md).
    """
    sloping = any(type(effect).downhill is not Effect.downhill for effect in effects)
    if not sloping or dataset.finger_height is None:
        return ()
    return tuple(e for e in LIBRARY if e.name == "load_transfer" and e not in effects)


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
