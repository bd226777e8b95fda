"""What planning needs of the place where pushes are made: a simulation or a robot."""

from __future__ import annotations

from typing import Protocol

from models.measurements.push_dataset import Table, Trial
from models.physics.cell_grid import FloatArray
from planners.table_push import TablePush


class ObjectFell(Exception):
    """The object is not on the table any more. The text says where it was seen last."""


class PushNotMade(Exception):
    """The robot cannot or will not make this push. The text says why; nothing has moved."""


class World(Protocol):
    """A table with one object on it, and a finger that pushes.

    Attributes:
        table: its top.
        finger_radius: m.
    """

    table: Table
    finger_radius: float

    def look(self) -> FloatArray:
        """(3,) pose of the object as it is seen now, world, m and rad.

        Raises:
            ObjectFell: it is not on the table.
        """
        ...

    def push(self, push: TablePush) -> Trial:
        """Make a push and return what was recorded; an object that falls is noticed by the next look.

        Raises:
            PushNotMade: the robot refuses.
        """
        ...
