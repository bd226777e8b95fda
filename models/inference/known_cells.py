"""What `KnownMaps` say of the cells of a prior: middles, and how much of a deviation is left to them.

A known cell's logarithm has the variance spread²: half is a coordinate that all known cells share, half what
is left of the deviations that free cells have (`prior`), scaled down. Masses in kg stand for themselves, and
free cells share the rest of the total; masses of all cells share the total as their ratios say.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slipmap.models.measurements import KnownMaps
from slipmap.models.physics.cell_grid import FloatArray

if TYPE_CHECKING:
    from slipmap.models.inference.prior import PriorSettings


@dataclass(frozen=True, eq=False)
class KnownCells:
    """Of n cells."""

    log_mass: FloatArray  # (n,) middle, of masses in kg where they stand for themselves
    log_friction: FloatArray  # (n,) middle
    mass_share: FloatArray  # (n,) of a deviation of log mass that a cell takes, 1 where it is free
    friction_share: FloatArray  # (n,) the same of log friction
    sharing: NDArray[np.bool_]  # (n,) whether a cell's mass is a share of the total
    sized: NDArray[np.bool_]  # (n,) whether the mean friction, which is not known, moves a cell's
    free: NDArray[np.bool_]  # (n,) whether nothing is known of a cell
    friction_levels: FloatArray  # (n, k) by which coordinates move the log friction of all cells alike
    mass_levels: FloatArray  # (n, j) the same of masses that stand for themselves
    known_mass: float  # of the cells whose mass is known in kg
    mass_spread: float  # of it

    @classmethod
    def of(cls, known: KnownMaps, cells: int, settings: PriorSettings) -> KnownCells:
        """Of a prior with some settings."""
        a = settings.mass_share
        log_mass, mass_spread, has_mass = _logarithms(known.mass, known.mass_spread, 0.0, cells)
        middle = np.log(settings.friction_mean)
        log_friction, friction_spread, has_friction = _logarithms(
            known.friction, known.friction_spread, middle, cells
        )
        in_kg = np.zeros(cells, dtype=bool) if known.mass_ratios else has_mass
        sized = ~has_friction
        if known.friction_ratios:
            log_friction, sized = log_friction - log_friction.mean() + middle, np.ones(cells, dtype=bool)
        levels = [
            where * size
            for where, size in ((sized, settings.friction_scale), (~sized, friction_spread))
            if where.any()
        ]
        sharing = np.ones(cells, dtype=bool) if in_kg.all() else ~in_kg
        own_mass = np.hypot(a * settings.load_map, settings.split)
        own_friction = np.hypot((1.0 - a) * settings.load_map, settings.split)
        return cls(
            log_mass,
            log_friction,
            np.where(has_mass, np.minimum(mass_spread / own_mass, 1.0), 1.0),
            np.where(has_friction, np.minimum(friction_spread / own_friction, 1.0), 1.0),
            sharing,
            sized,
            ~(has_mass | has_friction),
            np.column_stack(levels),
            np.zeros((cells, 0)) if sharing.all() else np.where(sharing, 0.0, mass_spread)[:, None],
            float(np.exp(log_mass[in_kg]).sum()),
            float(mass_spread.mean()),
        )

    @property
    def levels(self) -> int:
        """Number of coordinates that move cells alike, beside the total mass."""
        return self.friction_levels.shape[1] + self.mass_levels.shape[1]

    def total(self, mass: float | None, settings: PriorSettings) -> tuple[float, float]:
        """Middle, kg, and standard deviation of the logarithm of what cells share, of an object that was
        weighed or not."""
        if self.sharing.all():
            if mass is not None:
                return mass, settings.known_mass
            return (self.known_mass, self.mass_spread) if self.known_mass else (1.0, settings.unknown_mass)
        if mass is None:
            return 1.0, settings.unknown_mass
        rest = mass - self.known_mass
        return rest, settings.known_mass * mass / rest


def _logarithms(
    values: FloatArray | None, spread: FloatArray | float, free: float, cells: int
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Logarithms (n,), standard deviations of each half of the error (n,), and which are known."""
    values = np.full(cells, np.nan) if values is None else values
    known = ~np.isnan(values)
    logarithms = np.where(known, np.log(np.where(known, values, 1.0)), free)
    return logarithms, np.where(known, np.broadcast_to(spread, cells), 1.0) / np.sqrt(2.0), known
