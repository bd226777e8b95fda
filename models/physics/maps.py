"""Hypotheses about the object: mass and friction maps, finger friction, parameters of effects."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from slipmap.models.physics.cell_grid import FloatArray


@dataclass(frozen=True, eq=False)
class Maps:
    """K hypotheses about the object.

    Attributes:
        mass: (K, n) cell masses, kg.
        mu: (K, n) friction coefficients of cells on the table.
        mu_finger: (K,) friction coefficients at the finger.
        effects: (K, P) parameters of the `Slider`'s effects; P is 0 if it has none.

    Example:
        >>> import numpy as np
        >>> import slipmap
        >>> maps = slipmap.Maps(np.full((2, 15), 0.02), np.full((2, 15), 0.4), np.array([0.3, 0.2]))
        >>> len(maps)
        2
    """

    mass: FloatArray
    mu: FloatArray
    mu_finger: FloatArray
    effects: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    def __repr__(self) -> str:
        hypotheses, cells = self.mass.shape
        return f"Maps({hypotheses} of {cells} cells, {self.effects.shape[1]} parameters of effects)"

    def __post_init__(self) -> None:
        mass, mu = (np.atleast_2d(np.ascontiguousarray(a, dtype=float)) for a in (self.mass, self.mu))
        finger = np.atleast_1d(np.ascontiguousarray(self.mu_finger, dtype=float))
        if mass.ndim != 2 or mass.shape != mu.shape or finger.shape != (len(mass),):
            raise ValueError(
                f"maps: mass {mass.shape} and mu {mu.shape} must both have shape (K, n), and mu_finger "
                f"{finger.shape} one number per map"
            )
        for name, value in (("mass", mass), ("mu", mu), ("mu_finger", finger)):
            if not np.isfinite(value).all() or (value < 0).any():
                raise ValueError(f"maps: {name} must be finite and not negative")
        if not (mass.sum(axis=1) > 0).all():
            raise ValueError("maps: the total mass must be positive")
        effects = np.ascontiguousarray(self.effects, dtype=float)
        if effects.size == 0:
            effects = np.zeros((len(mass), 0))
        if effects.ndim != 2 or len(effects) != len(mass) or not np.isfinite(effects).all():
            raise ValueError(
                f"maps: effects must be finite and of shape ({len(mass)}, P), got {effects.shape}"
            )
        self.__dict__.update(mass=mass, mu=mu, mu_finger=finger, effects=effects)

    def __len__(self) -> int:
        return len(self.mass)

    def __getitem__(self, index: int | slice | NDArray[np.integer]) -> Maps:
        return Maps(
            self.mass[index],
            self.mu[index],
            np.atleast_1d(self.mu_finger[index]),
            np.atleast_2d(self.effects[index]),
        )
