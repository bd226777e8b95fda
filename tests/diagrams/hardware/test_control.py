"""Ctrl-C in a real cell: first the arm stops, then the program ends."""

from __future__ import annotations

import os
import signal

import pytest

from slipmap.diagrams.hardware.control import stopped_by_ctrl_c


class Cell:
    """Counts how often it is to stop."""

    aborts = 0

    def abort(self) -> None:
        self.aborts += 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_stops_the_arm_and_a_second_one_ends_the_program(capsys, number):
    cell, before = Cell(), signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt), stopped_by_ctrl_c(cell) as pressed:
        assert not pressed()
        os.kill(os.getpid(), number)
        assert pressed() and cell.aborts == 1
        assert "the arm stops and holds" in capsys.readouterr().err
        os.kill(os.getpid(), number)
    assert cell.aborts == 1
    assert signal.getsignal(number) is before
