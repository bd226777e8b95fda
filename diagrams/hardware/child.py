"""A process beside this one that is fed through a pipe, and ends when the pipe is closed."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from typing import IO

from slipmap.diagrams.hardware.channels import HardwareError

_READY = b"ready\n"


class Child:
    """A process that runs a module of ours; as its user ends, so does it.

    Args:
        what: it is, for messages.
        module: name of the module.
        arguments: of its command line.

    Raises:
        HardwareError: it did not start.
    """

    def __init__(self, what: str, module: str, *arguments: str) -> None:
        self._what = what
        command = [sys.executable, "-m", module, *arguments]
        # In a session of its own it does not hear Ctrl-C, which is meant for its user.
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, start_new_session=True
        )

    def wait_until_ready(self) -> None:
        """Wait until it has called `be_ready`.

        Raises:
            HardwareError: it ended before.
        """
        assert self._process.stdout is not None
        if self._process.stdout.readline() != _READY:
            self.close()
            raise HardwareError(f"{self._what} did not start; it says why above")

    @property
    def output(self) -> IO[bytes]:
        """What it writes to its standard output once it is ready."""
        assert self._process.stdout is not None
        return self._process.stdout

    def send(self, data: bytes) -> None:
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
    """In the child: tell the parent that all is prepared."""
    os.write(sys.stdout.fileno(), _READY)


def have_priority() -> None:
    """In the child, or another process that must keep time: where the system has this and allows it, be kept
    waiting by no other process, nor by the parent if it has real-time priority itself."""
    with suppress(OSError, AttributeError):
        priority = min(os.sched_getparam(0).sched_priority + 1, os.sched_get_priority_max(os.SCHED_RR))
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))
