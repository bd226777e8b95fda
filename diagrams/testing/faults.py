"""Faults in the messages between a cell and its driver, and the relay that injects them."""

import json
import os
import select
import sys
import time
import zlib
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
from drake import lcmt_iiwa_status, lcmt_image, lcmt_image_array
from numpy.typing import NDArray
from pydrake.lcm import DrakeLcmInterface

from slipmap.diagrams.hardware import network
from slipmap.diagrams.hardware.child import Child, be_ready
from slipmap.diagrams.systems.python_system import weakly

_Rows = NDArray[np.float32]

KINDS: dict[str, tuple[str, ...]] = {
    "status": ("stop", "delay", "repeat", "jump", "back"),
    "pictures": ("stop", "delay", "freeze", "zeros", "nans", "rubbish", "torn"),
    "arm": ("refuse",),
    "gripper": ("stuck",),
}
"""Kinds of faults, by the part that they affect."""

_FROM_CELL = (
    network.IIWA_STATUS, network.GRIPPER_STATUS,
    network.CAMERA_DEPTH, network.CAMERA_COLOR, network.CAMERA_POSE, network.ABORT,
)  # fmt: skip
_TO_CELL = (network.IIWA_COMMAND, network.GRIPPER_COMMAND)

_CHANNEL = {
    "status": network.IIWA_STATUS,
    "pictures": network.CAMERA_DEPTH,
    "arm": network.IIWA_COMMAND,
    "gripper": network.GRIPPER_COMMAND,
}
_STATUSES_KEPT = 400  # for repeating them backwards


@dataclass(frozen=True)
class Fault:
    """One fault in the messages of a channel.

    | of | kind | what happens |
    | --- | --- | --- |
    | `status` | `stop` | the arm's status stops coming |
    | | `delay` | it comes `amount` seconds late |
    | | `repeat` | the present one is repeated with new stamps |
    | | `jump` | measured angles are `amount` rad too large |
    | | `back` | earlier ones are repeated backwards, with their old stamps |
    | `pictures` | `stop`, `delay` | as above, for depth pictures |
    | | `freeze` | the present picture is repeated with new stamps |
    | | `zeros`, `nans`, `rubbish` | the rows of `band` have no reading, NaN, or random bits |
    | | `torn` | the rows of `band` are those of the previous picture |
    | `arm` | `refuse` | the arm gets no commands |
    | `gripper` | `stuck` | the gripper gets no commands and stays as it is |

    Attributes:
        of, kind: see the table.
        amount: s or rad, where the table mentions it.
        seconds: duration.
        after: s from the order to the start.
        band: first and last share of a picture's rows.

    Raises:
        ValueError: an unknown fault, an invalid number, or a delay or jump without its amount.
    """

    of: str
    kind: str
    amount: float = 0.0
    seconds: float = np.inf
    after: float = 0.0
    band: tuple[float, float] = (0.0, 1.0)

    def __post_init__(self) -> None:
        if self.of not in KINDS:
            raise ValueError(f"fault: `of` must be one of {', '.join(KINDS)}, got {self.of!r}")
        if self.kind not in KINDS[self.of]:
            raise ValueError(
                f"fault: `kind` for {self.of} must be one of {', '.join(KINDS[self.of])}, got {self.kind!r}"
            )
        if not (np.isfinite(self.amount) and self.seconds >= 0 and 0 <= self.after < np.inf):
            raise ValueError(f"{self}: amount must be finite, seconds and after must not be negative")
        if self.kind in ("delay", "jump") and self.amount == 0:
            unit = "s" if self.kind == "delay" else "rad"
            raise ValueError(f"{self}: changes nothing; give its amount in {unit}")
        if self.kind == "delay" and self.amount < 0:
            raise ValueError(f"{self}: a message cannot come before it was sent; amount is negative")
        if not 0.0 <= self.band[0] < self.band[1] <= 1.0:
            raise ValueError(f"{self}: band must be an interval within 0 to 1")

    @property
    def channel(self) -> str:
        """The channel whose messages it affects."""
        return _CHANNEL[self.of]

    def __str__(self) -> str:
        amount = f" {self.amount:g}" if self.amount else ""
        lasts = f" for {self.seconds:.2g} s" if np.isfinite(self.seconds) else ""
        return f"{self.of} {self.kind}{amount}{lasts}"


