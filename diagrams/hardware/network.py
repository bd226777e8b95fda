"""The LCM network between the two sides of a cell: address, channels, rates, and connections.

Drake is imported with the first connection, so that help texts, which name the address, load quickly.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from slipmap.models.files import BadInput

if TYPE_CHECKING:
    from pydrake.lcm import DrakeLcm

LCM_URL = "udpm://239.255.76.67:7667?ttl=0"  # LCM's default address; with ttl=0 nothing leaves this computer
IIWA_STATUS, IIWA_COMMAND = "IIWA_STATUS", "IIWA_COMMAND"
GRIPPER_STATUS, GRIPPER_COMMAND = "SCHUNK_WSG_STATUS", "SCHUNK_WSG_COMMAND"
CAMERA_DEPTH, CAMERA_COLOR, CAMERA_POSE = "CAMERA_DEPTH", "CAMERA_COLOR", "CAMERA_POSE"
ABORT = "ABORT"

ARM = (IIWA_STATUS, GRIPPER_STATUS)
CAMERA = (CAMERA_DEPTH, CAMERA_POSE, CAMERA_COLOR)
NEEDED = (*ARM, CAMERA_DEPTH, CAMERA_POSE)  # required channels
ARM_PERIOD = 0.005  # s between two messages of the arm, in both directions
GRIPPER_PERIOD = 0.05  # s between two messages of the gripper, in both directions
COLOR_PERIOD = 1.0  # s between two colour pictures, which only people look at
LOOK_EVERY = 1e-3  # s between two checks for new messages
_ADDRESS = re.compile(r"udpm://\d{1,3}(\.\d{1,3}){3}:\d{1,5}(\?(?P<options>[\w=&.]*))?")
_BUFFER = 4_194_304  # bytes of the socket's buffer; a picture comes in several packets at once


class HardwareError(BadInput, RuntimeError):
    """The cell cannot be reached or does not answer. The text says what to do."""


def address_settings(url: str) -> dict[str, str]:
    """The options after the ? of an address.

    Raises:
        HardwareError: a malformed address, or one that is not multicast.
    """
    match = _ADDRESS.fullmatch(url)
    if match is None:
        raise HardwareError(f"--lcm: the address must look like {LCM_URL}, got {url}")
    options = match["options"] or ""
    settings = dict(part.partition("=")[::2] for part in options.split("&") if part)
    unknown = settings.keys() - {"ttl", "recv_buf_size"}
    if unknown or not all(value.isdigit() for value in settings.values()):
        raise HardwareError(
            "--lcm: the only options after the ? of an address are ttl=N and recv_buf_size=N, whole numbers"
            f" joined by &; got {url}"
        )
    group = int(url.removeprefix("udpm://").partition(".")[0])
    if not 224 <= group <= 239:
        raise HardwareError(f"--lcm: the address must be multicast, 224.0.0.0 to 239.255.255.255, got {url}")
    return settings


def place_of(url: str) -> str:
    """Group and port of an address, `GROUP:PORT`: the same for all addresses whose messages meet.

    Raises:
        HardwareError: as for `address_settings`.
    """
    address_settings(url)
    group, _, port = url.removeprefix("udpm://").partition("?")[0].partition(":")
    return f"{'.'.join(str(int(part)) for part in group.split('.'))}:{int(port)}"


def open_lcm(url: str = LCM_URL, *, listens: bool = True) -> DrakeLcm:
    """Open a connection to an address.

    Args:
        listens: whether to receive messages as well as send them; if so, the network is tested.
        url: `udpm://GROUP:PORT`, with `?ttl=N` for N > 0 if messages should leave this computer, or `memq://`
            for one that exists only in this object.

    Raises:
        HardwareError: a malformed address, or a network that does not carry messages.
    """
    from pydrake.lcm import DrakeLcm

    if url == "memq://":
        return DrakeLcm(url)
    settings = {"ttl": "0", "recv_buf_size": str(_BUFFER), **address_settings(url)}
    address = url.partition("?")[0]
    lcm = DrakeLcm(f"{address}?{'&'.join('='.join(item) for item in settings.items())}")
    if not listens:
        return lcm
    try:
        lcm.HandleSubscriptions(0)
    except RuntimeError as error:
        raise HardwareError(
            f"--lcm: nothing can be sent to {url} ({error}). Without a network, let multicast stay on this"
            " computer: `sudo ip link set lo multicast on; sudo ip route add 224.0.0.0/4 dev lo`"
        ) from error
    return lcm


class Listener:
    """A thread that receives messages as they come.

    LCM keeps only one message per channel, the oldest, until it is read: a diagram that was busy would see an
    outdated state.

    Args:
        url: see `open_lcm`.
        hear: function to call with the messages of each channel.

    Raises:
        HardwareError: see `open_lcm`.
    """

    def __init__(self, url: str, hear: Mapping[str, Callable[[bytes], None]]) -> None:
        self._lcm = open_lcm(url)
        for channel, function in hear.items():
            self._lcm.Subscribe(channel, function)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._ends.set()
        self._thread.join()

    def _listen(self) -> None:
        while not self._ends.is_set():
            # Waiting inside LCM would block all other threads, too.
            if not self._lcm.HandleSubscriptions(0):
                time.sleep(LOOK_EVERY)
