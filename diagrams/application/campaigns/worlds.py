"""The worlds that play the truth in a campaign, and what is learned from pushes in them.

In them the finger is moved directly, without an arm. Each object's world is built, and each belief is made,
once in a process.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
import shapely

from slipmap.diagrams.loops.exploration_loop import SENSORS
from slipmap.diagrams.station.table import ROUND_TABLE
from slipmap.diagrams.systems.measurement_logger import dataset_of
from slipmap.models.geometry import placed, seen_from
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements import PushDataset, Trial
from slipmap.models.measurements.push_dataset import Channel, Noise, Table
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import FINGER_RADIUS
from slipmap.planners.pregrasp import learn_by_pushing
from slipmap.planners.push_decisions import ObjectFell, PushNotMade
from slipmap.planners.settings import PregraspSettings
from slipmap.planners.table_push import TablePush

REST = 0.3
"""s that the finger stands still before and after it moves; an object that was tapped slides on."""
RAMP = 0.1
"""s in which it speeds up, and slows down."""
PERIOD = 0.01
"""s between two rows of tip and force."""

LONGEST_SETTLING = 3.0
"""s that an object is waited for until it rests."""
AT_REST = 5e-3
"""m/s and rad/s below which it does."""

_WORST_MISS = 2.5  # standard deviations of control noise
_TILTED = np.cos(np.radians(10.0))  # of an object that is not flat on the table any more
_SUNK = 5e-3  # m; the same


@dataclass(frozen=True)
class WorldNoise:
    """How far a world is from what is asked for and reported."""

    # standard deviation of each coordinate of a push's begin and of its end, m; cut off at 2.5 times that
    control: float = 2e-3
    sensors: Noise = field(default_factory=lambda: SENSORS)  # one standard deviation of every row
    camera: float = 15.0  # poses a second while the finger pushes; 0 for none but those before and after

    def __post_init__(self) -> None:
        for name in ("control", "camera"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(f"world noise: {name} must be finite and not negative, got {value}")


@dataclass(frozen=True, eq=False)
class Motion:
    """What happened while the finger moved, a row each `PERIOD`."""

    poses: FloatArray  # (T, 3) of the object, NaN once it is not flat on the table any more
    tips: FloatArray  # (T, 2) of the finger's centre, m
    # (T, 2) of the finger on the object, world, N: mean over the time since the row before
    forces: FloatArray


class DirectWorld(ABC):
    """One object on a table; a `slipmap.planners.push_decisions.World`. Engines fill in how things move.

    A world is built once and used for many trials: `reset` begins one.
    """

    finger_radius = FINGER_RADIUS

    def __init__(
        self, true_object: TrueObject, table: Table = ROUND_TABLE, noise: WorldNoise | None = None
    ) -> None:
        self.true_object = true_object
        self.table = table
        self.noise = noise or WorldNoise()
        self.pushes = 0
        self._rng = np.random.default_rng(0)
        self._seen = np.zeros(3)

    def reset(self, pose: FloatArray, rng: np.random.Generator) -> None:
        """Begin a trial: the object is put down at a pose (3,) and left alone until it rests or falls.

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
        """(3,) world, m and rad; the angle is continuous over pushes.

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
        """(3,) pose with the camera's noise.

        Raises:
            ObjectFell: it is not flat on the table.
        """
        self._seen = self._measured(self.true_pose[None], *self._camera_noise())[0]
        return self._seen.copy()

    def push(self, push: TablePush) -> Trial:
        """Lower the finger, move it, lift it, and wait until the object rests.

        The finger begins and ends a little off. The trial has the pose before, some on the way if there is a
        camera, and the one at rest afterwards; tip and force are rows of 0.01 s.

        Raises:
            PushNotMade: the finger would come down on the object, or the object is gone.
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
                f"the finger would come down on the {self.true_object.name}: its centre at"
                f" ({1e3 * begin[0]:.0f}, {1e3 * begin[1]:.0f}) mm is {1e3 * gap:.1f} mm from the outline,"
                f" nearer than its radius of {1e3 * self.finger_radius:.0f} mm"
            )
        motion = self._drive(finger_path(replace(push, begin=begin, end=end), self._step))
        self._settle()
        trial = self._recorded(motion)
        self.pushes += 1
        return trial

    def _recorded(self, motion: Motion) -> Trial:
        """The motion as sensors report it. The last row is the object at rest, if it is still there."""
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
        corners = placed(self.true_object.grid.exterior, self._seen) - np.asarray(self.table.center)
        if self.table.radius is not None:
            return bool((np.hypot(*corners.T) < self.table.radius).all())
        assert self.table.size is not None
        return bool((np.abs(corners) < 0.5 * np.asarray(self.table.size)).all())

    @property
    @abstractmethod
    def _step(self) -> float:
        """Of the finger's path, s; a whole fraction of `PERIOD`."""

    @abstractmethod
    def _place(self, pose: FloatArray) -> None:
        """Put the object down at rest; the finger is away."""

    @abstractmethod
    def _drive(self, tip: FloatArray) -> Motion:
        """Let the finger follow a path (N + 1, 2), a row each step, then take it away."""

    @abstractmethod
    def _settle(self) -> None:
        """Wait until the object rests or has fallen."""

    @abstractmethod
    def _pose(self) -> FloatArray:
        """(3,) true pose, NaN where the object is not flat on the table."""