class Link:
    """The path of one channel's messages, with at most one fault at a time.

    Times are of one monotonic clock, s.
    """

    def __init__(self, channel: str) -> None:
        self._fault: Fault | None = None
        self._begin = np.inf
        self.begun: list[Fault] = []  # faults that have spoilt a message, in order
        self._spoils = False  # whether the present one has
        self._sent: deque[bytes] = deque(
            # Pictures are large, so only the last one can be repeated.
            maxlen=_STATUSES_KEPT if channel == network.IIWA_STATUS else 1
        )
        self._frozen: bytes | None = None
        self._late: deque[tuple[float, bytes]] = deque()

    def order(self, fault: Fault, now: float) -> None:
        """Start a fault in `fault.after` seconds, in place of any earlier one."""
        self._fault, self._begin, self._frozen, self._spoils = fault, now + fault.after, None, False

    def faulty(self, now: float) -> bool:
        """Whether a fault is active now."""
        return self._fault is not None and 0.0 <= now - self._begin < self._fault.seconds

    def through(self, data: bytes, now: float) -> bytes | None:
        """The message that comes out at once when one goes in; None if nothing does."""
        if self.faulty(now):
            assert self._fault is not None
            if not self._spoils:
                self._spoils = True
                self.begun.append(self._fault)
            return self._spoilt(self._fault, data, now)
        self._sent.append(data)
        return data

    def due(self, now: float) -> list[bytes]:
        """Delayed messages that are due."""
        come = []
        while self._late and self._late[0][0] <= now:
            come.append(self._late.popleft()[1])
        return come

    def _spoilt(self, fault: Fault, data: bytes, now: float) -> bytes | None:
        if fault.kind in ("stop", "refuse", "stuck"):
            return None
        if fault.kind == "delay":
            self._late.append((now + fault.amount, data))
            return None
        if fault.kind == "back":
            return self._sent.pop() if self._sent else None
        if fault.kind in ("repeat", "freeze"):
            self._frozen = self._frozen or (self._sent[-1] if self._sent else data)
            return _stamped_like(self._frozen, data, fault.of)
        if fault.kind == "jump":
            status = lcmt_iiwa_status.decode(data)
            status.joint_position_measured = [q + fault.amount for q in status.joint_position_measured]
            return bytes(status.encode())
        before = self._sent[-1] if self._sent else data
        self._sent.append(data)
        return _spoilt_picture(fault, data, before, round(1e3 * now))


class Relay:
    """Two connections and the links between them.

    Args:
        cell: connection to the cell.
        driver: connection to its driver.
        clock: gives the time, s; monotonic.
    """

    def __init__(
        self, cell: DrakeLcmInterface, driver: DrakeLcmInterface, clock: Callable[[], float]
    ) -> None:
        self._clock = clock
        self._links: dict[str, tuple[Link, DrakeLcmInterface]] = {}
        for heard, other, names in ((cell, driver, _FROM_CELL), (driver, cell, _TO_CELL)):
            for channel in names:
                self._links[channel] = (Link(channel), other)
                heard.Subscribe(channel, partial(weakly(self._pass), channel))

    def order(self, fault: Fault) -> None:
        """Start a fault."""
        self._links[fault.channel][0].order(fault, self._clock())

    @property
    def begun(self) -> list[Fault]:
        """Faults that have spoilt a message."""
        return [fault for link, _ in self._links.values() for fault in link.begun]

    def flush(self) -> None:
        """Pass on delayed messages that are due; call it often."""
        for channel, (link, other) in self._links.items():
            for data in link.due(self._clock()):
                other.Publish(channel, data)

    def _pass(self, channel: str, data: bytes) -> None:
        link, other = self._links[channel]
        come = link.through(data, self._clock())
        if come is not None:
            other.Publish(channel, come)


