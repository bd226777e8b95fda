"""Being the one who controls a real cell."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager

import numpy as np

from diagrams.console import note
from diagrams.hardware.interface import HardwareInterface
from diagrams.hardware.lock import only_controller
from diagrams.station.scenario import Scenario
from diagrams.systems.workers import workers
from models.effects.registry import effects_named
from models.effects.slider import EffectSlider
from models.effects.stepper import Stepper
from models.objects import cells_from_centres
from models.physics.rollout import Maps, Push, Slider


@contextmanager
def stopped_by_ctrl_c(cell: HardwareInterface) -> Iterator[Callable[[], bool]]:
    """In the block Ctrl-C, or a signal to end, stops the arm, which holds; the second one is Ctrl-C as ever.
    Yields whether it came."""
    pressed: list[int] = []

    def stop(number: int, frame: object) -> None:
        if pressed:
            raise KeyboardInterrupt
        pressed.append(number)
        cell.abort()
        reason = "Ctrl-C" if number == signal.SIGINT else "told to end"
        note(f"{reason}: the arm stops and holds; once more ends at once")

    if threading.current_thread() is not threading.main_thread():  # others hear no signals
        yield lambda: False
        return
    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(pressed)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def real_cell(
    scenario: Scenario, where: str | HardwareInterface | None, effects: Sequence[str] = ()
) -> Iterator[tuple[HardwareInterface | None, Executor | None]]:
    """The cell behind an LCM address and workers, until the block ends; neither where there is no address.

    At the end the arm comes to rest.

    Args:
        scenario: what the cell is like.
        where: LCM address, see `network.open_lcm`; the station is simulated if None, and waits for what takes
            long. Or what has the ports and methods of `HardwareInterface`; it waits likewise.
        effects: that the model is given; its machine code is loaded before the arm can move.

    Raises:
        EffectError: an unknown effect.
        HardwareError: a malformed address, or no network.
        BadInput: somebody else controls the cell.
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
    """Have the code of the model's steps and rollouts in this process: the first would else hold the diagram
    up for a second, with the arm under way."""
    grid, found = cells_from_centres(np.zeros((1, 2)), 0.02), effects_named(list(effects))
    Stepper(grid, 0.01, 0.01, found).load()
    slider = EffectSlider(grid, 0.01, found) if found else Slider(grid, 0.01)
    push = Push(0.01, np.full((9, 2), 0.1), np.zeros(3), force_times=np.full(1, 0.04))
    slider.rollout(Maps(np.ones((1, 1)), np.full((1, 1), 0.3), np.full(1, 0.3)), [push])
