"""The simulated true worlds of a campaign, and beliefs learned from pushes in them.

The finger moves directly, without an arm. Each object's world and each belief is made once per process.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import ClassVar

import numpy as np
import shapely

from slipmap.diagrams.loops.exploration_loop import SENSORS
from slipmap.diagrams.station.table import ROUND_TABLE
from slipmap.models.geometry import placed, seen_from
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements import PushDataset, Trial, finger_path
from slipmap.models.measurements.motion import interpolated, smooth_track
from slipmap.models.measurements.push_dataset import Noise, dataset_of
from slipmap.models.measurements.trial import Channel
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import FINGER_RADIUS
from slipmap.planners.pregrasp import learn_by_pushing
from slipmap.planners.push_decisions import ObjectFell, PushNotMade
from slipmap.planners.settings import PregraspSettings
from slipmap.planners.table_push import TablePush

REST = 0.3  # time that the finger rests before and after moving, s; a tapped object slides on
RAMP = 0.1  # time to speed up and to slow down, s
PERIOD = 0.01  # time between two rows of tip and force, s
LONGEST_SETTLING = 3.0  # longest wait for an object to come to rest, s
AT_REST = 5e-3  # speed below which an object rests, m/s and rad/s
_WORST_MISS = 2.5  # standard deviations of control noise
_TILTED = np.cos(np.radians(10.0))  # cosine of the tilt from which an object is no longer flat on the table
_SUNK = 5e-3  # m; depth from which it is no longer flat on the table


@dataclass(frozen=True)
class WorldNoise:
    """Errors of a world's control and of its sensors."""

    # standard deviation of each coordinate of a push's start and end, m; truncated at 2.5 times that
    control: float = 2e-3
    # standard deviations of every row; the outline is the true one
    sensors: Noise = field(default_factory=lambda: replace(SENSORS, outline=None))
    camera: float = 15.0  # poses per second during a push; 0 for only those before and after

    def __post_init__(self) -> None:
        for name in ("control", "camera"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(f"world noise: {name} must be finite and not negative, got {value}")


@dataclass(frozen=True, eq=False)
class Motion:
    """Recording of a finger motion, a row every `PERIOD`."""

    poses: FloatArray  # (T, 3) of the object, NaN once it is no longer flat on the table
    tips: FloatArray  # (T, 2) of the finger's centre, m
    # (T, 2) of the finger on the object, world, N: mean since the previous row
    forces: FloatArray


class DirectWorld(ABC):
    """One object on a table; a `slipmap.planners.push_decisions.World`. Subclasses implement the engine.

    A world is built once and used for many trials: `reset` starts one.
    """

    finger_radius = FINGER_RADIUS
    table = ROUND_TABLE
    _step: ClassVar[float]  # time step of the finger's path, s; a whole fraction of `PERIOD`

    def __init__(self, true_object: TrueObject, noise: WorldNoise | None = None) -> None:
        self.true_object = true_object
        self.noise = noise or WorldNoise()
        self.pushes = 0
        self._rng = np.random.default_rng(0)
        self._seen = np.zeros(3)

    def reset(self, pose: FloatArray, rng: np.random.Generator) -> None:
        """Start a trial: place the object at a pose (3,) and wait until it rests or falls.

        Args:
            pose: world, m and rad.
            rng: source of all noise until the next reset.
        """
        self._rng = rng
        self.pushes = 0
        self._seen = np.array(pose, dtype=float)
        self._place(self._seen)
        if not self._inside():
            self._settle()

    @property
    def true_pose(self) -> FloatArray:
        """(3,) true pose in the world, m and rad; the angle is continuous over pushes.

        Raises:
            ObjectFell: it is not flat on the table.
        """
        pose = self._pose()
        if not np.isfinite(pose).all():
            x, y, angle = self._seen
            raise ObjectFell(
                f"the {self.true_object.name} fell; it was seen last at x = {1e3 * x:.0f} mm,"
                f" y = {1e3 * y:.0f} mm, turned by {np.degrees(angle):.0f}°"
            )
        return _continued(self._seen, pose)

    def look(self) -> FloatArray:
        """(3,) pose in the world with the camera's noise, m and rad.

        Raises:
            ObjectFell: it is not flat on the table.
        """
        self._seen = self._measured(self.true_pose[None], *self._camera_noise())[0]
        return self._seen.copy()

    def push(self, push: TablePush) -> Trial:
        """Lower the finger, move it, lift it, and wait until the object rests.

        The finger's start and end have control noise. The trial has the pose before, poses during the push if
        there is a camera, and the pose at rest afterwards; rows of tip and force are 0.01 s apart.

        Raises:
            PushNotMade: the finger would land on the object, or the object is gone.
        """
        try:
            before = self.true_pose
        except ObjectFell as error:
            raise PushNotMade(str(error)) from error
        begin, end = (
            point + self.noise.control * np.clip(self._rng.standard_normal(2), -_WORST_MISS, _WORST_MISS)
            for point in (push.begin, push.end)
        )
        local = seen_from(begin, before)
        gap = float(shapely.distance(self.true_object.grid.polygon, shapely.Point(local)))
        if gap < self.finger_radius:
            raise PushNotMade(
                f"the finger would land on the {self.true_object.name}: its centre at"
                f" ({1e3 * begin[0]:.0f}, {1e3 * begin[1]:.0f}) mm is {1e3 * gap:.1f} mm from the outline,"
                f" closer than its radius of {1e3 * self.finger_radius:.0f} mm"
            )
        motion = self._drive(commanded_path(replace(push, begin=begin, end=end), self._step))
        self._settle()
        trial = self._recorded(motion)
        self.pushes += 1
        return trial

    def replayed(self, trial: Trial, pose: FloatArray) -> FloatArray:
        """Place the object at a pose (3,) and let the finger follow a recorded track, without noise.

        Returns:
            (3,) pose where the object comes to rest, m and rad; NaN if it falls. Whole turns are lost.
        """
        self.reset(pose, np.random.default_rng(0))
        time, track, _ = smooth_track(*finger_path(trial))
        rows = int(np.ceil(time[-1] / PERIOD)) * round(PERIOD / self._step)
        self._drive(interpolated(self._step * np.arange(rows + 1, dtype=float), time, track))
        self._settle()
        return self._pose()

    def _recorded(self, motion: Motion) -> Trial:
        """The motion as the sensors report it. The last row is the object at rest, if it is still there."""
        poses, count = motion.poses.copy(), len(motion.poses)
        poses[-1] = self._pose()
        stride = 1.0 / (self.noise.camera * PERIOD) if self.noise.camera else count
        rows = np.unique([0, 1, *np.arange(0, count - 1, stride).astype(int), count - 1])
        rows = rows[np.isfinite(poses[rows]).all(axis=1)]
        poses[rows, 2] = np.unwrap(poses[rows, 2], axis=0)
        poses[rows, 2] += _continued(self._seen, poses[0])[2] - poses[0, 2]
        time = PERIOD * np.arange(count, dtype=float)
        sensors = self.noise.sensors
        force = self._measured(motion.forces, sensors.force, sensors.force)
        return Trial(
            f"trials/{self.pushes:03d}.json",
            "fit",
            Channel(time[rows], self._measured(poses[rows], *self._camera_noise())),
            Channel(time, self._measured(motion.tips, sensors.tip, sensors.tip)),
            Channel(np.maximum(time - PERIOD / 2, time / 2), np.column_stack([force, np.zeros(count)])),
        )

    def _camera_noise(self) -> tuple[float | None, ...]:
        sensors = self.noise.sensors
        return sensors.position, sensors.position, sensors.angle

    def _measured(self, values: FloatArray, *levels: float | None) -> FloatArray:
        sigma = np.array([level or 0.0 for level in levels])
        return values + sigma * self._rng.standard_normal(values.shape)

    def _inside(self) -> bool:
        """Whether the whole footprint lies on the table."""
        corners = placed(self.true_object.grid.exterior, self._seen)
        return bool((self.table.margin(corners) > 0.0).all())

    @abstractmethod
    def _place(self, pose: FloatArray) -> None:
        """Place the object at rest, with the finger away."""

    @abstractmethod
    def _drive(self, tip: FloatArray) -> Motion:
        """Let the finger follow a path (N + 1, 2), a row per step, then take it away."""

    @abstractmethod
    def _settle(self) -> None:
        """Wait until the object rests or has fallen."""

    @abstractmethod
    def _pose(self) -> FloatArray:
        """(3,) true pose, NaN where the object is not flat on the table."""


def commanded_path(push: TablePush, step: float) -> FloatArray:
    """(N + 1, 2) finger centre, m, a row per `step` (s): rest, motion, rest."""
    pace = push.pace(push.speed / RAMP, push.speed / RAMP)
    rows = int(np.ceil((pace.duration + 2 * REST) / PERIOD)) * round(PERIOD / step)
    return push.begin + np.outer(pace.at(step * np.arange(rows + 1, dtype=float) - REST), push.direction)


def flat_pose(place: FloatArray, w: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """(…, 3) planar poses from positions (…, 3) and quaternions w, x, y, z (…); NaN where the object is not
    flat on the table."""
    angle = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2))
    pose = np.stack([place[..., 0], place[..., 1], angle], axis=-1)
    pose[(1 - 2 * (x**2 + y**2) < _TILTED) | (place[..., 2] < -_SUNK)] = np.nan
    return pose


