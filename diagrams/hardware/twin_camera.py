"""The twin's camera in a process of its own, so that rendering does not keep the arm waiting.

It is started as `python -m slipmap.diagrams.hardware.twin_camera URL`, is told the scenario and then, picture by
picture, the time and the positions of all that moves.
"""

from __future__ import annotations

import os
import pickle
import select
import struct
import sys

import numpy as np

from slipmap.diagrams.hardware import channels
from slipmap.diagrams.hardware.channels import HardwareError
from slipmap.diagrams.hardware.child import Child, be_ready
from slipmap.diagrams.hardware.network import open_lcm
from slipmap.diagrams.station.scenario import Scenario
from slipmap.models.physics.cell_grid import FloatArray

_LENGTH = struct.Struct("<Q")


class TwinCamera:
    """The process; `close` ends it.

    Args:
        scenario: what the cell is like.
        url: where pictures go.

    Raises:
        HardwareError: it could not be started.
    """

    def __init__(self, scenario: Scenario, url: str) -> None:
        self._child = Child("the process that renders pictures", __name__, url)
        data = pickle.dumps(scenario)
        self._child.send(_LENGTH.pack(len(data)) + data)
        self._child.wait_until_ready()

    def take(self, time: float, positions: FloatArray) -> None:
        """Have a picture taken of a plant with some positions, stamped with a time, s.

        If earlier ones are still to be taken, they are left out.

        Raises:
            HardwareError: the process has ended.
        """
        self._child.send(np.array([time, *positions], "<f8").tobytes())

    def close(self) -> None:
        """End the process."""
        self._child.close()


def main(url: str) -> None:
    """Take pictures of what comes in on the standard input until it ends."""
    from pydrake.systems.analysis import Simulator

    from slipmap.diagrams.hardware.twin import CellTwin

    source = sys.stdin.fileno()
    scenario: Scenario = pickle.loads(_read(source, _LENGTH.unpack(_read(source, _LENGTH.size))[0]))
    twin = CellTwin(scenario, open_lcm(url, listens=False), arm=False)
    root = Simulator(twin).get_mutable_context()
    plant = twin.station.plant
    state = plant.GetMyMutableContextFromRoot(root)
    size, color_due = 8 * (1 + plant.num_positions()), 0.0
    twin.station.GetOutputPort("camera.depth_image").Eval(twin.station.GetMyContextFromRoot(root))
    be_ready()
    while frame := _read(source, size):
        while select.select([source], [], [], 0.0)[0] and (newer := _read(source, size)):
            frame = newer
        time, *positions = np.frombuffer(frame, "<f8")
        root.SetTime(time)
        plant.SetPositions(state, np.array(positions))
        for channel, publisher in twin.camera_publishers.items():
            if channel == channels.CAMERA_COLOR:
                if time < color_due:
                    continue
                color_due = time + channels.COLOR_PERIOD
            publisher.ForcedPublish(publisher.GetMyContextFromRoot(root))


def _read(source: int, size: int) -> bytes:
    """So many bytes, or none where the input ends before."""
    data = b""
    while len(data) < size:
        part = os.read(source, size - len(data))
        if not part:
            return b""
        data += part
    return data


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except HardwareError as failure:
        sys.exit(f"slipmap: {failure}")
