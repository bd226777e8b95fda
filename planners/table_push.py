"""A push as it is asked for: the finger moves along a line on the table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.physics.cell_grid import FloatArray


@dataclass(frozen=True, eq=False)
class TablePush:
    """A straight push of the finger.

    Attributes:
        begin: (2,) centre of the finger before it moves, free of the object, world, m.
        end: (2,) centre of the finger where it stops, world, m.
        speed: of the finger between speeding up and slowing down, m/s.

    Raises:
        ValueError: a number that is not finite, a speed that is not positive, or no way to go.
    """

    begin: FloatArray
    end: FloatArray
    speed: float

    def __post_init__(self) -> None:
        begin, end = np.asarray(self.begin, dtype=float), np.asarray(self.end, dtype=float)
        if begin.shape != (2,) or end.shape != (2,) or not np.isfinite([*begin, *end]).all():
            raise ValueError(f"push: begin and end must be finite points (2,), got {begin} and {end}")
        if not (np.isfinite(self.speed) and self.speed > 0):
            raise ValueError(f"push: speed must be positive, got {self.speed} m/s")
        if np.hypot(*(end - begin)) < 1e-6:
            raise ValueError("push: begin and end are the same point")
        object.__setattr__(self, "begin", begin)
        object.__setattr__(self, "end", end)

    @property
    def length(self) -> float:
        """Way of the finger, m."""
        return float(np.hypot(*(self.end - self.begin)))

    @property
    def direction(self) -> FloatArray:
        """(2,) unit vector of the finger's motion, world."""
        return (self.end - self.begin) / self.length
