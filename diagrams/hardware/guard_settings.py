"""When the guard stops the arm."""

# Annotations stay objects: Drake's YAML reader looks at them.
from dataclasses import dataclass, field, replace

import numpy as np

from diagrams.execution.config import ExecutionConfig


@dataclass
class GuardSettings:
    """When the guard stops the arm; the defaults let everything pass that the executor plans.

    Attributes:
        status_age: oldest status of the arm that is good enough to move by, s.
        image_age: oldest picture that is good enough to move by, s.
        transit_speed: largest speed of the finger on its way to a push and back, m/s; at 0.4 the arm rests
            50 ms after the last status wherever it is, from faster ways later.
        tip_speed: largest speed of the finger's end that a command may ask for, m/s.
        joint_margin: what must be left to a joint's limit when the arm has come to rest, rad.
        following: by which a joint may be off all that it was told within `lag`, rad.
        lag: time that the arm has to get to where it was told to be, s.
        torque: (7) largest torque that contact may put on each joint, N m.
        stopping: longest time from the last free command to rest, s; slow motions stop sooner.
        patience: time that the arm has to send its first status, s.

    Raises:
        ValueError: a value out of range.
    """

    status_age: float = 0.025
    image_age: float = 1.0
    transit_speed: float = 0.4
    tip_speed: float = 1.7
    joint_margin: float = 0.0175
    following: float = 0.05
    lag: float = 0.1
    torque: list[float] = field(default_factory=lambda: [40.0, 40.0, 30.0, 30.0, 20.0, 15.0, 15.0])
    stopping: float = 0.05
    patience: float = 10.0

    def __post_init__(self) -> None:
        self.check()

    def check(self) -> None:
        """Raise ValueError where a field makes no sense."""
        for name, low, high in (
            ("status_age", 0.01, 0.5),
            ("image_age", 0.1, 60.0),
            ("transit_speed", 0.01, 2.0),
            ("tip_speed", 0.01, 2.5),
            ("joint_margin", 0.0, 0.3),
            ("following", 0.005, 0.5),
            ("lag", 0.02, 1.0),
            ("stopping", 0.02, 0.2),
            ("patience", 0.1, 600.0),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"guard.{name} must lie between {low} and {high}, got {value}")
        torque = np.array(self.torque, dtype=float)
        if torque.shape != (7,) or not ((torque > 0) & (torque <= 320.0)).all():
            raise ValueError(
                f"guard.torque must be seven torques above 0 and up to 320 N m, got {self.torque}"
            )

    def held_to(self, execution: ExecutionConfig) -> ExecutionConfig:
        """How the arm moves where this guard is to stop it in time."""
        return replace(execution, transit_speed=min(execution.transit_speed, self.transit_speed))
