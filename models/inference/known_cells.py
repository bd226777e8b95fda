"""Effect of `KnownMaps` on the cells of a prior: their centres, and how much each may still deviate.

The logarithm of a known cell has variance spread²: half from a coordinate that all known cells share, half
from the deviations of free cells (`prior`), scaled down. Masses in kg are absolute where only some cells are
known, and free cells share the rest of the total; otherwise all cells share the total by their ratios.
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
    """What is known about n cells."""

    log_mass: FloatArray  # (n,) prior centre, of the mass in kg where it is absolute
    log_friction: FloatArray  # (n,) prior centre
    mass_share: FloatArray  # (n,) factor on deviations of log mass, 1 where the cell is free
    friction_share: FloatArray  # (n,) the same for log friction
    sharing: NDArray[np.bool_]  # (n,) whether a cell's mass is a share of the total
    sized: NDArray[np.bool_]  # (n,) whether a cell's friction scales with the unknown mean friction
    free: NDArray[np.bool_]  # (n,) whether nothing is known about a cell
    friction_levels: FloatArray  # (n, k) change of log friction with the coordinates that cells share
    mass_levels: FloatArray  # (n, j) the same for absolute masses
    known_mass: float  # total of the cells whose mass is known in kg
    mass_spread: float  # its relative standard deviation

    @classmethod
    def of(cls, known: KnownMaps, cells: int, settings: PriorSettings) -> KnownCells:
        """From known maps, for a prior with given settings."""
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
        """Number of coordinates that cells share, besides the total mass."""
        return self.friction_levels.shape[1] + self.mass_levels.shape[1]

    def total(self, mass: float | None, settings: PriorSettings) -> tuple[float, float]:
        """Prior centre, kg, and standard deviation of the logarithm of the mass that cells share, given the
        object's mass or None if it was not weighed."""
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
    """Logarithms (n,), standard deviations (n,) of each half of the error, and which are known."""
    values = np.full(cells, np.nan) if values is None else values
    known = ~np.isnan(values)
    logarithms = np.where(known, np.log(np.where(known, values, 1.0)), free)
    return logarithms, np.where(known, np.broadcast_to(spread, cells), 1.0) / np.sqrt(2.0), known
