"""Exclusive control of a real cell: a lock for each arm, Ctrl-C that stops it, and its ports."""

import fcntl
import hashlib
import json
import os
import shlex
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from slipmap.diagrams.hardware.interface import HardwareInterface
from slipmap.diagrams.hardware.network import place_of
from slipmap.diagrams.station.scenario import Scenario
from slipmap.diagrams.systems.workers import workers
from slipmap.models.effects.registry import effects_named
from slipmap.models.files import BadInput, writing
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.rollout import Maps, Push, Slider
from slipmap.models.physics.stepper import Stepper

# Locks of this process: the system would let it take them again, and closing such a file frees the lock.
_held: set[Path] = set()


@contextmanager
def only_controller(url: str) -> Iterator[None]:
    """Hold the lock of the arm at an address until the block ends.

    The system releases it when the process ends, however it ends: the lock of a dead process is free.

    Args:
        url: LCM address; its options after the ? make no difference.

    Raises:
        BadInput: another process holds the lock; names that process. Or the lock's folder is not writable.
        HardwareError: a malformed address.
    """
    path = lock_folder() / f"{hashlib.sha256(place_of(url).encode()).hexdigest()[:16]}.lock"
    if path in _held:
        raise _taken(url, f"this process ({os.getpid()})")
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        file = open(path, "a+", encoding="utf-8")  # noqa: SIM115
    with file:
        if not _locked(file):
            raise _taken(url, _holder(file))
        _held.add(path)
        try:
            with writing(path):
                _sign(file)
            yield
        finally:
            _held.discard(path)


def _taken(url: str, holder: str) -> BadInput:
    return BadInput(
        f"{url}: {holder} drives the arm there; stop it first, or choose another address with --lcm"
    )


def lock_folder() -> Path:
    """Folder of this user's locks."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and Path(runtime).is_dir():
        return Path(runtime) / "slipmap"
    return Path(tempfile.gettempdir()) / f"slipmap-{os.getuid()}"


def _locked(file: IO[str]) -> bool:
    # Unlike flock, a record lock is not inherited by worker processes, which might live longer.
    try:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _sign(file: IO[str]) -> None:
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    file.seek(0)
    file.truncate()
    json.dump({"process": os.getpid(), "command": command, "since": time.strftime("%H:%M:%S")}, file)
    file.flush()


def _holder(file: IO[str]) -> str:
    file.seek(0)
    try:
        holder = json.load(file)
        return f"process {holder['process']} ({holder['command']}, since {holder['since']})"
    except (ValueError, KeyError, TypeError):  # it has only just taken the lock
        return "another process"


def stopped_by_ctrl_c(cell: HardwareInterface) -> AbstractContextManager[Callable[[], bool]]:
    """In the block, make Ctrl-C or SIGTERM stop the arm, which then holds; see `until_ctrl_c`."""

    def stop(number: int) -> None:
        cell.abort()
        reason = "Ctrl-C" if number == signal.SIGINT else "SIGTERM"
        print(f"{reason}: the arm stops and holds; repeat to quit at once", file=sys.stderr, flush=True)

    return until_ctrl_c(stop)


@contextmanager
def until_ctrl_c(stop: Callable[[int], None] = lambda number: None) -> Iterator[Callable[[], bool]]:
    """In the block, make the first Ctrl-C or SIGTERM call a function with its number; the second one raises
    KeyboardInterrupt. Yields a function that tells whether one came."""
    pressed: list[int] = []

    def press(number: int, frame: object) -> None:
        if pressed:
            raise KeyboardInterrupt
        pressed.append(number)
        stop(number)

    if threading.current_thread() is not threading.main_thread():  # others get no signals
        yield lambda: False
        return
    before = {number: signal.signal(number, press) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(pressed)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def real_cell(
    scenario: Scenario, where: str | HardwareInterface | None, effects: Sequence[str] = ()
) -> Iterator[tuple[HardwareInterface | None, Executor | None]]:
    """The cell at an LCM address and workers, until the block ends; None for both without an address.

    At the end the arm comes to rest.

    Args:
        where: LCM address, see `network.open_lcm`. If None, the station is simulated and waits for long
            computations. Or an object with the ports and methods of `HardwareInterface`, which also waits.
        effects: of the model; its machine code is loaded before the arm can move.

    Raises:
        EffectError: an unknown effect.
        HardwareError: a malformed address, or no network.
        BadInput: another process controls the cell.
    """
    if where is None:
        yield None, None
        return
    if not isinstance(where, str):
        try:
            yield where, None
        finally:
            where.close()
        return
    with only_controller(where), workers() as worker:
        _load_model(effects)
        cell = HardwareInterface(where, scenario)
        try:
            yield cell, worker
        finally:
            cell.close()


def _load_model(effects: Sequence[str]) -> None:
    """Load the compiled code of the model's steps and rollouts, which would otherwise delay the diagram by a
    second while the arm is moving."""
    square = 0.01 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    grid, found = CellGrid(np.zeros((1, 2)), 0.02, square), effects_named(list(effects))
    Stepper(grid, 0.01, 0.01, found).load()
    slider = Slider(grid, 0.01, effects=found)
    push = Push(0.01, np.full((9, 2), 0.1), np.zeros(3), force_times=np.full(1, 0.04))
    slider.rollout(Maps(np.ones((1, 1)), np.full((1, 1), 0.3), np.full(1, 0.3)), [push])
