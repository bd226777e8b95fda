"""What a run of the robot's cell has recorded so far: enough for another process to go on from."""

from __future__ import annotations

from dataclasses import dataclass, replace

from models.measurements import Trial
from models.perception.first_picture import FirstPicture
from models.physics.cell_grid import CellGrid
from planners.action_selection import Poke


@dataclass(frozen=True, eq=False)
class Recorded:
    """Pushes that were made, and what is known besides.

    Attributes:
        trials: that are complete, one or more.
        pokes: how they were asked for; as many.
        places: where the simulated object lay after each, x and y in m, turn in degrees; None of a real one.
        grid: the object as the camera made it out.
        first: the picture from which.
    """

    trials: tuple[Trial, ...]
    pokes: tuple[Poke, ...]
    places: tuple[list[float] | None, ...]
    grid: CellGrid
    first: FirstPicture

    @property
    def of_a_real_cell(self) -> bool:
        """Whether it was recorded there, not in a simulation."""
        return self.places[-1] is None

    def all_to_learn_from(self) -> Recorded:
        """The same, of which every push is learned from, also those that were made to judge."""
        return replace(self, trials=tuple(replace(trial, role="fit") for trial in self.trials))
