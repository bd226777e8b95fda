"""A process beside this one that is fed through a pipe, and ends when the pipe is closed.

It is started as `python -m slipmap.diagrams.hardware.child MODULE:FUNCTION ARGUMENT …`.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import IO

from slipmap.diagrams.hardware.network import HardwareError

_READY = b"ready\n"


class Child:
    """A process that runs a function of ours; as its user ends, so does it.

    Args:
        what: it is, for messages.
        function: of a module; it calls `be_ready`, and ends when its standard input does.

    Raises:
        HardwareError: it did not start; it says why on the standard error.
    """

    def __init__(self, what: str, function: Callable[..., None], *arguments: str) -> None:
        self._what = what
        target = f"{function.__module__}:{function.__qualname__}"
        # In a session of its own it does not hear Ctrl-C, which is meant for its user.
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__, target, *arguments],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, start_new_session=True,
        )  # fmt: skip
        if self.output.readline() != _READY:
            self.close()
            raise HardwareError(f"{self._what} did not start; it says why above")

    @property
    def output(self) -> IO[bytes]:
        """What it writes to its standard output once it is ready."""
        assert self._process.stdout is not None
        return self._process.stdout

    def write(self, data: bytes) -> None:
        """Write to its standard input.

        Raises:
            HardwareError: it has ended.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(data)
        except (BrokenPipeError, ValueError) as error:
            raise HardwareError(f"{self._what} has ended; start anew") from error

    def close(self, patience: float = 5.0) -> None:
        """Close its input and wait until it ends; after some time, s, it is killed."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        try:
            self._process.wait(timeout=patience)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def be_ready() -> None:
    """In the child: let the parent know that all is prepared."""
    os.write(sys.stdout.fileno(), _READY)


def have_priority() -> None:
    """In the child, or another process that must keep time: where the system has this and allows it, be kept
    waiting by no other process, nor by the parent if it has real-time priority itself."""
    with suppress(OSError, AttributeError):
        priority = min(os.sched_getparam(0).sched_priority + 1, os.sched_get_priority_max(os.SCHED_RR))
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))


if __name__ == "__main__":
    module, _, name = sys.argv[1].partition(":")
    try:
        getattr(import_module(module), name)(*sys.argv[2:])
    except HardwareError as failure:
        sys.exit(f"slipmap: {failure}")
