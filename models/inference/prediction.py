"""Predict recorded pushes from their first pose, and judge the predictions.

All reported model errors come from here: the central pose of a belief's hypotheses against the measured
poses, with an object that does not move and a uniform object as baselines. One belief and one push give the
same number in every command.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from slipmap.models.blas import one_blas_thread
from slipmap.models.geometry import turned_to
from slipmap.models.inference.belief import Belief, BeliefError
from slipmap.models.inference.end_region import EndRegion
from slipmap.models.inference.error_model import SensorNoise, outline_errors, sensor_noise
from slipmap.models.inference.observations import Observation, observe_all
from slipmap.models.inference.push_errors import Errors, errors, resting_errors
from slipmap.models.inference.summaries import middle_poses
from slipmap.models.measurements import PushDataset
from slipmap.models.measurements.push_dataset import check_dataset_given
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.maps import Maps
from slipmap.models.physics.paper_notation import add
from slipmap.models.physics.pushes import Push
from slipmap.models.progress import Progress, silent

if TYPE_CHECKING:
    from slipmap.models.inference.results import Identification

_LEAST_TRAVEL = 5e-3  # m
_STARTS = 20251126  # seed of the starts of `Prediction.end_region`


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of one push as K hypotheses predict it from its first pose."""

    poses: FloatArray  # (K, S, 3) world poses at the observation's pose times, m and rad
    forces: FloatArray  # (K, T, 2) forces of the finger on the object at its force times, world, N
    probability: FloatArray  # (K,) of the hypotheses
    grid: CellGrid  # cells of the object

    @cached_property
    def middle_poses(self) -> FloatArray:
        """(S, 3) central poses of the hypotheses, see `summaries.middle_poses`: the judged prediction."""
        return middle_poses(self.poses, self.probability, self.grid)

    @property
    def mean_forces(self) -> FloatArray:
        """(T, 2) probability-weighted mean, N."""
        return np.einsum("k,ktc->tc", self.probability, self.forces)

    def spread_misfit(self, observation: Observation, noise: SensorNoise) -> float:
        """Misfit that the spread of the hypotheses alone would cause, see `push_errors.Errors`."""
        used = observation.sliding
        poses = ((self.poses - self.middle_poses) / noise.of_poses) ** 2
        forces = ((self.forces - self.mean_forces)[:, used] / noise.force) ** 2
        every = np.concatenate([one.reshape(len(self.poses), -1) for one in (poses, forces)], axis=1)
        return float(np.sqrt(self.probability @ every.mean(axis=1)))

    @property
    def likeliest_poses(self) -> FloatArray:
        """(S, 3) poses of the most probable hypothesis, in consistent contact with the finger."""
        return self.poses[int(np.argmax(self.probability))]


