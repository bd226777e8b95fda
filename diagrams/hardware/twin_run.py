"""Runs the twin of a cell in real time until it is stopped."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, EventStatus

from diagrams.hardware import channels, network
from diagrams.hardware.child import have_priority
from diagrams.hardware.twin import CellTwin
from diagrams.hardware.twin_camera import TwinCamera
from diagrams.station.scenario import Scenario
from diagrams.station.station import take_fixed_steps

LATE = 0.1
"""s by which the twin may be late before it gives up catching up: an arm that hurries would be no twin."""

REPORT_EVERY = 10.0
"""s between two reports."""


@dataclass(frozen=True)
class TwinReport:
    """How the twin fares.

    Attributes:
        simulated: s of simulated time.
        behind: s by which it is behind real time since it began.
        pace: simulated over real time, since the report before.
        commands: of the arm that came and were good, since the report before.
        dropped: messages that were not used until now, by channel and cause.
    """

    simulated: float
    behind: float
    pace: float
    commands: int
    dropped: Mapping[str, Mapping[str, int]]


def run_twin(
    scenario: Scenario,
    url: str,
    report: Callable[[TwinReport], None] = lambda report: None,
    *,
    until: float = float("inf"),
) -> TwinReport:
    """Run the twin until Ctrl-C, or for some time, and say how it fared.

    It is for a process of its own, which has real-time priority from here on where the system allows it: a
    cell does not wait for what drives it.

    Args:
        scenario: what the cell is like.
        url: see `network.open_lcm`.
        report: called when it begins, and every `REPORT_EVERY`.
        until: simulated time at which it ends, s.

    Raises:
        HardwareError: see `network.open_lcm`.
        ValueError, RendererUnavailable: as `Station`.
    """
    lcm = network.open_lcm(url)
    twin = CellTwin(scenario, lcm, camera=False)
    camera = TwinCamera(scenario, url)
    have_priority()
    try:
        return _run(twin, camera, 1.0 / scenario.camera.rate, report, until)
    finally:
        camera.close()


def _run(
    twin: CellTwin, camera: TwinCamera, period: float, report: Callable[[TwinReport], None], until: float
) -> TwinReport:
    simulator = Simulator(twin)
    take_fixed_steps(simulator)
    simulator.set_target_realtime_rate(1.0)
    simulator.Initialize()
    root = simulator.get_mutable_context()
    plant = twin.station.plant
    state = plant.GetMyContextFromRoot(root)
    started = time.monotonic()
    pictures = 0
    last = TwinReport(0.0, 0.0, 1.0, 0, {})
    spoke, good, given_up = started, 0, 0.0

    def reported(now: float) -> TwinReport:
        received = twin.received(root)
        simulated = root.get_time()
        return TwinReport(
            simulated,
            max(now - started - simulated, 0.0),
            (simulated - last.simulated) / max(now - spoke, 1e-9),
            received[channels.IIWA_COMMAND].good - good,
            {channel: came.dropped for channel, came in received.items() if came.dropped},
        )

    def monitor(context: Context) -> EventStatus:
        nonlocal pictures, last, spoke, good, given_up
        simulated = context.get_time()
        twin.station.after_step(root)
        if simulated >= pictures * period - 1e-9:
            pictures += 1
            camera.take(simulated, plant.GetPositions(state))
        now = time.monotonic()
        if now - started - simulated - given_up > LATE:
            given_up = now - started - simulated
            simulator.ResetStatistics()  # it measures real time from here on
        if now - spoke > REPORT_EVERY:
            last = reported(now)
            spoke, good = now, twin.received(root)[channels.IIWA_COMMAND].good
            report(last)
        return EventStatus.DidNothing()

    simulator.set_monitor(monitor)
    report(last)
    with suppress(KeyboardInterrupt):
        simulator.AdvanceTo(until)
    return reported(time.monotonic())
