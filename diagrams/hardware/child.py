"""A child process that is fed through a pipe and ends when the pipe is closed.

Its command line is `python -m slipmap.diagrams.hardware.child PARENT MODULE:FUNCTION ARGUMENT …`.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import IO

from slipmap.diagrams.hardware.network import HardwareError
from slipmap.diagrams.systems.workers import prepare_worker

_READY = b"ready\n"


class Child:
    """A process that runs a function of slipmap and ends when its parent does.

    Args:
        what: name of the process, for messages.
        function: of a module; it calls `be_ready`, and ends when its standard input does.

    Raises:
        HardwareError: it did not start; its standard error has the reason.
    """

    def __init__(self, what: str, function: Callable[..., None], *arguments: str) -> None:
        self._what = what
        target = f"{function.__module__}:{function.__qualname__}"
        # In a session of its own it does not get Ctrl-C, which is meant for the parent.
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__, str(os.getpid()), target, *arguments],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, start_new_session=True,
        )  # fmt: skip
        try:
            started = self.output.readline() == _READY
        except BaseException:  # Ctrl-C
            self.close(patience=0.0)
            raise
        if not started:
            self.close()
            raise HardwareError(f"{self._what} did not start; see its message above")

    @property
    def output(self) -> IO[bytes]:
        """Its standard output after it is ready."""
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
            raise HardwareError(f"{self._what} has ended; start again") from error

    def close(self, patience: float = 5.0) -> None:
        """Close its input and wait until it ends; kill it after `patience`, s."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        try:
            self._process.wait(timeout=patience)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def be_ready() -> None:
    """In the child: tell the parent that it is ready."""
    os.write(sys.stdout.fileno(), _READY)


def have_priority() -> None:
    """Get real-time priority, above the parent's if it has that too, where the system supports and allows it.

    For the child, or another process that must keep time.
    """
    with suppress(OSError, AttributeError):
        priority = min(os.sched_getparam(0).sched_priority + 1, os.sched_get_priority_max(os.SCHED_RR))
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))


if __name__ == "__main__":
    prepare_worker(int(sys.argv[1]))
    module, _, name = sys.argv[2].partition(":")
    try:
        getattr(import_module(module), name)(*sys.argv[3:])
    except HardwareError as failure:
        sys.exit(f"slipmap: {failure}")
