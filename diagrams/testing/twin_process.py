"""A twin of a cell in a process of its own, for as long as a test needs it."""

import os
import signal
import socket
import sys
import threading
from pathlib import Path

from pydrake.common.yaml import yaml_dump_typed

from slipmap.diagrams.hardware.child import Child, be_ready
from slipmap.diagrams.hardware.network import HardwareError
from slipmap.diagrams.station.scenario import Scenario


class TwinProcess(Child):
    """The process; `close` ends it. It says on the standard error whether it keeps up with real time.

    Args:
        folder: in which the scenario is left for it.
    """

    def __init__(self, scenario: Scenario, folder: Path) -> None:
        self.url = free_url()
        path = folder / "cell.yaml"
        path.write_text(yaml_dump_typed(scenario), encoding="utf-8")
        super().__init__("the twin", _run, self.url, str(path))


def free_url() -> str:
    """An LCM address that nobody uses, whose messages stay on this computer."""
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
