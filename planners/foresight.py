"""Where pushes would bring the object, in every hypothesis and with the noise of the finger's control.

All lines of push are rolled out for all scenarios in one parallel call, to the longest push. A slow push
leaves the object where the finger stops, so that the poses on the way are the ends of all shorter pushes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.inference.belief import Belief
from models.measurements.push_dataset import Table
from models.physics.balance import balance_margins, own_balance_margins
from models.physics.cell_grid import CellGrid, FloatArray
from models.physics.maps import Maps
from models.physics.rollout import Push, RolloutError, Slider
from planners.contact_lines import ContactLines
from planners.pose_metric import compose, relative
from planners.pregrasp_settings import PushSettings

STRIDE = 2.5e-3
"""Way of the finger in one time step, m. Against steps of 0.5 mm, pushes of 0.1 m of the hammer end within
0.2 mm (95 %), of 0.25 m within 0.4 mm."""

EVERYWHERE = 100.0
"""Radius of a table without an edge, m."""

NEGLIGIBLE = 1e-4
"""Probability below which a hypothesis is not imagined."""


@dataclass(frozen=True, eq=False)
class Scenarios:
    """S pairs of a hypothesis and a noise of the finger's control.

    Attributes:
        slider: the model.
        maps: S hypotheses.
        probability: (S,) sums to one.
        hypothesis: (S,) index in the belief.
        centers_of_mass: (S, 2) object frame, m.
        least_margins: (S,) balance margin below which the object counts as falling, m.
        noise: (S, 3) by which the finger's path is off: x, y in m, angle about its begin in rad.
    """

    slider: Slider
    maps: Maps
    probability: FloatArray
    hypothesis: np.ndarray
    centers_of_mass: FloatArray
    least_margins: FloatArray
    noise: FloatArray

    @classmethod
    def of(cls, belief: Belief, settings: PushSettings, rng: np.random.Generator) -> Scenarios:
        """Every hypothesis that counts, as often as the settings ask for, with noise of mean zero."""
        kept = np.flatnonzero(belief.probability > NEGLIGIBLE)
        copies = -(-settings.scenarios // len(kept))
        hypothesis = np.tile(kept, copies)
        probability = belief.probability[hypothesis] / belief.probability[hypothesis].sum()
        noise = rng.standard_normal((len(hypothesis), 3))
        noise -= probability @ noise
        noise *= [settings.position_noise, settings.position_noise, np.radians(settings.angle_noise)]
        return cls(
            belief.slider,
            belief.maps[hypothesis],
            probability,
            hypothesis,
            belief.centers_of_mass[hypothesis],
            least_margins(belief, settings)[hypothesis],
            noise,
        )

    def __len__(self) -> int:
        return len(self.probability)

    def of_hypotheses(self, poses: FloatArray) -> FloatArray:
        """(K', 3) poses (S, 3) averaged over the noise of each hypothesis that is imagined."""
        numbers = np.unique(self.hypothesis)
        return np.array([poses[self.hypothesis == k].mean(axis=0) for k in numbers])


@dataclass(frozen=True, eq=False)
class Foresight:
    """What C lines of push with L lengths would do in S scenarios.

    Attributes:
        lines: of push.
        begins: (C, 2) finger centre before it moves, world, m.
        directions: (C, 2) unit vectors of the finger's motion, world.
        lengths: (L,) way of the finger after first touch, m.
        poses: (C, L, S, 3) of the object at the end, world; NaN where the model found no answer.
        falls: (C, L) probability that its margin of balance falls below the settings' on the way.
        probability: (S,) of the scenarios.
    """

    lines: ContactLines
    begins: FloatArray
    directions: FloatArray
    lengths: FloatArray
    poses: FloatArray
    falls: FloatArray
    probability: FloatArray


def foresee(
    scenarios: Scenarios, pose: FloatArray, lines: ContactLines, table: Table, settings: PushSettings
) -> Foresight:
    """Imagine pushing an object at `pose` (3,) along every line.

    Raises:
        ValueError: a pose that is not finite.
    """
    C, S, L = len(lines), len(scenarios), settings.lengths
    way = settings.approach + settings.longest
    steps = int(np.ceil(way / STRIDE))
    h = way / steps / settings.speed
    lengths = settings.longest * np.arange(1, L + 1) / L
    looks = (settings.approach + lengths) / settings.speed
    looks[-1] = steps * h
    path = np.linspace(0.0, way, steps + 1)
    ahead = compose(pose, np.pad(lines.touches - settings.approach * lines.directions, ((0, 0), (0, 1))))
    begins = ahead[:, :2]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    directions = lines.directions @ np.array([[c, s], [-s, c]])
    pushes = [
        Push(h, begin + np.outer(path, direction), pose, pose_times=looks)
        for begin, direction in zip(begins, directions, strict=True)
    ]
    # A finger that is off by a rigid motion pushes as one that is not, on an object moved the other way.
    errors = _control_errors(begins, scenarios.noise)
    starts = relative(errors, pose)
    imagined = _rolled_out(scenarios, pushes, starts, L)
    poses = compose(errors[:, :, None], imagined).transpose(1, 2, 0, 3)
    tips = np.zeros((C, L, S), dtype=bool)
    beyond = np.isfinite(poses).all(axis=-1) & ~_surely_on(poses, scenarios.slider.grid, table)
    centers = np.broadcast_to(scenarios.centers_of_mass, (C, L, S, 2))[beyond]
    margins = own_balance_margins(scenarios.slider.grid, centers, poses[beyond], table)
    tips[beyond] = margins < np.broadcast_to(scenarios.least_margins, (C, L, S))[beyond]
    falls = np.logical_or.accumulate(tips, axis=1) @ scenarios.probability
    return Foresight(lines, begins, directions, lengths, poses, falls, scenarios.probability)


def _surely_on(poses: FloatArray, grid: CellGrid, table: Table) -> np.ndarray:
    """(…) whether a disc around the object at poses (…, 3) is wholly over the table."""
    size = np.linalg.norm(grid.exterior, axis=1).max()
    off = poses[..., :2] - np.asarray(table.center)
    if table.shape == "round":
        return np.hypot(off[..., 0], off[..., 1]) + size <= (table.radius or 0.0)
    return (np.abs(off) + size <= np.asarray(table.size) / 2).all(axis=-1)


def least_margins(belief: Belief, settings: PushSettings) -> FloatArray:
    """(K,) balance margin below which the object counts as falling, m.

    That of the settings; but a slender object has little margin wherever it lies, and half of what a
    hypothesis has far from any edge is enough.
    """
    everywhere = Table("round", (0.0, 0.0), radius=EVERYWHERE)
    free = balance_margins(belief.grid, belief.centers_of_mass, np.zeros((1, 3)), everywhere)[0]
    return np.minimum(settings.margin, free / 2)


def _control_errors(begins: FloatArray, noise: FloatArray) -> FloatArray:
    """(S, C, 3) rigid motions of the finger's paths: turned about their begins (C, 2), then shifted."""
    angle = np.broadcast_to(noise[:, None, 2], (len(noise), len(begins)))
    shift = begins + noise[:, None, :2]
    turned = compose(np.stack([0 * angle, 0 * angle, angle], axis=-1), np.pad(begins, ((0, 0), (0, 1))))
    return np.concatenate([shift - turned[..., :2], angle[..., None]], axis=-1)


def _rolled_out(scenarios: Scenarios, pushes: list[Push], starts: FloatArray, looks: int) -> FloatArray:
    """(S, C, L, 3) poses; NaN for a push that some scenario does not solve."""
    try:
        out = scenarios.slider.rollout(scenarios.maps, pushes, start_poses=starts)
    except RolloutError:
        if len(pushes) == 1:
            return np.full((len(scenarios), 1, looks, 3), np.nan)
        half = len(pushes) // 2
        parts = [
            _rolled_out(scenarios, pushes[:half], starts[:, :half], looks),
            _rolled_out(scenarios, pushes[half:], starts[:, half:], looks),
        ]
        return np.concatenate(parts, axis=1)
    return out.poses.reshape(len(scenarios), len(pushes), looks, 3)