def finger_path(push: TablePush, step: float) -> FloatArray:
    """(N + 1, 2) finger centre, a row each `step` in s: it rests, goes its way, and rests."""
    pace = push.pace(push.speed / RAMP, push.speed / RAMP)
    rows = int(np.ceil((pace.duration + 2 * REST) / PERIOD)) * round(PERIOD / step)
    return push.begin + np.outer(pace.at(step * np.arange(rows + 1, dtype=float) - REST), push.direction)


def flat_pose(place: FloatArray, w: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """(…, 3) of an object at places (…, 3) with quaternions w, x, y, z (…); NaN where it is not flat on the
    table."""
    angle = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2))
    pose = np.stack([place[..., 0], place[..., 1], angle], axis=-1)
    pose[(1 - 2 * (x**2 + y**2) < _TILTED) | (place[..., 2] < -_SUNK)] = np.nan
    return pose


def _continued(before: FloatArray, pose: FloatArray) -> FloatArray:
    """The pose with whole turns added to its angle so that it is nearest to that before."""
    turns = np.round((before[2] - pose[2]) / (2 * np.pi))
    return np.array([pose[0], pose[1], pose[2] + 2 * np.pi * turns])


TRUTHS = ("plant", "bullet")
"""Drake's MultibodyPlant; Bullet, which needs the `bench` extra."""

_MOST_PUSHES = 5  # from which an object is identified, as in the paper


@lru_cache(maxsize=16)
def world_of(truth: str, object_name: str) -> DirectWorld:
    """The world of one of the paper's objects on the paper's table, with the usual noise.

    Raises:
        ValueError: an unknown truth or object.
        ModuleNotFoundError: Bullet is not installed.
    """
    thing = benchmark_object(object_name)
    if truth == "plant":
        from slipmap.diagrams.application.campaigns.plant_world import PlantWorld

        return PlantWorld(thing)
    if truth == "bullet":
        from slipmap.diagrams.application.campaigns.bullet_world import BulletWorld

        return BulletWorld(thing)
    raise ValueError(f"unknown truth {truth!r}; choose one of {', '.join(TRUTHS)}")


def as_dataset(world: DirectWorld, fit: Sequence[Trial], heldout: Sequence[Trial] = ()) -> PushDataset:
    """RecordedRun trials as a dataset: those to learn from, then those to judge with.

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
        description=f"RecordedRun in the world of {type(world).__name__}.",
    )


@lru_cache(maxsize=32)
def identified(truth: str, object_name: str, seed: int) -> Belief:
    """What five pushes of an object in its world teach; made once in a process for each seed.

    Raises:
        ObjectFell, PushNotMade: the object could not be explored.
    """
    return explored(world_of(truth, object_name), seed)[0]


def explored(world: DirectWorld, seed: int) -> tuple[Belief, tuple[Trial, ...]]:
    """What `_MOST_PUSHES` pushes teach of the object at the table's middle, and the pushes.

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
