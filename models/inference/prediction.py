"""Predict recorded pushes from their first pose, and judge the prediction against two simple ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from models.inference.belief import Belief, BeliefError
from models.inference.middle_pose import middle_poses
from models.inference.observations import Observation, observe_all
from models.inference.results import PushPrediction
from models.measurements import PushDataset
from models.physics.maps import Maps
from models.physics.paper_notation import add
from models.physics.pushes import Push

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
