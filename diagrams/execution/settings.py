"""Settings of the arm's motion."""

# Annotations stay objects: Drake's YAML reader looks at them.
from dataclasses import dataclass

from slipmap.models.robots import FINGER_RADIUS
from slipmap.models.settings import CheckedSettings, within


@dataclass
class ExecutionConfig(CheckedSettings):
    """How the arm moves."""

    _section = "execution."

    tip_height: float = within(0.004, 0.001, 0.05)  # of the finger's end over the table while it pushes, m
    finger_radius: float = within(FINGER_RADIUS, 0.002, 0.02)  # of the round finger that pushes, m
    # of the finger's end over the table while it passes over things, m; the higher, the less of the table can
    # be reached
    safe_height: float = within(0.10, 0.02, 0.3)
    push_speed_limit: float = within(0.3, 0.001, 1.0)  # of the finger while it pushes, m/s
    # of the finger on its way to a push and back, m/s; before a real arm no more than `guard.transit_speed`
    transit_speed: float = within(1.5, 0.01, 2.0)
    lowering_speed: float = within(0.25, 0.01, 1.0)  # of the finger on its way down and up, m/s
    speeding_up: float = within(0.5, 0.01, 5.0)  # the finger's acceleration at the begin of a push, m/s²
    slowing_down: float = within(1.0, 0.01, 5.0)  # at its end, m/s²
    settle: float = within(0.3, 0.0, 60.0)  # time the finger rests at the end of a push, s
    # of the open gripper on its way in to the object, and of the lifted object, m/s
    grasping_speed: float = within(0.1, 0.01, 0.5)
    closing: float = within(1.5, 0.5, 10.0)  # time that the gripper has to close, s

    def check(self) -> None:
        """Raise ValueError where a field makes no sense."""
        super().check()
        if self.safe_height <= self.tip_height:
            raise ValueError(
                f"execution.safe_height {self.safe_height} must exceed tip_height {self.tip_height}"
            )