class RelayProcess(Child):
    """The relay in a separate process; after `close` no message passes any more.

    Args:
        cell_url, driver_url: LCM addresses, see `network.open_lcm`.
    """

    def __init__(self, cell_url: str, driver_url: str) -> None:
        super().__init__("the relay between cell and test", _relay, cell_url, driver_url)

    def order(self, fault: Fault) -> None:
        """Start a fault."""
        self.write(json.dumps(asdict(fault)).encode() + b"\n")

    @property
    def begun(self) -> list[Fault]:
        """Faults that have spoilt a message.

        Raises:
            HardwareError: the process has ended.
        """
        self.write(b"\n")
        answer = self.output.readline()
        if not answer:
            raise network.HardwareError("the relay between cell and test has ended; start again")
        return [_fault_of(fault) for fault in json.loads(answer)]


def _relay(cell_url: str, driver_url: str) -> None:
    """Pass messages on, and take faults from standard input until it ends; an empty line asks which ones have
    begun."""
    cell, driver = network.open_lcm(cell_url), network.open_lcm(driver_url)
    relay = Relay(cell, driver, time.monotonic)
    source, said = sys.stdin.fileno(), b""
    be_ready()
    while True:
        if select.select([source], [], [], network.LOOK_EVERY)[0]:
            data = os.read(source, 1 << 16)
            if not data:
                return
            *lines, said = (said + data).split(b"\n")
            for line in lines:
                if line:
                    relay.order(_fault_of(json.loads(line)))
                else:
                    begun = json.dumps([asdict(fault) for fault in relay.begun])
                    os.write(sys.stdout.fileno(), begun.encode() + b"\n")
        cell.HandleSubscriptions(0)
        driver.HandleSubscriptions(0)
        relay.flush()


def _fault_of(stored: dict[str, Any]) -> Fault:
    return Fault(**{**stored, "band": tuple(stored["band"])})


def _stamped_like(old: bytes, new: bytes, of: str) -> bytes:
    if of == "status":
        status = lcmt_iiwa_status.decode(old)
        status.utime = lcmt_iiwa_status.decode(new).utime
        return bytes(status.encode())
    array = lcmt_image_array.decode(old)
    array.header.utime = lcmt_image_array.decode(new).header.utime
    return bytes(array.encode())


def _spoilt_picture(fault: Fault, data: bytes, before: bytes, seed: int) -> bytes:
    array = lcmt_image_array.decode(data)
    image = array.images[0]
    rows = _rows(image)
    spoilt = spoilt_rows(fault.kind, rows, _rows(lcmt_image_array.decode(before).images[0]), fault.band, seed)
    image.data = zlib.compress(np.ascontiguousarray(spoilt, "<f4").tobytes(), 1)
    image.size, image.compression_method = len(image.data), lcmt_image.COMPRESSION_METHOD_ZLIB
    return bytes(array.encode())


def _rows(image: Any) -> _Rows:
    packed = image.compression_method == lcmt_image.COMPRESSION_METHOD_ZLIB
    pixels = zlib.decompress(image.data) if packed else bytes(image.data)
    return np.frombuffer(pixels, "<f4").reshape(image.height, image.width)


def spoilt_rows(kind: str, rows: _Rows, before: _Rows, band: tuple[float, float], seed: int) -> _Rows:
    """A depth picture with some wrong rows.

    Args:
        kind: `zeros`, `nans`, `rubbish` or `torn`.
        rows: (h, w) the picture, m.
        before: (h, w) the previous picture.
        band: first and last share of the rows.
        seed: of the random bits of `rubbish`.
    """
    come = np.array(rows, np.float32)
    first, last = (round(share * len(rows)) for share in band)
    if kind == "torn":
        come[first:last] = before[first:last]
    elif kind == "rubbish":
        bits = np.random.default_rng(seed).integers(0, 2**32, come[first:last].shape, np.uint32)
        come[first:last] = bits.view(np.float32)
    else:
        come[first:last] = {"zeros": 0.0, "nans": np.nan}[kind]
    return come
