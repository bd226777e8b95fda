"""What a cell would say in which an arm pushes a box straight ahead: messages without a simulation."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field

import numpy as np
from drake import (
    lcmt_drake_signal,
    lcmt_iiwa_status,
    lcmt_image,
    lcmt_image_array,
    lcmt_schunk_wsg_status,
)

from slipmap.diagrams.execution.arm_motion import FingerKinematics
from slipmap.diagrams.execution.plans import ArmPlanner
from slipmap.diagrams.execution.requests import ExecutionConfig
from slipmap.diagrams.hardware import network
from slipmap.diagrams.hardware.message_stream import Event
from slipmap.diagrams.perception.camera import CameraConfig
from slipmap.diagrams.station.arm import arm_model
from slipmap.diagrams.station.scenario import Scenario
from slipmap.models.perception.pinhole_camera import View
from slipmap.models.robots import FINGER_RADIUS
from slipmap.planners.table_push import TablePush
from tests.models.perception.conftest import Scene

LENGTH, WIDTH, HEIGHT = 0.10, 0.06, 0.03
"""Of the box, m."""
TURN = 0.35
"""Of the box, and direction of the push, rad; edges along rows of pixels would be seen badly."""
AHEAD = np.array([np.cos(TURN), np.sin(TURN)])
PUSH = TablePush(-0.09 * AHEAD, 0.01 * AHEAD, 0.08)
FORCE = 3.0
"""N, of the finger on the box."""
BEFORE, AFTER = 1.7, 1.0
"""s of rest before and after."""
HOME_TIP = np.array([-0.28, -0.15, 0.12])
"""(3,) of the finger's end between pushes, m, from where the box is seen past the arm."""
BEGIN = 100.0
"""s of the arm's clock at the begin."""
_ARRIVED = 1_700_000_000_000_000  # µs


def scenario() -> Scenario:
    """The cell."""
    return Scenario(camera=CameraConfig(width=320, height_pixels=240, fov_y=0.5, rate=10.0))


@dataclass
class MadeUpCell:
    """An arm pushes a box once.

    Attributes:
        late: s by which the camera stamps and sends its pictures late.
        push: what the finger does.
    """

    late: float = 0.0
    push: TablePush = PUSH
    _pictures: dict[float, bytes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._kinematics = FingerKinematics(arm_model())
        home = self._kinematics.inverse(HOME_TIP)
        self.plan = ArmPlanner(self._kinematics, ExecutionConfig(), home).push(self.push, home)
        self.duration = BEFORE + self.plan.duration + AFTER
        self._scene = Scene()
        camera = scenario().camera
        self._X_WC = camera.X_WC
        self._scene.view = View(camera.intrinsics, self._X_WC.GetAsMatrix4())
        self._times = np.arange(0.0, self.duration, network.ARM_PERIOD)
        self._q = np.array([self.plan.at(max(t - BEFORE, 0.0))[1] for t in self._times])
        self.tips = np.array([self._kinematics.pose(q).translation() for q in self._q])
        along, aside = self.tips[:, :2] @ AHEAD, self.tips[:, :2] @ [-AHEAD[1], AHEAD[0]]
        down = (self.tips[:, 2] < 0.5 * HEIGHT) & (np.abs(aside) < 0.5 * WIDTH)
        reach = np.where(down, along + FINGER_RADIUS + 0.5 * LENGTH, 0.0)
        self.way = np.maximum.accumulate(np.maximum(reach, 0.0))
        """(n,) of the box until each of the arm's messages, m."""
        self._touches = down & (reach >= self.way - 1e-9) & (np.gradient(self.way) > 0)

    def events(self) -> list[Event]:
        """All messages, in the order in which they come."""
        timed: list[tuple[float, str, bytes]] = []
        for k, time in enumerate(self._times):
            timed.append((time, network.IIWA_STATUS, self._status(k)))
        for time in np.arange(0.0, self.duration, network.GRIPPER_PERIOD):
            timed.append((time, network.GRIPPER_STATUS, gripper(time)))
        for time in np.arange(0.0, self.duration - self.late, 0.1):
            then = time + self.late
            timed.append((then, network.CAMERA_POSE, self._pose(then)))
            timed.append((then, network.CAMERA_DEPTH, self._picture(time, then)))
        timed.sort(key=lambda row: row[0])
        return [
            Event(number, _ARRIVED + round(1e6 * time), channel, data)
            for number, (time, channel, data) in enumerate(timed)
        ]

    def _status(self, k: int) -> bytes:
        message = lcmt_iiwa_status()
        message.utime, message.num_joints = round(1e6 * (BEGIN + self._times[k])), 7
        q = [float(angle) for angle in self._q[k]]
        message.joint_position_measured = message.joint_position_commanded = q
        message.joint_position_ipo = [0.0] * 7
        message.joint_velocity_estimated = [0.0] * 7
        message.joint_torque_measured = message.joint_torque_commanded = [0.0] * 7
        force = -FORCE * self._touches[k] * np.array([*AHEAD, 0.0])
        torque = self._kinematics.jacobian(self._q[k])[3:].T @ force
        message.joint_torque_external = [float(value) for value in torque]
        return bytes(message.encode())

    def _pose(self, then: float) -> bytes:
        message = lcmt_drake_signal()
        message.dim, message.timestamp = 7, round(1e6 * (BEGIN + then))
        message.coord = ["x", "y", "z", "qw", "qx", "qy", "qz"]
        message.val = [*self._X_WC.translation(), *self._X_WC.rotation().ToQuaternion().wxyz()]
        return bytes(message.encode())

    def _picture(self, time: float, then: float) -> bytes:
        way = float(np.interp(time, self._times, self.way))
        if way not in self._pictures:
            half = (-0.5 * LENGTH, -0.5 * WIDTH, 0.5 * LENGTH, 0.5 * WIDTH, HEIGHT)
            depth = self._scene.depth([half], (*(way * AHEAD), TURN))
            self._pictures[way] = zlib.compress(depth.tobytes(), 1)
        image = lcmt_image()
        image.width, image.height, image.row_stride = 320, 240, 1280
        image.pixel_format = lcmt_image.PIXEL_FORMAT_DEPTH
        image.channel_type = lcmt_image.CHANNEL_TYPE_FLOAT32
        image.compression_method = lcmt_image.COMPRESSION_METHOD_ZLIB
        image.data = self._pictures[way]
        image.size = len(image.data)
        message = lcmt_image_array()
        message.num_images, message.images = 1, [image]
        message.header.utime = round(1e6 * (BEGIN + then))
        return bytes(message.encode())


def gripper(time: float, opening: float = 0.0) -> bytes:
    """A message of the gripper, open by some m."""
    message = lcmt_schunk_wsg_status()
    message.utime, message.actual_position_mm = round(1e6 * (BEGIN + time)), 1e3 * opening
    return bytes(message.encode())
