"""Passes messages between a cell and what drives it, and lets faults happen on the way.

As a process it is started as `python -m slipmap.diagrams.testing.relay CELL_URL DRIVER_URL`, and is told
faults on its standard input until that ends.
"""

from __future__ import annotations

import json
import os
import select
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial

from pydrake.lcm import DrakeLcmInterface

from slipmap.diagrams.hardware.channels import HardwareError
from slipmap.diagrams.hardware.child import Child, be_ready
from slipmap.diagrams.hardware.network import open_lcm
from slipmap.diagrams.systems.python_system import weakly
from slipmap.diagrams.testing.faults import FROM_CELL, TO_CELL, Fault, Link

_LOOK_EVERY = 1e-3  # s


class Relay:
    """Two connections and the links between them.

    Args:
        cell: where the cell is.
        driver: where what drives it is.
        clock: tells the time, s; it does not go back.
    """

    def __init__(
        self, cell: DrakeLcmInterface, driver: DrakeLcmInterface, clock: Callable[[], float]
    ) -> None:
        self._clock = clock
        self._links: dict[str, tuple[Link, DrakeLcmInterface]] = {}
        for heard, other, names in ((cell, driver, FROM_CELL), (driver, cell, TO_CELL)):
            for channel in names:
                self._links[channel] = (Link(channel), other)
                heard.Subscribe(channel, partial(weakly(self._pass), channel))

    def order(self, fault: Fault) -> None:
        """Let a fault begin."""
        self._links[fault.channel][0].order(fault, self._clock())

    def flush(self) -> None:
        """Pass on the late messages whose time has come; to be called often."""
        for channel, (link, other) in self._links.items():
            for data in link.due(self._clock()):
                other.Publish(channel, data)

    def _pass(self, channel: str, data: bytes) -> None:
        link, other = self._links[channel]
        come = link.through(data, self._clock())
        if come is not None:
            other.Publish(channel, come)


class RelayProcess:
    """The relay in a process of its own; `close` ends it.

    Args:
        cell_url, driver_url: LCM addresses, see `network.open_lcm`.

    Raises:
        HardwareError: it could not be started.
    """

    def __init__(self, cell_url: str, driver_url: str) -> None:
        self._child = Child("the relay between cell and test", __name__, cell_url, driver_url)
        self._child.wait_until_ready()

    def order(self, fault: Fault) -> None:
        """Let a fault begin.

        Raises:
            HardwareError: the process has ended.
        """
        self._child.send(json.dumps(asdict(fault)).encode() + b"\n")

    def close(self) -> None:
        """End the process; no message passes any more."""
        self._child.close()


def main(cell_url: str, driver_url: str) -> None:
    """Pass messages until the standard input ends."""
    cell, driver = open_lcm(cell_url), open_lcm(driver_url)
    relay = Relay(cell, driver, time.monotonic)
    source, said = sys.stdin.fileno(), b""
    be_ready()
    while True:
        if select.select([source], [], [], _LOOK_EVERY)[0]:
            data = os.read(source, 1 << 16)
            if not data:
                return
            *lines, said = (said + data).split(b"\n")
            for line in lines:
                told = json.loads(line)
                relay.order(Fault(**{**told, "band": tuple(told["band"])}))
        cell.HandleSubscriptions(0)
        driver.HandleSubscriptions(0)
        relay.flush()


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except HardwareError as failure:
        sys.exit(f"slipmap: {failure}")
