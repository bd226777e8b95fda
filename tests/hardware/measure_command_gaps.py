"""Measures the gaps between commands to the arm while an identification runs: no test, takes a minute or two.

    python tests/hardware/measure_command_gaps.py [--seconds 10] [--inside | --diagnosis]

The diagram has a `HardwareInterface`, before a twin in another process, and an `Identification` that learns
again and again, or with --diagnosis a `Diagnosis` that looks for a missing effect. With --inside the diagram
itself learns, which then stands still; else a worker does. Gaps are those of the stamps that the commands
bear, the sender's clock when it sent them. They are read from the socket itself, since LCM drops messages
where the reader is late.
"""

from __future__ import annotations

import argparse
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np
from drake import lcmt_iiwa_command
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource

from slipmap.diagrams.application.demonstration import simulated_hammer
from slipmap.diagrams.hardware.interface import HardwareInterface
from slipmap.diagrams.hardware.network import ARM_PERIOD, IIWA_COMMAND
from slipmap.diagrams.station.arm import HOME
from slipmap.diagrams.station.scenario import Scenario
from slipmap.diagrams.systems.diagnosis import Diagnosis
from slipmap.diagrams.systems.identification import Identification
from slipmap.diagrams.systems.model_monitor import Judged, Watch
from slipmap.diagrams.systems.workers import workers
from slipmap.models.measurements import PushDataset, Trial
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.planners.settings import RepairSettings

GROUP, PORT = "239.255.76.67", 7790
URL = f"udpm://{GROUP}:{PORT}?ttl=0"


class Ear:
    """Hears the stamps (s) of all commands."""

    def __init__(self) -> None:
        self.stamps: list[float] = []
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self._socket.bind((GROUP, PORT))
        member = struct.pack("4sl", socket.inet_aton(GROUP), socket.INADDR_ANY)
        self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        begin = IIWA_COMMAND.encode() + b"\0"
        while True:
            packet = self._socket.recv(1 << 16)
            # Of a short message: magic number, count, channel, then what was encoded.
            if packet[:4] == b"LC02" and packet[8:].startswith(begin):
                command = lcmt_iiwa_command.decode(packet[8 + len(begin) :])
                self.stamps.append(1e-6 * command.utime)


@dataclass(frozen=True)
class Given:
    """A `make_dataset` that a worker can receive."""

    dataset: PushDataset

    def __call__(self, trials: Sequence[Trial], grid: CellGrid) -> PushDataset:
        return replace(self.dataset, trials=tuple(trials))


def measured(seconds: float, inside: bool, diagnosis: bool) -> tuple[np.ndarray, float, int]:
    """Stamps of commands, s; the longest standstill of the diagram, s; how often it learned."""
    ear = Ear()
    dataset, _ = simulated_hammer(fit=12, heldout=0)
    trials = dataset.fit_trials
    with nullcontext(None) if inside else workers() as worker:
        builder = DiagramBuilder()
        cell = builder.AddSystem(HardwareInterface(URL, Scenario()))
        if diagnosis:
            # Pushes that surprise are diagnosed, each time all of them.
            learning = builder.AddSystem(
                Diagnosis(Given(dataset), RepairSettings(), pushes=12, worker=worker)
            )
            builder.ExportInput(learning.GetInputPort("watch"), "watch")
        else:
            learning = builder.AddSystem(
                Identification(Given(dataset), hypotheses=100, friction_laws=False, worker=worker)
            )
        for port, value in (
            ("iiwa.position", HOME),
            ("gripper.position", [0.0]),
            ("gripper.force_limit", [40.0]),
        ):
            source = builder.AddSystem(ConstantVectorSource(np.asarray(value)))
            builder.Connect(source.get_output_port(), cell.GetInputPort(port))
        grid = builder.AddSystem(ConstantValueSource(Value[object](dataset.grid)))
        builder.Connect(grid.get_output_port(), learning.GetInputPort("cell_grid"))
        builder.ExportInput(learning.GetInputPort("trials"), "trials")
        builder.ExportOutput(learning.GetOutputPort("repair" if diagnosis else "learned"), "learned")
        diagram = builder.Build()
        simulator = Simulator(diagram)
        simulator.set_target_realtime_rate(1.0)
        context = simulator.get_mutable_context()

        def give(count: int) -> None:
            diagram.GetInputPort("trials").FixValue(context, Value[object](trials[:count]))
            if diagnosis:
                surprise = Judged(count - 1, 9.0, 0.0, 100.0, True, 0.02, 0.005, True)
                watch = Watch(count, np.zeros(3), (surprise,))
                diagram.GetInputPort("watch").FixValue(context, Value[object](watch))

        def learned() -> int:
            done = diagram.GetOutputPort("learned").Eval(context)
            return done.trials if diagnosis else done

        give(0)
        cell.connect(context)
        ear.stamps.clear()
        standstill, last = 0.0, time.monotonic()

        def watch(root) -> None:
            nonlocal standstill, last
            now = time.monotonic()
            standstill, last = max(standstill, now - last), now

        simulator.set_monitor(watch)
        simulator.AdvanceTo(0.2)
        begin = time.monotonic()
        times = 0
        for count in range(RepairSettings().fewest if diagnosis else 1, len(trials) + 1):
            if time.monotonic() - begin > seconds:
                break
            give(count)
            while learned() < count:
                simulator.AdvanceTo(context.get_time() + 0.1)
            times += 1
        cell.close()
    return np.array(ear.stamps), standstill, times


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--seconds", type=float, default=10.0)
    how = arguments.add_mutually_exclusive_group()
    how.add_argument("--inside", action="store_true")
    how.add_argument("--diagnosis", action="store_true")
    chosen = arguments.parse_args()
    twin = subprocess.Popen([sys.executable, "-m", "slipmap", "station", "--lcm", URL])
    try:
        time.sleep(5.0)
        stamps, standstill, count = measured(chosen.seconds, chosen.inside, chosen.diagnosis)
    finally:
        twin.send_signal(signal.SIGINT)
        twin.wait()
    gaps = 1e3 * np.diff(stamps)
    quantiles = ", ".join(f"{100 * q:g} %: {np.quantile(gaps, q):.2f} ms" for q in (0.5, 0.99, 0.999))
    did = "diagnosed" if chosen.diagnosis else "learned"
    print(
        f"{len(gaps)} gaps over {stamps[-1] - stamps[0]:.1f} s, asked {1e3 * ARM_PERIOD:g} ms; {quantiles};"
        f" largest {gaps.max():.2f} ms. Meanwhile it {did} {count} times, and the diagram stood still for"
        f" {1e3 * standstill:.0f} ms at most."
    )


if __name__ == "__main__":
    main()
