"""Where the two sides of a cell meet: the network's address, channels and rates."""

from __future__ import annotations

LCM_URL = "udpm://239.255.76.67:7667?ttl=0"
"""LCM's usual address; with ttl=0 nothing leaves this computer."""

IIWA_STATUS, IIWA_COMMAND = "IIWA_STATUS", "IIWA_COMMAND"
GRIPPER_STATUS, GRIPPER_COMMAND = "SCHUNK_WSG_STATUS", "SCHUNK_WSG_COMMAND"
CAMERA_DEPTH, CAMERA_COLOR, CAMERA_POSE = "CAMERA_DEPTH", "CAMERA_COLOR", "CAMERA_POSE"
ABORT = "ABORT"

ARM_PERIOD = 0.005
"""s between two messages of the arm, in both directions."""
GRIPPER_PERIOD = 0.05
"""s between two messages of the gripper, in both directions."""
COLOR_PERIOD = 1.0
"""s between two colour pictures, which nothing but people look at."""


class HardwareError(RuntimeError):
    """The cell cannot be reached or does not answer. The text says what to do."""
