"""Everything about the robot's cell that a user tunes: YAML dataclasses like those of Drake's scenarios."""

# Annotations stay objects: Drake's YAML reader looks at them.
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from shapely.affinity import rotate, translate

from diagrams.execution.config import ExecutionConfig
from diagrams.hardware.guard_settings import GuardSettings
from diagrams.perception.camera import CameraConfig
from diagrams.perception.depth_noise import DepthNoiseConfig
from diagrams.station.arm import ARM_MODELS
from diagrams.station.hidden_effects import HiddenEffectsConfig
from models.measurements.push_dataset import Table
from models.objects.benchmark import benchmark_object
from models.objects.true_object import (
    DEFAULT_CELLS,
    DEFAULT_MU_FINGER,
    TrueObject,
    object_from_labels,
    object_from_mesh,
)
from planners.goal_settings import GoalSettings
from planners.poke_settings import PokeSettings
from planners.pregrasp_settings import PushSettings

CLEARANCE = 0.02
"""Between the finger on its way and what it passes over, m."""

LONGEST_LABEL = 9
"""Digits of a label."""


@dataclass
class ObjectSettings:
    """The object on the table: one of the benchmark, or your own from a mesh or a label image.

    Attributes:
        name: of a benchmark object; not used where `mesh` or `labels` is given.
        mesh: file that trimesh can load; needs `mass` and `mu`.
        labels: picture whose pixels name segments; needs `metres_per_pixel`, `masses`, `frictions`, `height`.
        mass, mu: of an object of one material, from a mesh, kg.
        metres_per_unit: of the mesh, 0.001 for millimetres; as the file says where missing, else 1.
        metres_per_pixel: side of a pixel, m.
        masses, frictions: of each label.
        height: of an object from a label image, m.
        mu_finger: friction with the finger, of your own object.
        cells: wanted number of the true object's cells, of your own object.
        pose: x and y in m, turn in degrees, at the beginning.
    """

    name: str = "hammer"
    mesh: str | None = None
    labels: str | None = None
    mass: float | None = None
    mu: float | None = None
    metres_per_unit: float | None = None
    metres_per_pixel: float = 0.001
    masses: dict[str, float] = field(default_factory=dict)
    frictions: dict[str, float] = field(default_factory=dict)
    height: float = 0.03
    mu_finger: float = DEFAULT_MU_FINGER
    cells: int = DEFAULT_CELLS
    pose: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def check(self) -> None:
        """Raise ValueError where a field makes no sense."""
        if len(self.pose) != 3 or not np.isfinite(self.pose).all():
            raise ValueError(f"object.pose must be x, y in m and a turn in degrees, got {self.pose}")
        if self.mesh is not None and self.labels is not None:
            raise ValueError("object: give mesh or labels, not both")
        for name in ("mass", "mu", "metres_per_unit"):
            value = getattr(self, name)
            if value is not None and self.mesh is None:
                raise ValueError(
                    f"object.{name} is for an object of your own, from a mesh; {self.called} has its own"
                )
            if value is not None and not (np.isfinite(value) and value > 0):
                raise ValueError(f"object.{name} must be positive, got {value}")
        if self.mesh is not None and (self.mass is None or self.mu is None):
            raise ValueError("object: an object from a mesh needs mass (kg) and mu")
        for name in (*self.masses, *self.frictions):
            if not (name.isascii() and name.isdigit() and len(name) <= LONGEST_LABEL):
                raise ValueError(f"object: masses and frictions are by label, a whole number, got {name!r}")

    @property
    def called(self) -> str:
        """The object's name: that of its file, if it comes from one."""
        return Path(self.mesh or self.labels or self.name).stem

    def make(self) -> TrueObject:
        """The object.

        Raises:
            ValueError: it cannot be had; names the object, the file or the number.
        """
        if self.mesh is not None:
            assert self.mass is not None and self.mu is not None  # see check
            return object_from_mesh(
                self.mesh, self.mass, self.mu,
                mu_finger=self.mu_finger, count=self.cells, metres_per_unit=self.metres_per_unit,
            )  # fmt: skip
        if self.labels is not None:
            return object_from_labels(
                self.labels,
                self.metres_per_pixel,
                {int(label): value for label, value in self.masses.items()},
                {int(label): value for label, value in self.frictions.items()},
                height=self.height,
                mu_finger=self.mu_finger,
                count=self.cells,
            )
        return benchmark_object(self.name)