@dataclass(frozen=True, eq=False)
class Prediction:
    """One push as measured and as a belief predicts it from its first pose, with the errors."""

    observation: Observation  # what was measured
    motion: Motion  # what the hypotheses predict
    errors: Errors  # of `predicted`
    uniform: Errors  # errors of a uniform object with the belief's mass, friction and finger
    resting: Errors  # errors of an object that does not move
    spread: float  # probability-weighted mean ADD of the hypotheses from `predicted` at the end, m
    spread_misfit: float  # misfit that the spread of the hypotheses alone would cause
    # shift of the predicted end (ADD) per metre of sideways shift of the start; large where the push starts
    # near balance and half a millimetre decides
    start_sensitivity: float
    # (2, 3) lower and upper ends of the 90 % intervals of x, y, θ at the end as the tracker would measure it:
    # spread of the hypotheses, model error and tracker noise
    end_interval: FloatArray
    end_region: EndRegion  # joint region of x, y and θ at the end at any level, from the same three sources

    def __repr__(self) -> str:
        return f"Prediction({self.trial!r}, {self.role}: ends {1e3 * self.final_add:.2f} mm off)"

    @property
    def surprising(self) -> bool:
        """Whether the measured end lies outside its 95 % region, as one in twenty does under a right model.

        Each of three 90 % intervals is missed by one push in ten. `end_region` tests x, y and θ together, so
        that looking at three numbers does not cause more surprises.
        """
        return not self.end_region.holds(self._seen_end)

    @property
    def rarity(self) -> float:
        """Share of pushes of a right model that end at least as far out as the measured end; below 0.05 this
        push is `surprising`."""
        return self.end_region.rarity(self._seen_end)

    @property
    def excess(self) -> float:
        """Error of the measured end over the extent of its 95 % region in that direction."""
        return self.end_region.excess(self._seen_end)

    @property
    def allowed_add(self) -> float:
        """Largest error (ADD), in the direction of the measured end, that would not be surprising, m."""
        return self.final_add / max(self.excess, 1e-9)

    @property
    def _seen_end(self) -> FloatArray:
        return turned_to(self.measured[-1], self.end_region.middle[2])

    @property
    def trial(self) -> str:
        """Name of the trial."""
        return self.observation.trial

    @property
    def role(self) -> str:
        """`fit` or `heldout`."""
        return self.observation.role

    @property
    def measured(self) -> FloatArray:
        """(S, 3) measured poses."""
        return self.observation.poses

    @property
    def predicted(self) -> FloatArray:
        """(S, 3) central poses of the hypotheses, see `summaries.middle_poses`."""
        return self.motion.middle_poses

    @property
    def hypotheses(self) -> FloatArray:
        """(K, S, 3) predicted poses."""
        return self.motion.poses

    @property
    def final_add(self) -> float:
        """Mean distance of the cells at the end between `predicted` and measured, m."""
        return self.errors.final_add

    @property
    def uniform_add(self) -> float:
        """The same for the uniform object."""
        return self.uniform.final_add

    @property
    def no_motion_add(self) -> float:
        """The same for an object that does not move."""
        return self.resting.final_add

    @property
    def ends_only(self) -> bool:
        """Whether only the first and the last pose were measured; the first may be written twice."""
        before, start = self.measured[:-1], self.observation.push.start_pose
        return bool(np.allclose(before, start, rtol=0.0, atol=1e-12))

    def to_json(self) -> dict[str, object]:
        """All numbers at the end of the push; lengths in m, poses x, y (m), θ (rad) in the world frame."""
        names = (
            "trial", "role", "final_add", "spread", "no_motion_add", "uniform_add", "start_sensitivity",
            "surprising", "excess",
        )  # fmt: skip
        low, high = self.end_interval
        return {name: getattr(self, name) for name in names} | {
            "path_add": self.errors.mean_add,
            "misfit": self.errors.misfit,
            "measured_end": self.measured[-1].tolist(),
            "predicted_end": self.predicted[-1].tolist(),
            "predicted_end_low": low.tolist(),
            "predicted_end_high": high.tolist(),
        }


_GRAVITY_ERROR = 0.01  # share by which values of one place may differ
_MASS_ERROR = 0.05  # share by which weighings of one object may differ
_CAMERA_ERROR = 5e-4  # m, by which outlines of one object that a camera sees twice may differ


@one_blas_thread()
def predict(
    belief: Belief | Identification, dataset: PushDataset, progress: Progress | None = None
) -> tuple[Prediction, ...]:
    """Roll every hypothesis out along every recorded push, from the push's first pose.

    Args:
        belief: what was learned, from this or another dataset of the same object.
        dataset: pushes of the object that the belief is about; its table is the one used.
        progress: called with (stage, done, total).

    Raises:
        BeliefError: the dataset has a different finger or object.
        TypeError: something other than a belief and a dataset.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=1, heldout=2)
        >>> belief = slipmap.identify(dataset, hypotheses=2, friction_laws=False).belief
        >>> [push.role for push in slipmap.predict(belief, dataset)]
        ['fit', 'heldout', 'heldout']
    """
    from slipmap.models.inference.results import belief_of  # which imports this module

    belief = belief_of(belief)
    check_dataset_given(dataset)
    check_same_object(belief, dataset)
    return predict_observations(
        belief.on(dataset.table), observe_all(dataset), sensor_noise(dataset), progress
    )