def _continued(before: FloatArray, pose: FloatArray) -> FloatArray:
    """The pose with whole turns added to its angle to bring it closest to the previous one."""
    turns = np.round((before[2] - pose[2]) / (2 * np.pi))
    return np.array([pose[0], pose[1], pose[2] + 2 * np.pi * turns])


_MOST_PUSHES = 5  # for identifying an object, as in the paper


@lru_cache(maxsize=16)
def world_of(truth: str, object_name: str) -> DirectWorld:
    """The world of one of the paper's objects on the paper's table, with the usual noise.

    Args:
        truth: `plant`, Drake's MultibodyPlant, or `bullet`.

    Raises:
        ValueError: an unknown object.
        ModuleNotFoundError: Bullet, of the extra `bench`, is not installed.
    """
    thing = benchmark_object(object_name)
    if truth == "bullet":
        from slipmap.diagrams.application.campaigns.bullet_world import BulletWorld

        return BulletWorld(thing)
    from slipmap.diagrams.application.campaigns.plant_world import PlantWorld

    return PlantWorld(thing)


def as_dataset(world: DirectWorld, fit: Sequence[Trial], heldout: Sequence[Trial] = ()) -> PushDataset:
    """Recorded trials as a dataset: fit pushes first, then held-out pushes.

    Raises:
        DatasetError: there is no trial.
    """
    trials = [
        replace(trial, name=f"trials/{number:03d}.json", role="fit" if number < len(fit) else "heldout")
        for number, trial in enumerate([*fit, *heldout])
    ]
    return dataset_of(
        trials,
        world.true_object.grid,
        name=world.true_object.name,
        finger_radius=world.finger_radius,
        noise=world.noise.sensors,
        table=world.table,
        description=f"Recorded in the world of {type(world).__name__}.",
    )


@lru_cache(maxsize=32)
def identified(truth: str, object_name: str, seed: int) -> Belief:
    """Belief from five pushes of an object in its world; made once per process and seed.

    Raises:
        ObjectFell, PushNotMade: the object could not be explored.
    """
    return explored(world_of(truth, object_name), seed)[0]


def explored(world: DirectWorld, seed: int) -> tuple[Belief, tuple[Trial, ...]]:
    """Belief from `_MOST_PUSHES` pushes of the object at the middle of the table, and the pushes.

    Raises:
        ObjectFell, PushNotMade: the object could not be explored.
    """
    rng = np.random.default_rng([seed, 0])
    world.reset(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]), rng)
    return learn_by_pushing(
        world,
        world.true_object.grid,
        lambda trials, grid: as_dataset(world, trials),
        PregraspSettings(explorations=_MOST_PUSHES),
        np.random.default_rng([seed, 1]),
    )
