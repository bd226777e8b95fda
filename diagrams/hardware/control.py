"""Being the one who controls a real cell."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from diagrams.hardware.interface import HardwareInterface
from diagrams.hardware.lock import only_controller
from diagrams.station.scenario import Scenario
from diagrams.systems.workers import workers


@contextmanager
def real_cell(
    scenario: Scenario, url: str | None
) -> Iterator[tuple[HardwareInterface | None, Executor | None]]:
    """The cell behind an LCM address and workers, until the block ends; none of them where there is no URL.

    At the end the arm comes to rest.

    Args:
        scenario: what the cell is like.
        url: see `network.open_lcm`; the station is simulated if None, and waits for what takes long.

    Raises:
        HardwareError: a malformed address, or no network.
        BadInput: somebody else controls the cell.
    """
    if url is None:
        yield None, None
        return
    with only_controller(url), workers() as worker:
        cell = HardwareInterface(url, scenario)
        try:
            yield cell, worker
        finally:
            cell.close()