def check_same_object(belief: Belief, dataset: PushDataset) -> None:
    """Raise BeliefError if a dataset's outline, finger, gravity or weighed mass differs from the belief's.

    Outlines may differ by half a millimetre all around, as a camera sees them, but by no less than 2 % of the
    area and no more than 10 %.
    """
    ours, theirs = belief.grid.polygon, dataset.grid.polygon
    allowed = np.clip(_CAMERA_ERROR * ours.length, 0.02 * ours.area, 0.1 * ours.area)
    if ours.symmetric_difference(theirs).area > allowed:  # first, since another object also weighs otherwise
        raise BeliefError(
            f"the belief is about a different object, {belief.dataset}, from dataset {dataset.name}: their"
            " outlines differ; identify this dataset instead"
        )
    weighed = belief.settings.get("known_mass")
    for name, unit, own, stated, tolerance in (
        ("gravity", "m/s²", belief.gravity, dataset.gravity, _GRAVITY_ERROR),
        ("a mass", "kg", weighed, dataset.mass, _MASS_ERROR),
    ):
        if own and stated and abs(np.log(stated / own)) > tolerance:
            raise BeliefError(
                f"the belief about {belief.dataset} was learned with {name} of {own:.4g} {unit}, but dataset"
                f" {dataset.name} states {stated:.4g} {unit}; correct the dataset, or identify it instead"
            )
    if abs(dataset.finger_radius - belief.finger_radius) > 1e-6:
        raise BeliefError(
            f"the belief is about a finger of radius {belief.finger_radius} m, but dataset {dataset.name}"
            f" has {dataset.finger_radius} m; identify this dataset instead"
        )


def predict_observations(
    belief: Belief, observations: Sequence[Observation], noise: SensorNoise, progress: Progress | None = None
) -> tuple[Prediction, ...]:
    """Do the work of `predict` on prepared observations.

    Args:
        observations: B pushes.
        noise: of the sensors that measured them.
    """
    grid, slider = belief.grid, belief.slider
    pushes = [observation.push for observation in observations]
    report = progress or silent
    report("predicting", 0, 3)
    motions = predicted_motion(belief, observations)
    report("predicting", 1, 3)
    uniform = _motions(belief, uniform_maps(belief), np.ones(1), observations)
    report("predicting", 2, 3)
    best = int(np.argmax(belief.probability))
    likeliest = belief.maps[best : best + 1]
    shift = 5e-4  # m, sideways shift of the start that shows how near balance it is
    shifted = [slider.rollout(likeliest, _shifted(pushes, s * shift)).end[0, :, :3] for s in (-1.0, 1.0)]
    drawn, seen = drawn_ends(belief, observations, noise), noise.of_poses
    results = []
    for b, (observation, motion) in enumerate(zip(observations, motions, strict=True)):
        middle = motion.middle_poses
        ends, p = motion.poses[:, -1], motion.probability
        off = model_deviations(belief, observation.push.start_pose, ends)
        alone = [
            EndRegion.of(drawn[:, b, i : i + 1], p, seen[i : i + 1], off[:, i : i + 1]).interval(0.9)
            for i in range(3)
        ]
        likely = motion.likeliest_poses[-1]
        even = uniform[b]
        results.append(
            Prediction(
                observation=observation,
                motion=motion,
                errors=errors(observation, middle, motion.mean_forces, grid, noise),
                uniform=errors(observation, even.poses[0], even.forces[0], grid, noise),
                resting=resting_errors(observation, grid, noise),
                spread=float(p @ add(ends, middle[-1], grid.centers)),
                spread_misfit=motion.spread_misfit(observation, noise),
                start_sensitivity=float(np.mean([add(s[b], likely, grid.centers) for s in shifted]) / shift),
                end_interval=np.array(alone).T,
                end_region=EndRegion.of(drawn[:, b], p, seen, off),
            )
        )
    report("predicting", 3, 3)
    return tuple(results)


def model_deviations(belief: Belief, start: FloatArray, ends: FloatArray) -> FloatArray:
    """(J, 3) standard deviations of x, y, θ of an end because of the model's error over this travel: J
    equally likely ones.

    Args:
        start: (3,) pose before the push.
        ends: (K, 3) where its hypotheses end.
    """
    travel = belief.probability @ add(ends, start, belief.grid.centers)
    return effective_travel(travel) * belief.end_errors


