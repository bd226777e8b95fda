"""All commands that the arm was sent, and how fast they asked it to move."""

from __future__ import annotations

import os
import select
import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from drake import lcmt_iiwa_command

from slipmap.diagrams.execution.finger_kinematics import FingerKinematics
from slipmap.diagrams.hardware.child import Child, be_ready
from slipmap.diagrams.hardware.network import IIWA_COMMAND, LOOK_EVERY, open_lcm
from slipmap.diagrams.station.arm import arm_model
from slipmap.models.physics.cell_grid import FloatArray


@dataclass(frozen=True, eq=False)
class CommandLog:
    """Commands in the order in which they were sent."""

    times: FloatArray  # (n,) stamps of the sender, increasing, s
    q: FloatArray  # (n, 7) joint angles, rad

    @staticmethod
    def of(rows: FloatArray) -> CommandLog:
        """From rows (n, 8) of a stamp and seven angles; what repeats a stamp, or goes back, is left out."""
        rows = np.asarray(rows, dtype=float).reshape(-1, 8)
        if len(rows):
            newest = np.maximum.accumulate(rows[:, 0])
            rows = rows[np.r_[True, rows[1:, 0] > newest[:-1]]]
        return CommandLog(rows[:, 0], rows[:, 1:])

    @cached_property
    def joint_speeds(self) -> FloatArray:
        """(n - 1, 7) from one command to the next, rad/s."""
        return np.diff(self.q, axis=0) / np.diff(self.times)[:, None]

    @cached_property
    def tip_speeds(self) -> FloatArray:
        """(n - 1,) of the finger's end, m/s."""
        kinematics = FingerKinematics(arm_model())
        tips = np.array([kinematics.pose(q).translation() for q in self.q]).reshape(-1, 3)
        return np.linalg.norm(np.diff(tips, axis=0), axis=1) / np.diff(self.times)


class CommandRecorder(Child):
    """A process that hears commands and writes them to a file; `close` ends it.

    Args:
        url: LCM address at which the commands are heard.
    """

    def __init__(self, url: str, path: Path) -> None:
        self._path = path
        super().__init__("the process that records commands", _record, url, str(path))

    def log(self) -> CommandLog:
        """All commands until a moment ago."""
        data = self._path.read_bytes()
        return CommandLog.of(np.frombuffer(data[: len(data) // 64 * 64], "<f8"))


def row_of(data: bytes) -> list[float]:
    """Stamp, s, and angles of a command as it is sent."""
    command = lcmt_iiwa_command.decode(data)
    return [1e-6 * command.utime, *command.joint_position]


def _record(url: str, path: str) -> None:
    source = sys.stdin.fileno()
    with open(path, "wb", buffering=0) as file:

        def hear(data: bytes) -> None:
            file.write(np.array(row_of(data), "<f8").tobytes())

        lcm = open_lcm(url)
        lcm.Subscribe(IIWA_COMMAND, hear)
        be_ready()
        while True:
            if select.select([source], [], [], LOOK_EVERY)[0] and not os.read(source, 1):
                return
            lcm.HandleSubscriptions(0)
