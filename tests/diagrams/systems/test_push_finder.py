"""Finding pushes: what counts as one, and why other descents of the finger do not."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from driven_block import DrivenBlock, seen_at
from pydrake.math import RigidTransform

from slipmap.diagrams.systems.measurement_logger import PERIOD
from slipmap.diagrams.systems.push_finder import GAP, LONGEST, PushFinder
from slipmap.models.objects import cells_from_polygon
from slipmap.models.perception.seen_object import ObservedPose

PICTURE = 0.1
RADIUS = 0.008
BLOCK = SimpleNamespace(
    cell_heights=np.array([0.02, 0.03]),
    grid=cells_from_polygon(np.array([[-2, -1], [2, -1], [2, 1], [-2, 1]]) * 0.01, width=0.01),
)
HIGH, LOW = 0.1, 0.004


class Cell(DrivenBlock):
    """A finder whose cell says what the test wants; the block lies at the origin."""

    def __init__(self) -> None:
        super().__init__(
            PushFinder(RADIUS),
            object_pose=ObservedPose.unseen("no object"), seen_object=BLOCK, aside=True,
            tip_pose=RigidTransform([0.3, 0, HIGH]), tip_age=[0.0],
            trials=(), **{"gripper.state_measured": [0.0, 0.0]},
        )  # fmt: skip
        self.advance(0.5 * PERIOD)

    def look(self, x: float, times: int = 3, aside: bool = True) -> None:
        for _ in range(times):
            self.set(object_pose=seen_at(x, 0.0, 0.0, time=self.time), aside=aside)
            self.advance(PICTURE)

    def finger(self, x: float, z: float, duration: float = 0.1) -> None:
        self.set(tip_pose=RigidTransform([x, 0.0, z]))
        self.advance(duration)

    def push(self, end: float = -0.008, duration: float = 0.1) -> None:
        """From a gap of 12 mm to where the finger ends, which touches at x = -0.028."""
        self.finger(-0.04, HIGH)
        for x in np.linspace(-0.04, end, 5):
            self.finger(x, LOW, duration)

    def up(self) -> None:
        self.finger(0.3, HIGH)

    @property
    def modes(self) -> tuple[str, str]:
        return self.read("status").mode, self.read("execution").mode

    @property
    def reasons(self) -> list[str]:
        return [descent.reason for descent in self.read("descents")]


def test_a_push_is_told_as_executor_and_supervisor_would():
    cell = Cell()
    cell.look(0.0)
    assert cell.modes == ("looking", "home")
    began = cell.time
    cell.push()
    assert cell.modes == ("pushing", "pushing")
    ended = cell.time
    cell.up()
    assert cell.modes[0] == "recording"
    cell.look(0.02)
    assert cell.modes == ("recording", "home")
    cell.set(trials=(object(),))
    cell.advance(2 * PERIOD)
    assert cell.modes == ("looking", "home")
    (descent,) = cell.read("descents")
    assert descent.kept
    assert descent.begin == pytest.approx(began + 0.1, abs=2 * PERIOD)
    assert descent.end == pytest.approx(ended, abs=2 * PERIOD)


def test_looks_past_the_arm_do_not_count():
    cell = Cell()
    cell.look(0.0)
    cell.push()
    cell.up()
    cell.look(0.02, aside=False)
    assert cell.modes == ("recording", "retreating")
    cell.look(0.02, times=1)  # the arm may still have been in the way when this picture was taken
    assert cell.modes == ("recording", "retreating")
    cell.look(0.02, times=1)
    assert cell.modes == ("recording", "home")


def refused(cell: Cell) -> str:
    """The reason why the last descent is no push; nothing was ever recorded of it in the end."""
    assert cell.modes[0] == "looking"
    return cell.reasons[-1]


def test_an_object_that_was_not_seen_before():
    cell = Cell()
    cell.push()
    assert cell.modes == ("looking", "approaching")
    cell.up()
    assert refused(cell) == "the object was not seen at rest before"


def test_an_open_gripper():
    cell = Cell()
    cell.look(0.0)
    cell.set(**{"gripper.state_measured": [0.04, 0.0]})
    cell.push()
    cell.up()
    assert refused(cell) == "the gripper was open by 40 mm"


def test_a_finger_that_passes_by():
    cell = Cell()
    cell.look(0.0)
    cell.push(end=-0.034)  # 14 mm off the outline; 13 would be near
    cell.up()
    assert refused(cell) == "the finger did not come near the object"


def test_a_finger_that_passes_by_and_comes_again_before_the_object_was_seen():
    """The logger began the first push with all that was seen of the object."""
    cell = Cell()
    cell.look(0.0)
    cell.set(object_pose=ObservedPose.unseen("occluded"), aside=False)
    cell.push(end=-0.034)
    cell.up()
    cell.push()
    assert cell.modes == ("looking", "approaching")
    cell.up()
    assert refused(cell) == "the object was not seen at rest before"


def test_an_object_that_stays_where_it_is():
    cell = Cell()
    cell.look(0.0)
    cell.push(end=-0.028)
    cell.up()
    cell.look(0.001)
    assert refused(cell) == "the object did not move"
    cell.push()  # what was seen of it counts for the next push
    assert cell.modes == ("pushing", "pushing")


def test_an_arm_that_falls_silent():
    cell = Cell()
    cell.look(0.0)
    cell.push()
    told = cell.time
    for _ in range(20):  # its last word becomes older and older
        cell.set(tip_age=[cell.time - told])
        cell.advance(PERIOD)
    cell.set(tip_age=[0.0])
    cell.advance(2 * PERIOD)
    assert cell.modes == ("looking", "approaching")
    cell.up()
    assert "the arm sent nothing for 0.2" in refused(cell)
    assert GAP < 0.2


def test_a_finger_that_stays_down():
    cell = Cell()
    cell.look(0.0)
    cell.push(duration=LONGEST / 4.9)
    cell.up()
    assert refused(cell) == "the finger was down for more than 60 s"


def test_an_object_that_is_not_seen_after_it():
    cell = Cell()
    cell.look(0.0)
    cell.push()
    cell.up()
    cell.finger(-0.04, LOW)
    assert cell.reasons == ["the object was not seen at rest afterwards, before the finger came down again"]
    assert cell.modes == ("looking", "approaching")  # nor was it seen before this one


def test_a_finger_over_the_object_is_not_down():
    cell = Cell()
    cell.look(0.0)
    cell.finger(0.0, 0.031, 1.0)
    cell.look(0.0)
    assert cell.modes == ("looking", "home") and cell.read("descents") == ()
