"""Laws of friction besides the plain one.

In the plain model each cell carries the weight of its own mass, however the object is pushed, and slides with
Coulomb friction. It leaves out two things that hold for some recorded pushes and not for others:

- a finger that pushes above the table shifts load to the object's front, by about its height times friction.
  Where the finger's height is not stated, half of the object's is assumed, with much doubt;
- a simulator that solves for friction impulse by impulse makes it lean towards the world axis along which an
  impulse meets more mass, as Bullet's solver for articulated bodies does.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from slipmap.models.effects.effect import Effect, bounds
from slipmap.models.effects.library import LIBRARY
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import FloatArray

PLAIN = "plain"

LAW_EFFECTS = ("load_transfer", "impulse_friction")
"""Effects that laws besides the plain one consist of."""

TOGETHER = " + "
"""Separator between the effects in a law's name."""

_EXPECTED = {"push_height": (0.5, 0.15), "mass_height": (0.5, 0.05), "share": (1.0, 0.01)}
"""Prior mean and standard deviation of the laws' parameters; heights in units of the object's height.
Friction leans as in Bullet, or not at all."""

_ABOVE_ITS_END = (0.005, 0.005)  # m; mean and deviation of where a finger touches, above its lower end
_OF_A_MASS = (0.015, 0.01)  # m; the same of a centre of mass: most objects on a table are a few cm high


def effect_prior(effects: Sequence[Effect], dataset: PushDataset) -> tuple[FloatArray, FloatArray]:
    """Prior means and standard deviations (P,) of the laws' parameters, given what is known of heights."""
    every = [parameter for effect in effects for parameter in effect.parameters]
    if not every:
        return np.zeros(0), np.zeros(0)
    rows = []
    for parameter in every:
        mean, deviation = _EXPECTED[parameter.name]
        if parameter.name == "push_height" and dataset.finger_height is not None:
            mean, deviation = dataset.finger_height + _ABOVE_ITS_END[0], _ABOVE_ITS_END[1]
        elif parameter.name == "mass_height" and dataset.height is None:
            mean, deviation = _OF_A_MASS
        elif parameter.unit == "m":
            assert dataset.height is not None, "a law with heights needs that of the finger or the object"
            mean, deviation = mean * dataset.height, deviation * dataset.height
        rows.append((mean, deviation))
    means, deviations = np.array(rows).T
    return np.clip(means, *bounds(effects)), deviations


def beside_slope(effects: Sequence[Effect], dataset: PushDataset) -> tuple[Effect, ...]:
    """What a slope brings with it if the finger's height is stated: `load_transfer`, unless it is given.

    On a slope gravity acts at the height of the centre of mass and shifts load downhill; a finger that pushes
    uphill shifts it back. Without both, a slope is estimated up to a tenth too steep (docs/lab/adapt.md).
    """
    sloping = any(type(effect).downhill is not Effect.downhill for effect in effects)
    if not sloping or dataset.finger_height is None:
        return ()
    names = {effect.name for effect in effects}  # effects of another process are copies
    return tuple(e for e in LIBRARY if e.name == "load_transfer" and e.name not in names)


def laws_without(effects: Sequence[Effect]) -> tuple[str, ...]:
    """What laws of friction may consist of in a model that is to lack these effects."""
    lacking = {effect.name for effect in effects}
    return tuple(name for name in LAW_EFFECTS if name not in lacking)


def combinations(
    dataset: PushDataset, given: Sequence[Effect], allowed: Collection[str] = LAW_EFFECTS
) -> list[tuple[Effect, ...]]:
    """Effects of each law, except the plain one, that the dataset can decide on besides the given ones.

    Args:
        allowed: names of those that a law may consist of.
    """
    known = {effect.name: effect for effect in LIBRARY}
    transfer, lean = (known[name] for name in LAW_EFFECTS)
    # The load shifts by height times force over weight: for an object that was not weighed, other model
    # errors would be mistaken for a small weight.
    if dataset.height is None or dataset.mass is None:
        laws: list[tuple[Effect, ...]] = [(lean,)]
    else:
        laws = [(lean,), (transfer,), (transfer, lean)]
    usable = set(allowed) - {effect.name for effect in given}
    return [law for law in laws if usable.issuperset(effect.name for effect in law)]


def name_of(effects: Sequence[Effect]) -> str:
    """Name of the law with these effects."""
    return TOGETHER.join(effect.name for effect in effects) or PLAIN
