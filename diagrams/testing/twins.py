"""Twins for tests: in a separate process, and on the clock of the diagram that drives it.

The latter has all messages and checks, but does not run in real time.
"""

import os
import signal
import socket
import sys
import threading
from array import array
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pydrake.common.yaml import yaml_dump_typed
from pydrake.lcm import DrakeLcm
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus

from slipmap.diagrams.hardware import network
from slipmap.diagrams.hardware.child import Child, be_ready
from slipmap.diagrams.hardware.interface import PATIENCE, HardwareInterface, export_outputs
from slipmap.diagrams.hardware.network import HardwareError
from slipmap.diagrams.hardware.twin import CellTwin
from slipmap.diagrams.station.scenario import Scenario
from slipmap.diagrams.systems.python_system import PythonDiagram, PythonSystem, weakly
from slipmap.diagrams.testing.assertions import CommandLog, row_of
from slipmap.diagrams.testing.faults import Fault, Relay
from slipmap.models.physics.cell_grid import FloatArray


class LockstepCell(PythonDiagram):
    """`HardwareInterface`, a relay, and the twin behind it, which step together.

    It replaces `HardwareInterface` and has its ports and methods. Messages go through memory. The simulation
    need not keep up with real time, so its result does not depend on how busy the computer is. It lacks only
    what real time brings: late messages on a busy computer, and processes that end.

    Args:
        positions: initial ones of the plant; those of the scenario if None.

    Raises:
        ValueError, RendererUnavailable: as for `Station`.
    """

    realtime_rate = 0.0

    def __init__(self, scenario: Scenario, positions: FloatArray | None = None) -> None:
        super().__init__()
        cell, driver = DrakeLcm("memq://"), DrakeLcm("memq://")
        self._positions = positions
        self._root: Context | None = None
        self._commands = array("d")
        driver.Subscribe(network.IIWA_COMMAND, weakly(self._write_down))
        builder = DiagramBuilder()
        self.twin: CellTwin = builder.AddSystem(CellTwin(scenario, cell))
        self._clock = builder.AddSystem(_Clock())
        self._relay = Relay(cell, driver, lambda: self._clock.now)
        self._clock.tick = self._after_step
        self._interface: HardwareInterface = builder.AddSystem(HardwareInterface(driver, scenario))
        self._lcm = cell
        self.arm_hulls = self._interface.arm_hulls
        for index in range(self._interface.num_input_ports()):
            port = self._interface.get_input_port(index)
            builder.ExportInput(port, port.get_name())
        export_outputs(builder, self._interface)
        builder.BuildInto(self)
        self.set_name("station")

    def connect(self, root: Context, patience: float = PATIENCE) -> None:
        """See `HardwareInterface.connect`; the twin sends its first messages now."""
        self._root = root
        if self._positions is not None:
            plant = self.twin.station.plant
            plant.SetPositions(plant.GetMyMutableContextFromRoot(root), self._positions)
        self.twin.ForcedPublish(self.twin.GetMyContextFromRoot(root))
        self._lcm.HandleSubscriptions(0)
        self._interface.connect(root, patience)

    def close(self) -> None:
        """See `HardwareInterface.close`; the cell can no longer be driven."""
        self._interface.close()
        if self._root is not None:
            self._positions = self._now()
            self._root = None

    def abort(self) -> None:
        """See `HardwareInterface.abort`."""
        self._interface.abort()

    def order(self, fault: Fault) -> None:
        """Start a fault."""
        self._relay.order(fault)

    @property
    def begun(self) -> list[Fault]:
        """Faults that have spoilt a message."""
        return self._relay.begun

    def log(self) -> CommandLog:
        """All commands so far."""
        return CommandLog.of(np.array(self._commands))

    @property
    def now(self) -> float:
        """Simulated time, s."""
        return self._clock.now

    @property
    def positions(self) -> FloatArray | None:
        """Positions of the twin's plant, from which another can continue; None before `connect`."""
        return self._positions if self._root is None else self._now()

    def _write_down(self, command: bytes) -> None:
        self._commands.extend(row_of(command))

    def _after_step(self) -> None:
        self._relay.flush()
        if self._root is not None:
            self.twin.station.after_step(self._root)

    def _now(self) -> FloatArray:
        plant = self.twin.station.plant
        return np.array(plant.GetPositions(plant.GetMyContextFromRoot(self._root)))


class _Clock(PythonSystem):
    """Exposes the diagram's time outside the diagram."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.tick: Callable[[], None] = lambda: None
        self.DeclarePerStepPublishEvent(self._tell)

    def _tell(self, context: Context) -> EventStatus:
        self.now = context.get_time()
        self.tick()
        return EventStatus.Succeeded()


class TwinProcess(Child):
    """The twin's process; `close` ends it. It reports on standard error whether it keeps up with real time.

    Args:
        folder: in which the scenario is stored for it.
    """

    def __init__(self, scenario: Scenario, folder: Path) -> None:
        self.url = free_url()
        path = folder / "cell.yaml"
        path.write_text(yaml_dump_typed(scenario), encoding="utf-8")
        super().__init__("the twin", _run, self.url, str(path))


def free_url() -> str:
    """An unused LCM address whose messages stay on this computer."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return f"udpm://239.255.76.67:{probe.getsockname()[1]}?ttl=0"


def _run(url: str, path: str) -> None:
    from slipmap.diagrams.hardware.twin import TwinReport, report_words, run_twin
    from slipmap.diagrams.perception.renderer import RendererUnavailable
    from slipmap.diagrams.station.scenario import read_settings

    def report(now: TwinReport) -> None:
        if now.simulated == 0.0:
            be_ready()
        print(report_words(now), file=sys.stderr, flush=True)

    def end_with_input() -> None:
        while os.read(sys.stdin.fileno(), 1):
            pass
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=end_with_input, daemon=True).start()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        run_twin(read_settings(path, Scenario), url, report)
    except (RendererUnavailable, ValueError) as failure:
        raise HardwareError(str(failure)) from failure
