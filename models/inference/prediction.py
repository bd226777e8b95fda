"""Predict recorded pushes from their first pose, and judge the prediction against two simple ones.

Hypotheses of a belief can part ways, where a push goes to one side of balance or to the other. Their mean
then lies where none of them is, and follows those that go farthest astray. What is judged is ADD, a distance,
and the expected distance is least at the geometric median.

Everything that compares with measurements takes its predictions from here.

Hypotheses are few, so that quantiles of them are too coarse. They are taken for draws from a normal
distribution, with their weighted moments, and both are those for another draw: Student's interval and
Hotelling's ellipse, for as many draws as the weights p leave, 1 / Σ p².
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit
from scipy.stats import f

from slipmap.models.geometry import at_centroid, from_centroid, radius_of_gyration
from slipmap.models.inference.belief import Belief, BeliefError
from slipmap.models.inference.observations import Observation, observe_all
from slipmap.models.inference.results import PushPrediction
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.maps import Maps
from slipmap.models.physics.paper_notation import add
from slipmap.models.physics.pushes import Push

# One pose for many that are believed: the one from which the true one is expected to be least far.


_CLOSE = 1e-4  # m; nearer than this, a hypothesis pulls ever less
_SETTLED = 1e-6  # m
_STEPS = 100


def middle_poses(poses: FloatArray, probability: FloatArray, grid: CellGrid) -> FloatArray:
    """Geometric median of planar poses, by the iteration of Weiszfeld (1937).

    Distances are those of (x, y, ρ θ) at the cells' centroid, ρ being their radius of gyration: nearly ADD.

    Args:
        poses: (K, …, 3) of the object frame, m and rad; angles of one place do not wrap.
        probability: (K,) sums to one.
        grid: cells of the object.

    Returns:
        (…, 3) poses.
    """
    scale = np.array([1.0, 1.0, radius_of_gyration(grid)])
    points = at_centroid(poses, grid) * scale
    weight = probability.reshape(-1, *[1] * (points.ndim - 1))
    middle = (weight * points).sum(axis=0)
    for _ in range(_STEPS):
        distance = np.linalg.norm(points - middle, axis=-1, keepdims=True)
        pull = weight / np.sqrt(distance**2 + _CLOSE**2)
        before, middle = middle, (pull * points).sum(axis=0) / pull.sum(axis=0)
        if np.abs(middle - before).max(initial=0.0) < _SETTLED:
            break
    return from_centroid(middle / scale, grid)


SIDEWAYS_SHIFT = 5e-4
"""Shift of the start by which nearness to balance is judged, m."""

Progress = Callable[[str, int, int], None]


def predict(
    belief: Belief, dataset: PushDataset, progress: Progress | None = None
) -> tuple[PushPrediction, ...]:
    """Roll every hypothesis out along every recorded push, from the push's first pose.

    Args:
        belief: what was learnt, from this or another dataset of the same object.
        dataset: pushes of the object that the belief is about.
        progress: called with (stage, done, total).

    Raises:
        BeliefError: the dataset has another finger or another object.
    """
    check_same_object(belief, dataset)
    return predict_observations(belief, observe_all(dataset), progress)


def check_same_object(belief: Belief, dataset: PushDataset) -> None:
    """Raise BeliefError where a dataset's outline or finger is not that of the belief."""
    if abs(dataset.finger_radius - belief.finger_radius) > 1e-6:
        raise BeliefError(
            f"the belief is about a finger of radius {belief.finger_radius} m, dataset {dataset.name} has "
            f"{dataset.finger_radius} m: identify this dataset instead"
        )
    ours, theirs = belief.grid.polygon, dataset.grid.polygon
    if ours.symmetric_difference(theirs).area > 0.02 * ours.area:
        raise BeliefError(
            f"the belief is about another object than dataset {dataset.name}: their outlines differ; "
            "identify this dataset instead"
        )


def predict_observations(
    belief: Belief, observations: Sequence[Observation], progress: Progress | None = None
) -> tuple[PushPrediction, ...]:
    """The same for observations that are prepared already."""
    slider = belief.slider
    centers = belief.grid.centers
    maps = belief.maps
    pushes = [observation.push for observation in observations]
    report = progress or (lambda stage, done, total: None)
    report("predicting", 0, 3)
    rollouts = slider.rollout(maps, pushes)
    report("predicting", 1, 3)
    uniform = slider.rollout(uniform_maps(belief), pushes)
    report("predicting", 2, 3)
    best = int(np.argmax(belief.probability))
    likeliest = maps[best : best + 1]
    shifted = [slider.rollout(likeliest, _shifted(pushes, sign)).end[0, :, :3] for sign in (-1.0, 1.0)]
    ends = slider.rollout(likeliest, pushes).end[0, :, :3]
    report("predicting", 3, 3)
    results = []
    for b, observation in enumerate(observations):
        hypotheses = rollouts.poses_of(b)
        middle = middle_poses(hypotheses, belief.probability, belief.grid)
        last = observation.poses[-1]
        results.append(
            PushPrediction(
                trial=observation.trial,
                role=observation.role,
                times=np.asarray(observation.push.pose_times),
                measured=observation.poses,
                hypotheses=hypotheses,
                predicted=middle,
                final_add=float(add(middle[-1], last, centers)),
                spread=float(belief.probability @ add(hypotheses[:, -1], middle[-1], centers)),
                no_motion_add=float(add(observation.push.start_pose, last, centers)),
                uniform_add=float(add(uniform.poses_of(b)[0, -1], last, centers)),
                start_sensitivity=float(
                    np.mean([add(end[b], ends[b], centers) for end in shifted]) / SIDEWAYS_SHIFT
                ),
            )
        )
    return tuple(results)


