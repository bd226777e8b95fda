"""Passes messages between a cell and what drives it, and lets faults happen on the way."""

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

from slipmap.diagrams.hardware.child import Child, be_ready
from slipmap.diagrams.hardware.network import LOOK_EVERY, open_lcm
from slipmap.diagrams.systems.python_system import weakly
from slipmap.diagrams.testing.faults import FROM_CELL, TO_CELL, Fault, Link


class Relay:
    """Two connections and the links between them.

    Args:
        cell: where the cell is.
        driver: where what drives it is.
        clock: gives the time, s; it does not go back.
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


class RelayProcess(Child):
    """The relay in a process of its own; once `close` ended it, no message passes any more.

    Args:
        cell_url, driver_url: LCM addresses, see `network.open_lcm`.
    """

    def __init__(self, cell_url: str, driver_url: str) -> None:
        super().__init__("the relay between cell and test", _relay, cell_url, driver_url)

    def order(self, fault: Fault) -> None:
        """Let a fault begin."""
        self.write(json.dumps(asdict(fault)).encode() + b"\n")


def _relay(cell_url: str, driver_url: str) -> None:
    """Pass messages, and take faults from the standard input until that ends."""
    cell, driver = open_lcm(cell_url), open_lcm(driver_url)
    relay = Relay(cell, driver, time.monotonic)
    source, said = sys.stdin.fileno(), b""
    be_ready()
    while True:
        if select.select([source], [], [], LOOK_EVERY)[0]:
            data = os.read(source, 1 << 16)
            if not data:
                return
            *lines, said = (said + data).split(b"\n")
            for line in lines:
                fault = json.loads(line)
                relay.order(Fault(**{**fault, "band": tuple(fault["band"])}))
        cell.HandleSubscriptions(0)
        driver.HandleSubscriptions(0)
        relay.flush()
