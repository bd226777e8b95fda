"""What a model says of recorded pushes: poses and forces of all its hypotheses, and of the two baselines.

Everything that compares with measurements takes its predictions from here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from models.inference.belief import Belief
from models.inference.middle_pose import middle_poses
from models.inference.observations import Observation
from models.inference.prediction import uniform_maps
from models.physics.cell_grid import CellGrid, FloatArray
from models.physics.rollout import Maps


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