def uniform_maps(belief: Belief) -> Maps:
    """The baseline: the belief's total mass and finger friction, spread evenly, with one friction; effects as
    the belief has them on average."""
    n = len(belief.grid)
    p = belief.probability
    mass = p @ belief.maps.mass.sum(axis=1)
    load = p @ (belief.maps.mass * belief.maps.mu).sum(axis=1)
    finger = p @ belief.maps.mu_finger
    effects = p @ belief.maps.effects
    return Maps(np.full((1, n), mass / n), np.full((1, n), load / mass), np.array([finger]), effects[None])


def _shifted(pushes: Sequence[Push], sign: float) -> list[Push]:
    """The same pushes with the finger moved sideways of its path, which is as good as moving the object."""
    result = []
    for push in pushes:
        path = push.tip[-1] - push.tip[0]
        length = float(np.hypot(*path))
        if not np.isfinite(length) or length == 0.0:
            result.append(push)
            continue
        sideways = np.array([-path[1], path[0]]) / length * SIDEWAYS_SHIFT * sign
        result.append(replace(push, tip=push.tip + sideways))
    return result


# What a model says of recorded pushes: poses and forces of all its hypotheses, and of the two baselines.


@dataclass(frozen=True, eq=False)
class PredictedMotion:
    """One push as K hypotheses predict it from its first pose.

    Attributes:
        poses: (K, S, 3) world poses at the observation's pose times, m and rad.
        forces: (K, T, 2) forces of the finger on the object at its force times, world, N.
        probability: (K,) of the hypotheses.
    """

    poses: FloatArray
    forces: FloatArray
    probability: FloatArray

    def middle_poses(self, grid: CellGrid) -> FloatArray:
        """(S, 3) in the middle of the hypotheses: the prediction that is judged, see `middle_pose`."""
        return middle_poses(self.poses, self.probability, grid)

    @property
    def mean_forces(self) -> FloatArray:
        """(T, 2) probability-weighted mean, N."""
        return np.einsum("k,ktc->tc", self.probability, self.forces)

    @property
    def likeliest_poses(self) -> FloatArray:
        """(S, 3) of the most probable hypothesis, whose contact with the finger is one model's."""
        return self.poses[int(np.argmax(self.probability))]


PredictMotion = Callable[[Belief, Sequence[Observation]], tuple[PredictedMotion, ...]]
"""What `compare` asks for predictions: every hypothesis of a belief along every push."""


def predicted_motion(belief: Belief, observations: Sequence[Observation]) -> tuple[PredictedMotion, ...]:
    """Every hypothesis of a belief, rolled out along every push from its first pose."""
    return _motion(belief, belief.maps, belief.probability, observations)


def uniform_motion(belief: Belief, observations: Sequence[Observation]) -> tuple[PredictedMotion, ...]:
    """The baseline of a uniform object with the belief's mass, friction and finger."""
    return _motion(belief, uniform_maps(belief), np.ones(1), observations)


def _motion(
    belief: Belief, maps: Maps, probability: FloatArray, observations: Sequence[Observation]
) -> tuple[PredictedMotion, ...]:
    rollouts = belief.slider.rollout(maps, [observation.push for observation in observations])
    return tuple(
        PredictedMotion(rollouts.poses_of(b), rollouts.forces_of(b), probability)
        for b in range(len(observations))
    )


# Where a quantity lies by what the hypotheses say of it: intervals on a line, regions in the plane.


def interval(
    values: FloatArray, probability: FloatArray, *, level: float = 0.9, log: bool = False
) -> tuple[float, float, float]:
    """Weighted median and central interval of draws.

    Args:
        values: (K,).
        probability: (K,) weights.
        level: share of cases in which the truth shall lie inside.
        log: whether it is the logarithm that is normally distributed.
    """
    x = np.log(np.maximum(values, 1e-300)) if log else values
    mean = float(probability @ x)
    effective = max(2.0, _effective_number(probability))
    variance = float(probability @ (x - mean) ** 2) * effective / (effective - 1.0)
    width = float(stdtrit(effective - 1.0, 0.5 + 0.5 * level)) * np.sqrt(variance * (1.0 + 1.0 / effective))
    order = np.argsort(x)
    middle = float(x[order][np.searchsorted(np.cumsum(probability[order]), 0.5)])
    low, high = mean - width, mean + width
    return (float(np.exp(middle)), float(np.exp(low)), float(np.exp(high))) if log else (middle, low, high)


def in_region(point: FloatArray, points: FloatArray, probability: FloatArray, *, level: float = 0.9) -> bool:
    """Whether a point lies in the ellipse that draws suggest; with hardly more than two, any does.

    Args:
        point: (2,).
        points: (K, 2) draws.
        probability: (K,) weights.
        level: share of cases in which the truth shall lie inside.
    """
    count = _effective_number(probability)
    if count <= 3.0:
        return True  # so few say nothing of their spread
    mean = probability @ points
    off, around = point - mean, points - mean
    spread = around.T @ (around * probability[:, None]) * count / (count - 1.0)
    limit = 2.0 * (count**2 - 1.0) / (count * (count - 2.0)) * f.ppf(level, 2, count - 2.0)
    return bool(off @ np.linalg.solve(spread, off) < limit)


def _effective_number(probability: FloatArray) -> float:
    return 1.0 / float(probability @ probability)
