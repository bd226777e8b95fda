"""The robot: its model files, and the limits and dimensions that other code needs.

A test checks that the limits match the files; `iiwa14.urdf` names their sources.
"""

from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parent
IIWA_MODEL = FOLDER / "iiwa14.urdf"
GRIPPER_MODEL = FOLDER / "comb_gripper.urdf"

ARM_JOINTS = tuple(f"iiwa_joint_{i}" for i in range(1, 8))

POSITION_LIMITS = np.deg2rad([170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0])
"""(7,) each joint turns this far either way, rad."""
SPEED_LIMITS = np.deg2rad([85.0, 85.0, 100.0, 75.0, 130.0, 135.0, 135.0])  # (7,) rad/s
ACCELERATION_LIMITS = np.array([8.57, 8.57, 8.74, 11.36, 12.23, 15.72, 15.72])  # (7,) rad/s²
TORQUE_LIMITS = np.array([320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0])  # (7,) N m
FLANGE_HEIGHT = 0.045  # from the origin of the last link to the flange, along the link's z, m
FINGER_RADIUS = 0.008  # radius of the closed gripper's round finger at its collar, where it pushes, m
PIN_RADIUS = 0.0075  # radius of the rest of the finger, of which each half is a pin that grasps, m
FINGER_LENGTH = 0.1  # from the finger's tip to the hand, m
GRIPPER_OPENING = 0.11
"""Largest distance between the axes of the two pins, m; the free gap is two finger radii less."""
GRIP_FORCE = 80.0  # largest force of a pin, N
HAND_RADIUS = 0.04  # radius of the hand, a capsule along the direction in which the pins close, m
HAND_DISTANCE = 0.16  # from the finger's tip back to the capsule's axis, m