def effective_travel(travel: FloatArray) -> FloatArray:
    """Travel that a model's error is in proportion to, m.

    Even an object that hardly moves is off by a little, because the finger touches it elsewhere or later than
    modelled.
    """
    return np.hypot(travel, _LEAST_TRAVEL)


def drawn_ends(belief: Belief, observations: Sequence[Observation], noise: SensorNoise) -> FloatArray:
    """Ends of the hypotheses, each from starts that the tracker would see as the measured ones, with an
    outline that would be seen as the given one, along a track that the finger may have taken.

    A push near balance or near a corner may go either way from them, and an object that is struck slides as
    far as the finger's fastest moment lets it. The means of starts and outlines over the hypotheses are those
    given.

    Args:
        belief: K hypotheses.
        observations: B pushes.
        noise: of the tracker.

    Returns:
        (K, B, 3) poses.
    """
    p = belief.probability
    # The same for every push, so that its region does not depend on which others are predicted with it.
    rng = np.random.default_rng(_STARTS)
    offsets = rng.standard_normal((len(p), 1, 3))
    offsets = offsets - np.einsum("k,kbi->bi", p, offsets)
    offsets = offsets * noise.of_means([observation.start_rows for observation in observations])
    # An outline that is off is as if the object started elsewhere and were measured from there.
    outlines = np.zeros((len(p), 1, 3))
    outlines[:, 0, :2] = belief.outline_error * rng.permutation(outline_errors(len(p)))
    outlines -= np.einsum("k,kbi->bi", p, outlines)
    starts = np.array([observation.push.start_pose for observation in observations]) + offsets + outlines
    pushes = [observation.likely_pushes for observation in observations]
    tracks = min(len(p), max(len(likely) for likely in pushes))
    ends = np.empty((len(p), len(observations), 3))
    for track in range(tracks):
        own = slice(track, None, tracks)
        along = [likely[track % len(likely)] for likely in pushes]
        ends[own] = belief.slider.rollout(belief.maps[own], along, start_poses=starts[own]).end[:, :, :3]
    if tracks > 1:
        # A single track carries a struck object too far, see `smooth_track`.
        recorded = [observation.push for observation in observations]
        along_mean = belief.slider.rollout(belief.maps, recorded, start_poses=starts).end[:, :, :3]
        ends += np.einsum("k,kbi->bi", p, along_mean - ends)
    return ends - outlines


def uniform_maps(belief: Belief) -> Maps:
    """Maps of the uniform baseline: the belief's mean mass spread evenly, one friction coefficient, and
    its mean finger friction and effects; of rival effects, those of the first hypothesis."""
    n = len(belief.grid)
    p = belief.probability
    mass = p @ belief.maps.mass.sum(axis=1)
    load = p @ (belief.maps.mass * belief.maps.mu).sum(axis=1)
    finger = p @ belief.maps.mu_finger
    has = np.array([belief.has(effect.name) for effect in belief.effects]).reshape(-1, len(belief))
    alike = (has == has[:, :1]).all(axis=0)
    shares = p if alike.all() else np.where(alike, p, 0.0) / p[alike].sum()
    effects = shares @ belief.maps.effects
    return Maps(np.full((1, n), mass / n), np.full((1, n), load / mass), np.array([finger]), effects[None])


def _shifted(pushes: Sequence[Push], shift: float) -> list[Push]:
    """The same pushes with the finger shifted sideways, which is equivalent to shifting the object."""
    result = []
    for push in pushes:
        path = push.tip[-1] - push.tip[0]
        length = float(np.hypot(*path))
        if np.isfinite(length) and length > 0.0:
            push = replace(push, tip=push.tip + np.array([-path[1], path[0]]) / length * shift)
        result.append(push)
    return result


def predicted_motion(belief: Belief, observations: Sequence[Observation]) -> tuple[Motion, ...]:
    """Every hypothesis of a belief, rolled out along every push from its first pose."""
    return _motions(belief, belief.maps, belief.probability, observations)


def _motions(
    belief: Belief, maps: Maps, probability: FloatArray, observations: Sequence[Observation]
) -> tuple[Motion, ...]:
    found = belief.slider.rollout(maps, [observation.push for observation in observations])
    every = range(len(observations))
    return tuple(Motion(found.poses_of(b), found.forces_of(b), probability, belief.grid) for b in every)
