"""The prior of the maps before any push: smooth, positive, of unknown scale.

Maps are functions of whitened coordinates z, each with the prior z ~ N(0, 1):

    l = σ_load B z_load,    s = σ_split B z_split
    m_i   = m_total · exp(a l_i + s_i) / Σ_j exp(a l_j + s_j)
    mu_i  = exp(log mu_0 + σ_scale z_mu0 + (1 - a) l_i - s_i)
    mu_f  = exp(log mu_f0 + σ_f z_f),        m_total = m_0 exp(σ_total z_total)
    effect parameters:  p = p_0 + scale z_p, within their bounds

Where masses or frictions are known beforehand (`KnownMaps`), the prior is centred on them, and deviations of
known cells shrink to their stated spread (`KnownCells`).

B Bᵀ is a squared-exponential covariance over the cell centres plus a share of white noise: neighbouring
cells tend to be similar, but need not be. The product of mass and friction, which slow pushes show, depends
on l alone; its split between the two, which they do not show, depends on s. (Independent spreads of mass and
friction that leave the split as open would allow wild products.) Logarithms keep masses and frictions
positive and independent of units: an object of 165 kg is as likely as one of 165 g.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from slipmap.models.effects.effect import Effect, bounds, scales
from slipmap.models.inference.observations import MEASURED_CONTACT
from slipmap.models.measurements import KnownMaps, PushDataset
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.models.physics.step import EXTRA_COLUMNS, INERTIA_COLUMNS


@dataclass(frozen=True)
class PriorSettings:
    """Strength of the prior, in standard deviations of natural logarithms."""

    load_map: float = 0.35  # σ_load, deviation of a cell's product of mass and friction from the mean
    mass_share: float = 0.8  # a, share of that deviation that mass has where nothing else is known
    split: float = 0.30  # σ_split, further deviation of mass and friction in opposite directions
    friction_scale: float = 0.7  # σ_scale of the mean friction
    friction_mean: float = 0.3  # mu_0
    finger_friction: float = 0.8  # σ_f
    finger_friction_mean: float = 0.35  # mu_f0
    known_mass: float = 0.02  # σ_total where the object was weighed
    unknown_mass: float = 2.0  # σ_total where it was not weighed; the median is then 1 kg
    length: float = 0.20  # reach of the covariance in diameters of the footprint
    white: float = 0.30  # share of the variance that neighbours do not share
    # whether borders are sharp: the covariance then decays exponentially, like the probability that random
    # cuts leave two cells in one part (Lakshminarayanan et al., 2016), instead of as a Gaussian
    sharp: bool = False
    largest_friction: float = 3.0  # upper bound of mu and mu_f
    modes: int = 40  # most coordinates of a map; pushes cannot show finer variation


@dataclass(frozen=True, eq=False)
class KnownCells:
    """Effect of `KnownMaps` on n cells of a prior: their centres, and how much each may still deviate.

    The logarithm of a known cell has variance spread²: half from a coordinate that all known cells share,
    half from the deviations of free cells, scaled down. Masses in kg are absolute where only some cells are
    known, and free cells share the rest of the total; otherwise all cells share the total by their ratios.
    """

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
        """Prior centre, kg, and standard deviation of the logarithm of a mass, given the object's own mass or
        None: that of all cells, or of those that share the total if the object was not weighed."""
        if self.sharing.all():
            if mass is not None:
                return mass, settings.known_mass
            return (self.known_mass, self.mass_spread) if self.known_mass else (1.0, settings.unknown_mass)
        return (1.0, settings.unknown_mass) if mass is None else (mass, settings.known_mass)


def _logarithms(
    values: FloatArray | None, spread: FloatArray | float, free: float, cells: int
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Logarithms (n,), standard deviations (n,) of each half of the error, and which are known."""
    values = np.full(cells, np.nan) if values is None else values
    known = ~np.isnan(values)
    logarithms = np.where(known, np.log(np.where(known, values, 1.0)), free)
    return logarithms, np.where(known, np.broadcast_to(spread, cells), 1.0) / np.sqrt(2.0), known