@dataclass
class TableSettings:
    """The table, its middle at the world's origin.

    Attributes:
        shape: round or rectangle.
        radius: of a round table, m.
        size: along x and y of a rectangular one, m.
        friction: of the table's own surface; the object's friction with it is the object's affair, but must
            be below twice this.
    """

    shape: str = "round"
    radius: float = 0.5
    size: list[float] = field(default_factory=lambda: [1.2, 0.8])
    friction: float = 0.6

    def check(self) -> None:
        """Raise ValueError where a field makes no sense."""
        if self.shape not in ("round", "rectangle"):
            raise ValueError(f"table.shape must be round or rectangle, got {self.shape!r}")
        lengths = np.array([self.radius, *self.size])
        if len(self.size) != 2 or not (np.isfinite(lengths) & (lengths > 0)).all():
            raise ValueError(f"table: radius and size must be positive, got {self.radius} and {self.size}")
        if not self.friction > 0:
            raise ValueError(f"table.friction must be positive, got {self.friction}")

    def make(self) -> Table:
        """The table top as push datasets describe it."""
        if self.shape == "round":
            return Table("round", (0.0, 0.0), radius=self.radius)
        return Table("rectangle", (0.0, 0.0), size=(self.size[0], self.size[1]))


@dataclass
class ArmSettings:
    """The arm.

    Attributes:
        models: `primitives`, which are part of slipmap, or `drake_models`, which Drake downloads.
    """

    models: str = "primitives"

    def check(self) -> None:
        """Raise ValueError where a field makes no sense."""
        if self.models not in ARM_MODELS:
            raise ValueError(f"arm.models must be one of {', '.join(ARM_MODELS)}, got {self.models!r}")


@dataclass
class SimulationSettings:
    """The simulated world.

    Attributes:
        time_step: of the plant, s; best a divisor of 10 ms, at which the finger is recorded: with 3 ms its
            record jitters by what it moves in a step, and a tap seems 20 % faster or slower. A path that is
            commanded in rows wants rows as long as steps, or a multiple: else the finger jerks.
    """

    time_step: float = 0.0025

    def check(self) -> None:
        """Raise ValueError where a field makes no sense."""
        if not 1e-4 <= self.time_step <= 0.01:
            raise ValueError(f"simulation.time_step must lie between 0.0001 and 0.01 s, got {self.time_step}")


@dataclass
class Scenario:
    """A robot's cell and what is done in it.

    Attributes:
        object: what lies on the table.
        table: where it lies.
        arm: what pushes it.
        execution: how it moves.
        guard: when a real arm is stopped.
        camera: what watches.
        depth_noise: how well it sees.
        hidden: physics of the true world that the plain model does not have; nothing by default.
        pokes: how the object is explored.
        goals: where at the table's edge it may be left.
        pushes: how it is pushed there.
        simulation: how the world is stepped.
    """

    object: ObjectSettings = field(default_factory=ObjectSettings)
    table: TableSettings = field(default_factory=TableSettings)
    arm: ArmSettings = field(default_factory=ArmSettings)
    execution: ExecutionConfig = field(default_factory=ExecutionConfig)
    guard: GuardSettings = field(default_factory=GuardSettings)
    camera: CameraConfig = field(default_factory=lambda: CameraConfig(rate=10.0))
    depth_noise: DepthNoiseConfig = field(default_factory=DepthNoiseConfig)
    hidden: HiddenEffectsConfig = field(default_factory=HiddenEffectsConfig)
    pokes: PokeSettings = field(default_factory=PokeSettings)
    goals: GoalSettings = field(default_factory=lambda: GoalSettings(count=60))
    pushes: PushSettings = field(default_factory=PushSettings)
    simulation: SimulationSettings = field(default_factory=SimulationSettings)

    def check_placement(self, thing: TrueObject) -> None:
        """Raise ValueError unless the object lies on the table, and the finger can pass over it."""
        x, y, degrees = self.object.pose
        lies = translate(rotate(thing.grid.polygon, degrees, origin=(0.0, 0.0)), x, y)
        corners = np.asarray(lies.exterior.coords)
        if self.table.shape == "round":
            on_table = bool((np.hypot(*corners.T) < self.table.radius).all())
            size = f"a radius of {self.table.radius:g} m"
        else:
            on_table = bool((np.abs(corners) < np.array(self.table.size) / 2).all())
            size = f"{self.table.size[0]:g} m by {self.table.size[1]:g} m"
        if not on_table:
            raise ValueError(
                f"object.pose: {thing.name} at x = {x:g} m, y = {y:g} m, {np.ptp(corners[:, 0]):.2f} m by"
                f" {np.ptp(corners[:, 1]):.2f} m, does not lie on the table, which has {size}"
            )
        highest = self.execution.safe_height - CLEARANCE
        if thing.height.max() > highest:
            raise ValueError(
                f"object {thing.name} is {thing.height.max():.3f} m high; the finger passes over what is at"
                f" most {highest:.3f} m high (execution.safe_height less {CLEARANCE} m)"
            )
