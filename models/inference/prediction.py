"""Predict recorded pushes from their first pose: poses and forces of all hypotheses of a belief.

Whatever compares with measurements takes its predictions from here. `predict` judges them by where the object
ends, beside an object that does not move and a uniform one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from slipmap.models.inference.belief import Belief, BeliefError
from slipmap.models.inference.observations import Observation, observe_all
from slipmap.models.inference.results import Prediction
from slipmap.models.inference.summaries import middle_poses
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.maps import Maps
from slipmap.models.physics.paper_notation import add
from slipmap.models.physics.pushes import Push
from slipmap.models.progress import Progress, silent


def predict(belief: Belief, dataset: PushDataset, progress: Progress | None = None) -> tuple[Prediction, ...]:
    """Roll every hypothesis out along every recorded push, from the push's first pose.

    Args:
        belief: what was learnt, from this or another dataset of the same object.
        dataset: pushes of the object that the belief is about.
        progress: called with (stage, done, total).

    Raises:
        BeliefError: the dataset has another finger or another object.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=1, heldout=2)
        >>> belief = slipmap.identify(dataset, hypotheses=2, friction_laws=False).belief
        >>> [push.role for push in slipmap.predict(belief, dataset)]
        ['fit', 'heldout', 'heldout']
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
) -> tuple[Prediction, ...]:
    """`predict` for observations that are prepared already."""
    slider, centers, maps = belief.slider, belief.grid.centers, belief.maps
    pushes = [observation.push for observation in observations]
    report = progress or silent
    report("predicting", 0, 3)
    rollouts = slider.rollout(maps, pushes)
    report("predicting", 1, 3)
    uniform = slider.rollout(uniform_maps(belief), pushes)
    report("predicting", 2, 3)
    best = int(np.argmax(belief.probability))
    likeliest = maps[best : best + 1]
    shift = 5e-4  # m by which the start is shifted, to judge how near to balance it is
    shifted = [slider.rollout(likeliest, _shifted(pushes, s * shift)).end[0, :, :3] for s in (-1.0, 1.0)]
    ends = slider.rollout(likeliest, pushes).end[0, :, :3]
    report("predicting", 3, 3)
    results = []
    for b, observation in enumerate(observations):
        hypotheses = rollouts.poses_of(b)
        middle = middle_poses(hypotheses, belief.probability, belief.grid)
        last = observation.poses[-1]
        moved = float(np.mean([add(end[b], ends[b], centers) for end in shifted]) / shift)
        results.append(
            Prediction(
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
                start_sensitivity=moved,
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


def _shifted(pushes: Sequence[Push], shift: float) -> list[Push]:
    """The same pushes with the finger moved sideways of its path, which is as good as moving the object."""
    result = []
    for push in pushes:
        path = push.tip[-1] - push.tip[0]
        length = float(np.hypot(*path))
        if np.isfinite(length) and length > 0.0:
            push = replace(push, tip=push.tip + np.array([-path[1], path[0]]) / length * shift)
        result.append(push)
    return result


@dataclass(frozen=True, eq=False)
class Motion:
    """What K hypotheses say of one push from its first pose on.

    Attributes:
        poses: (K, S, 3) world poses at the observation's pose times, m and rad.
        forces: (K, T, 2) forces of the finger on the object at its force times, world, N.
        probability: (K,) of the hypotheses.
    """

    poses: FloatArray
    forces: FloatArray
    probability: FloatArray

    def middle_poses(self, grid: CellGrid) -> FloatArray:
        """(S, 3) in the middle of the hypotheses: the prediction that is judged."""
        return middle_poses(self.poses, self.probability, grid)

    @property
    def mean_forces(self) -> FloatArray:
        """(T, 2) probability-weighted mean, N."""
        return np.einsum("k,ktc->tc", self.probability, self.forces)

    @property
    def likeliest_poses(self) -> FloatArray:
        """(S, 3) of the most probable hypothesis, whose contact with the finger is one model's."""
        return self.poses[int(np.argmax(self.probability))]


def predicted_motion(belief: Belief, observations: Sequence[Observation]) -> tuple[Motion, ...]:
    """Every hypothesis of a belief, rolled out along every push from its first pose."""
    return _motion(belief, belief.maps, belief.probability, observations)


def uniform_motion(belief: Belief, observations: Sequence[Observation]) -> tuple[Motion, ...]:
    """The same of the baseline, a uniform object with the belief's mass, friction and finger."""
    return _motion(belief, uniform_maps(belief), np.ones(1), observations)


def _motion(
    belief: Belief, maps: Maps, probability: FloatArray, observations: Sequence[Observation]
) -> tuple[Motion, ...]:
    found = belief.slider.rollout(maps, [observation.push for observation in observations])
    every = range(len(observations))
    return tuple(Motion(found.poses_of(b), found.forces_of(b), probability) for b in every)