STRUCTURES = {
    "uneven": PriorSettings(load_map=0.4, split=0.5, white=0.8, modes=100),
    "smooth": PriorSettings(),
    "varied": PriorSettings(load_map=0.8, split=0.5, modes=60),
    "parts": PriorSettings(load_map=3.5, split=0.5, white=0.05, sharp=True, length=0.5, modes=60),
    "few points": PriorSettings(load_map=4.0, split=0.5, white=0.95, modes=200),
    "uniform": PriorSettings(load_map=0.1, split=0.1, modes=20),
}
"""Kinds of maps: little variation, from cell to cell or smooth; strong variation; distinct parts; load on a
few cells; or hardly any variation. Of the first two, the smooth kind is for pushes that a law explains
exactly; otherwise single cells absorb the law's errors better, without bending whole regions."""

PLAUSIBLE = {"uneven": 0.4, "smooth": 0.4, "varied": 0.2, "parts": 0.2, "few points": 0.2, "uniform": 0.1}
"""Prior probability of each structure, up to a common factor."""

_FINGER_STARTS = (0.12, 0.35, 1.0)

BOLD = ("varied", "parts", "few points")
"""Structures that can follow the errors of a wrong law."""


def structures_of(dataset: PushDataset) -> Mapping[str, PriorSettings]:
    """Structures that a dataset's object may have: all of `STRUCTURES`, unless every cell is known."""
    if dataset.known is not None and dataset.known.complete:
        return {"known": PriorSettings(modes=20)}
    return STRUCTURES


def slider_for(dataset: PushDataset, effects: Sequence[Effect] = ()) -> Slider:
    """The sliding model of a dataset's object, finger and table, with the contact of recorded fingers."""
    with _COMPILING:
        return Slider(
            dataset.grid, dataset.finger_radius, dataset.gravity, MEASURED_CONTACT, effects, dataset.table
        )  # fmt: skip


_COMPILING = Lock()
"""Two threads would otherwise compile the formulas of the same effects twice."""


class EffectCoordinates:
    """Coordinates z_p of effects, which come after those of maps.

    Attributes:
        plain: number of coordinates of the maps.
        effect_centers: (P,) prior means of the effects' parameters.
        effect_scales: (P,) their standard deviations.
        effect_bounds: (P,) each, lowest and highest values.
        amplitudes: (P,) which of them have a null.
    """

    plain: int
    effect_centers: FloatArray
    effect_scales: FloatArray
    effect_bounds: tuple[FloatArray, FloatArray]
    amplitudes: NDArray[np.bool_]

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return self.plain + len(self.effect_scales)

    def effect_coordinates(self, values: FloatArray) -> FloatArray:
        """Coordinates z_p of effect parameters (…, P)."""
        return (values - self.effect_centers) / self.effect_scales

    def effect_values(self, z: FloatArray) -> FloatArray:
        """(K, P) effect parameters at coordinates (K, size)."""
        return np.clip(self.effect_centers + self.effect_scales * z[:, self.plain :], *self.effect_bounds)

    def effect_deviations(self, hessian: FloatArray) -> FloatArray:
        """(P,) standard deviations of the effects' parameters, marginal over everything else.

        The Hessian (size, size) is that of the data at the best fit; the prior's is added here.
        """
        covariance = np.linalg.inv(hessian + np.eye(self.size))
        return np.sqrt(np.diagonal(covariance)[self.plain :]) * self.effect_scales


