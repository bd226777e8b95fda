"""What a force sensor reads without contact: taken off each push, and off those that do not show it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slipmap.models.measurements import parsing
from slipmap.models.measurements.push_dataset import Setup, gaps
from slipmap.models.measurements.trial import Channel, Trial
from slipmap.models.physics.cell_grid import FloatArray

_FREE = 5e-3  # m of air beyond which there is no contact force
_SWINGS = 0.3  # s for which the finger swings after contact
_STARTED = 5e-4  # m from where the finger waited at first,
_APART = 1e-3  # m from the outline there
_FRAMES_FIT = (-0.01, 0.02)  # m of air at the closest rows where the frames are right
_FEWEST_ROWS = 10
_SHARE = 0.01  # of the largest force, exceeded by a significant bias,
_ERRORS = 5.0  # which also exceeds this many standard errors
_FEWEST_AGREEING = 2  # pushes of a session
_LARGEST_SPREAD = 0.25  # of their biases, relative to the bias, with which it is a common one


class Bias(NamedTuple):
    """The reading of a force sensor without contact."""

    value: FloatArray  # (2,) N, along the table's x and y
    matters: bool  # whether it is significant and not small


def free_force(
    setup: Setup, pose: Channel, tip: Channel, force: Channel
) -> tuple[FloatArray, FloatArray, int] | None:
    """The sensor's reading without contact: (2,) N, its standard error (2,), and the number of rows; None if
    there are too few."""
    gap = gaps(setup, tip.at(force.time), pose.at(force.time))
    begin, end = max(pose.time[0], tip.time[0]), min(pose.time[-1], tip.time[-1])
    free = gap > _FREE
    near = force.time[~free]
    if len(near):  # after contact the finger swings, and with it its sensor
        after = np.searchsorted(near, force.time)
        free &= (after == 0) | (force.time - near[np.maximum(after - 1, 0)] > _SWINGS)
    away = np.hypot(*(tip.values - tip.values[0]).T) > _STARTED
    started = tip.time[np.argmax(away)] if away.any() else tip.time[-1]
    if not _FRAMES_FIT[0] < float(np.percentile(gap, 1)) < _FRAMES_FIT[1]:
        free[:] = False  # the frames are wrong, so the finger is not where it seems to be
    free |= (force.time < started) & (np.abs(gap) > _APART)
    free &= (force.time >= begin) & (force.time <= end)
    if int(free.sum()) < _FEWEST_ROWS:
        return None
    values = force.values[free, :2]
    middle = np.median(values, axis=0)
    # Slow wander correlates the rows: about a tenth of them are independent.
    spread = 1.4826 * np.median(np.abs(values - middle), axis=0)
    return middle, spread / np.sqrt(max(len(values) / 10.0, 1.0)), len(values)


def bias_matters(bias: FloatArray, error: FloatArray, force: Channel) -> bool:
    """Whether a force without contact is significant and more than a hundredth of the largest force."""
    largest = float(np.percentile(np.hypot(*(force.values[:, :2] - bias).T), 99))
    return bool((np.abs(bias) > _ERRORS * error).any() and np.hypot(*bias) > _SHARE * largest)


def force_at_rest(
    setup: Setup, trial: Trial, usual: FloatArray | None = None
) -> tuple[Trial, str, Bias | None]:
    """The trial with the bias of its force sensor removed, a remark, and the bias if the trial shows it.

    Args:
        usual: (2,) N, bias of the session, for a trial that does not show its own.
    """
    force = trial.ft_wrench
    assert force is not None
    free = free_force(setup, trial.object_pose, trial.tip_pose, force)
    if free is None:
        why = "no rows before touch"
        if usual is None:
            return trial, f"ft_wrench: {why}, so its bias is unknown; left as it is", None
        text = f"ft_wrench: bias {_newtons(usual)} of the other pushes taken off, since there are {why}"
        return _without(trial, usual), text, None
    bias, error, count = free
    found = Bias(bias, bias_matters(bias, error, force))
    if not found.matters:
        return trial, "ft_wrench: no significant bias before touch; left as it is", found
    text = f"ft_wrench: bias {_newtons(bias)} on {count} rows without touch taken off"
    return _without(trial, bias), text, found


def _without(trial: Trial, bias: FloatArray) -> Trial:
    force = trial.ft_wrench
    assert force is not None
    return replace(trial, ft_wrench=Channel(force.time, force.values - np.append(bias, 0.0)))


def _newtons(bias: FloatArray) -> str:
    return f"({bias[0]:.3f}, {bias[1]:.3f}) N"


def usual_bias(biases: Sequence[Bias | None]) -> FloatArray | None:
    """(2,) the bias, N, on which the pushes of a session agree; None if it is small, or they do not."""
    known = [one for one in biases if one is not None]
    if len(known) < _FEWEST_AGREEING or 2 * sum(one.matters for one in known) <= len(known):
        return None
    values = np.array([one.value for one in known])
    middle = np.median(values, axis=0)
    apart = float(np.median(np.hypot(*(values - middle).T)))
    return middle if apart < _LARGEST_SPREAD * float(np.hypot(*middle)) else None


def unknown_biases(biases: Mapping[str, Bias | None]) -> list[str]:
    """A warning if pushes, by name, have a bias that others do not show and on which they do not agree."""
    shown = {name: one.value for name, one in biases.items() if one is not None and one.matters}
    unknown = [name for name, one in biases.items() if one is None]
    if not shown or not unknown or usual_bias(list(biases.values())) is not None:
        return []
    largest = parsing.rounded(max(float(np.hypot(*bias)) for bias in shown.values()), 2)
    size = (
        f"{largest} N, and no other push shows one" if len(shown) == 1 else f"up to {largest} N and differs"
    )
    return [
        f"{parsing.listed(unknown)}: the force's bias is unknown, since there are no rows before touch; in"
        f" {parsing.listed(list(shown))} it is {size}. Record each push from before the touch on, or give"
        " ft_wrench.offset, the reading without contact"
    ]