class MapPrior(EffectCoordinates):
    """Coordinates of maps on one grid, see the formulas above.

    Args:
        slider: the model that the maps belong to.
        mass: total mass if it was weighed, kg.
        weight: approximate weight of the object, N, which sets the scale of effects that are forces.
        effect_prior: means and standard deviations (P,) of the effects' parameters, to replace their nulls
            and scales.
    """

    def __init__(
        self,
        slider: Slider,
        settings: PriorSettings,
        mass: float | None,
        weight: float | None = None,
        effect_prior: tuple[FloatArray, FloatArray] | None = None,
        known: KnownMaps | None = None,
    ) -> None:
        self.slider = slider
        self.settings = settings
        self.known = known
        self.cells = KnownCells.of(known or KnownMaps(), len(slider.grid), settings)
        self.total_mass, self.total_spread = self.cells.total(mass, settings)
        # In a weighed object, the cells that share the total have what known ones leave. Within `_blur` of
        # 0 kg this is rounded, so that it stays positive.
        self.left_over = mass is not None and not self.cells.sharing.all()
        rest = self.total_mass - self.cells.known_mass
        self._blur = min(rest, settings.known_mass * self.total_mass) if self.left_over else 0.0
        self._shift = self._blur**2 / (4.0 * rest) if self.left_over else 0.0
        members = slider.grid.members
        self._log_size = np.zeros(len(slider.grid)) if members is None else np.log(members)
        self.mass = mass
        self.finger_mean, self.finger_spread = settings.finger_friction_mean, settings.finger_friction
        if known is not None and known.finger_friction is not None:
            self.finger_mean, self.finger_spread = known.finger_friction, known.finger_spread
        effects = slider.effects
        self.effect_centers = np.concatenate([np.zeros(0), *(effect.nulls for effect in effects)])
        self.effect_scales = scales(effects, weight or self.total_mass * slider.gravity)
        if effect_prior is not None:
            self.effect_centers, self.effect_scales = effect_prior
        self.effect_bounds = bounds(effects)
        self.amplitudes = np.concatenate([np.zeros(0, bool), *(effect.amplitudes for effect in effects)])

    @cached_property
    def basis(self) -> FloatArray:
        """B (n, r), with columns sorted by their share of the prior's variance."""
        return covariance_basis(self.slider.grid, self.settings)

    @cached_property
    def plain(self) -> int:  # type: ignore[override]
        """Number of coordinates of the maps: z_load (r), z_split (r), z_total, z_mu0, errors shared by known
        cells, z_f."""
        return 2 * self.basis.shape[1] + 2 + self.cells.levels

    def start(self, finger_friction: float) -> FloatArray:
        """(size,) coordinates of the prior's centre with a given finger friction."""
        z = np.zeros(self.size)
        z[self.plain - 1] = np.log(finger_friction / self.finger_mean) / self.finger_spread
        return z

    def starts(self) -> FloatArray:
        """(K, size) coordinates to start a search from: sticking and sliding contact are different local
        minima, unless the finger friction is known."""
        known = self.known is not None and self.known.finger_friction is not None
        return np.array([self.start(mu) for mu in ((self.finger_mean,) if known else _FINGER_STARTS)])

    def near(self, maps: Maps) -> FloatArray:
        """(K, size) coordinates of given maps, as closely as the basis allows; those of effects are 0, and
        known cells stay at their centres."""
        s, K, cells = self.settings, len(maps), self.cells
        free, sized = cells.free, cells.sized
        of_load, of_split = self.spreads(np.ones(1))
        log_mass, log_mu = np.log(maps.mass) - self._log_size, np.log(maps.mu)

        def projected(spread: float, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
            """Coordinates (K, r) of rows (K, n) up to a constant, and the rows that they reproduce."""
            if not free.any():
                return np.zeros((K, self.basis.shape[1])), np.zeros_like(rows)
            # Otherwise the scale of masses would leak into coordinates of a basis as large as the grid.
            rows = rows - rows[:, free].mean(axis=1, keepdims=True)
            columns = np.column_stack([spread * self.basis, np.ones(self.basis.shape[0])])
            found = np.linalg.lstsq(columns[free], rows[:, free].T, rcond=None)[0][:-1].T
            z = np.asarray(found, dtype=np.float64)
            return z, z @ columns[:, :-1].T

        z_load, load = projected(float(of_load[0]), log_mass + log_mu)
        z_split, split = projected(float(of_split[0]), log_mass - s.mass_share * load)
        shared_mass = maps.mass[:, cells.sharing].sum(axis=1)
        if self.left_over:  # known cells stay at their centres, and the weight bounds the others
            whole = cells.known_mass + self._shift + shared_mass - self._blur**2 / (4.0 * shared_mass)
            low, high = np.exp(np.array([-2.0, 2.0]) * self.total_spread) * self.total_mass
            shared_mass = np.clip(whole, low, high)
        total = np.log(shared_mass / self.total_mass) / self.total_spread
        shared = np.zeros((K, cells.levels))
        if sized.any():
            share = cells.friction_share
            rest = log_mu - share * (1.0 - s.mass_share) * load + share * split
            level = (rest - (cells.log_friction - np.log(s.friction_mean)))[:, sized].mean(axis=1)
            shared[:, 0] = (level - np.log(s.friction_mean)) / s.friction_scale
        finger = np.log(maps.mu_finger / self.finger_mean) / self.finger_spread
        others = np.column_stack([total, shared, finger, np.zeros((K, len(self.effect_scales)))])
        return np.concatenate([z_load, z_split, others], axis=1)

    def moved(self, maps: Maps) -> FloatArray:
        """(K, size) coordinates as from `near`, with the effects' own values."""
        z = self.near(maps)
        z[:, self.plain :] = self.effect_coordinates(maps.effects)
        return z

    def spreads(self, strength: FloatArray) -> tuple[FloatArray, FloatArray]:
        """σ_load and σ_split of maps that vary by a factor more or less than usual.

        σ_split grows with the square root of the factor. Pushes say little about the split of mass and
        friction, so the belief keeps the prior's spread there; it was set so that nine in ten true centres of
        mass lie in 90 % intervals (`slipmap calibrate`).
        """
        return self.settings.load_map * strength, self.settings.split * np.sqrt(strength)

    def rescaled(self, z: FloatArray, strength: FloatArray) -> FloatArray:
        """(K, size) coordinates that give the maps of z (size,), each at its own strength (K,)."""
        r = self.basis.shape[1]
        result = np.repeat(z[None], len(strength), axis=0)
        parts = slice(r), slice(r, 2 * r)
        for part, spread, usual in zip(parts, self.spreads(strength), self.spreads(np.ones(1)), strict=True):
            result[:, part] *= (usual / spread)[:, None]
        return result

    def maps(self, z: FloatArray, strength: FloatArray | float = 1.0) -> Maps:
        """Maps at coordinates (K, size); for `strength` (K,) see `spreads`."""
        r = self.basis.shape[1]
        s, cells = self.settings, self.cells
        of_load, of_split = self.spreads(np.broadcast_to(strength, (len(z),)))
        load = of_load[:, None] * (z[:, :r] @ self.basis.T)
        split = of_split[:, None] * (z[:, r : 2 * r] @ self.basis.T)
        errors = z[:, 2 * r + 1 : self.plain - 1]
        k = cells.friction_levels.shape[1]
        shape = np.clip(cells.mass_share * (s.mass_share * load + split), -20.0, 20.0)
        shape = shape + cells.log_mass + self._log_size
        largest = shape[:, cells.sharing].max(axis=1, keepdims=True, initial=-np.inf)
        shape = shape - np.where(cells.sharing, largest, -errors[:, k:] @ cells.mass_levels.T)
        shape = np.exp(shape)
        total = self.total_mass * np.exp(np.clip(self.total_spread * z[:, 2 * r], -12.0, 12.0))
        if self.left_over:
            rest = total - (shape * ~cells.sharing).sum(axis=1) - self._shift
            root = np.hypot(rest, self._blur)
            total = 0.5 * np.where(rest > 0.0, rest + root, self._blur**2 / (root - np.minimum(rest, 0.0)))
        shared = total[:, None] * shape / (shape * cells.sharing).sum(axis=1, keepdims=True)
        log_mu = (
            cells.log_friction
            + errors[:, :k] @ cells.friction_levels.T
            + cells.friction_share * ((1.0 - s.mass_share) * load)
            - cells.friction_share * split
        )
        log_finger = np.log(self.finger_mean) + self.finger_spread * z[:, self.plain - 1]
        top = np.log(s.largest_friction)
        return Maps(
            np.where(cells.sharing, shared, shape),
            np.exp(np.clip(log_mu, -8.0, np.maximum(top, cells.log_friction + 1.0))),
            np.exp(np.clip(log_finger, -8.0, top)),
            self.effect_values(z),
        )

    def chain(self, maps: Maps, derivative: FloatArray, strength: FloatArray | float = 1.0) -> FloatArray:
        """Convert derivatives (K, …, P) from a rollout's reduced columns to z and start pose.

        Returns:
            (K, …, size + 3): coordinates, then start x, y, θ.
        """
        return self.converted(derivative, self.columns(maps, strength))

    def converted(self, derivative: FloatArray, columns: FloatArray) -> FloatArray:
        """Convert derivatives like `chain`, with given `columns`; the last of them may be missing."""
        P = derivative.shape[-1]
        rows = derivative.reshape(len(columns), math.prod(derivative.shape[1:-1]), P)
        result = np.concatenate([rows @ columns[:, :P], rows[..., self.start_columns]], axis=-1)
        return result.reshape(*derivative.shape[:-1], self.size + 3)

    @property
    def start_columns(self) -> slice:
        """Position of the start's x, y, θ among a rollout's reduced columns."""
        first = len(self.slider.grid) + INERTIA_COLUMNS + 1
        return slice(first, first + 3)

    def columns(self, maps: Maps, strength: FloatArray | float = 1.0) -> FloatArray:
        """(K, P, size) derivatives of the quantities behind a rollout's reduced columns in the coordinates.

        On a table, P includes the cells' masses, which come last; rollouts that stay away from its rim lack
        these columns. Where a friction is at its bound, the derivative is that of the unbounded formula, so
        that a step can lead back inside.
        """
        K, n, r = len(maps), len(self.slider.grid), self.basis.shape[1]
        s, cells = self.settings, self.cells
        of_load, of_split = (
            spread[:, None, None] for spread in self.spreads(np.broadcast_to(strength, (K,)))
        )
        load = (maps.mass * maps.mu * self.slider.gravity)[..., None]
        moved = self.slider.inertia_basis.T * maps.mass[:, None]
        massive, rubbing = (share[:, None] * self.basis for share in (cells.mass_share, cells.friction_share))
        # Contributions of the columns of loads and inertia, (n + 4), over log friction and over log mass.
        by_friction = np.concatenate([load * rubbing, np.zeros((K, INERTIA_COLUMNS, r))], axis=1)
        by_mass = np.concatenate([load * massive, moved @ massive], axis=1)
        by_total = np.concatenate(
            [load * cells.sharing[:, None], (moved * cells.sharing).sum(axis=-1, keepdims=True)], axis=1
        )
        shared = maps.mass * cells.sharing
        rest = shared.sum(axis=1, keepdims=True)
        share, by_whole = shared / rest, np.ones_like(rest)
        pull = np.zeros_like(shared)
        if self.left_over:
            # d log rest = slope / rest (d whole - Σ d m_known), and what known cells gain the others lose.
            slope = 1.0 / (1.0 + self._blur**2 / (4.0 * rest**2))
            pull = (maps.mass - shared) * slope / rest
            whole = (
                rest
                - self._blur**2 / (4.0 * rest)
                + self._shift
                + (maps.mass - shared).sum(axis=1, keepdims=True)
            )
            by_whole, share = whole * slope / rest, share + pull
        by_whole, lost = by_whole[..., None], (pull @ cells.mass_levels)[:, None]
        by_mass -= by_total * (share @ massive)[:, None]
        still = np.zeros((K, INERTIA_COLUMNS, cells.friction_levels.shape[1]))
        masses = 0 if self.slider.table is None else n
        result = np.zeros((K, n + EXTRA_COLUMNS + len(self.effect_scales) + masses, self.size))
        result[:, : n + INERTIA_COLUMNS, : self.plain - 1] = np.concatenate(
            [
                of_load * (s.mass_share * by_mass + (1.0 - s.mass_share) * by_friction),
                of_split * (by_mass - by_friction),
                by_total * by_whole * self.total_spread,
                np.concatenate([load * cells.friction_levels, still], axis=1),
                np.concatenate([load * cells.mass_levels, moved @ cells.mass_levels], axis=1)
                - by_total * lost,
            ],
            axis=-1,
        )
        result[:, n + INERTIA_COLUMNS, self.plain - 1] = self.finger_spread * maps.mu_finger
        first = n + EXTRA_COLUMNS
        result[:, first : first + len(self.effect_scales), self.plain :] = np.diag(self.effect_scales)
        if masses:
            mass = maps.mass[..., None]
            by_load = mass * (massive - cells.sharing[:, None] * (share @ massive)[:, None])
            unmoving = np.zeros((K, n, cells.friction_levels.shape[1]))
            result[:, -n:, : self.plain - 1] = np.concatenate(
                [
                    of_load * s.mass_share * by_load,
                    of_split * by_load,
                    mass * cells.sharing[:, None] * by_whole * self.total_spread,
                    unmoving,
                    mass * (cells.mass_levels - cells.sharing[:, None] * lost),
                ],
                axis=-1,
            )
        return result


@lru_cache(maxsize=16)
def covariance_basis(grid: CellGrid, settings: PriorSettings) -> FloatArray:
    """(n, r) square root of the covariance of a map over the cells, truncated to its leading modes.

    It is computed once for each grid and kept, since every law and effect has a prior of its own.
    """
    centers = grid.centers
    diameter = float(np.hypot(*(np.ptp(centers, axis=0) + grid.width)))
    distance = np.hypot(*(centers[:, None] - centers[None]).transpose(2, 0, 1)) / (settings.length * diameter)
    alike = np.exp(-distance if settings.sharp else -0.5 * distance**2)
    covariance = (1.0 - settings.white) * alike + settings.white * np.eye(len(centers))
    values, vectors = np.linalg.eigh(covariance)
    order = np.argsort(values)[::-1][: settings.modes]
    basis: FloatArray = vectors[:, order] * np.sqrt(np.maximum(values[order], 0.0))
    basis.flags.writeable = False
    return basis
