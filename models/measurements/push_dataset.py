"""Measurements of a finger pushing one object over a table: what is known about the setup, and datasets."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from numbers import Integral
from typing import TYPE_CHECKING, Literal

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely.geometry import Polygon

from slipmap.models.geometry import seen_from
from slipmap.models.measurements.trial import DatasetError, Trial, in_order
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.settings import (
    THICKEST_FINGER,
    TOO_THICK,
    check_choice,
    check_kind,
    check_not_negative,
    check_positive,
)

if TYPE_CHECKING:
    from slipmap.models.physics.rollout import Slider

LEAST_SPREAD = 1e-3
"""Smallest relative standard deviation with which anything is known."""

LEAST_PER_AREA, MOST_PER_AREA = 0.1, 2e4
"""Mass per area of an object, from stiff paper to two metres of steel, kg/m²; hardly any lies outside."""

_DENSEST = 2.5e4  # kg/m³, more than gold
_LEAST_NOISE = {
    "position": (1e-6, "m"),
    "angle": (1e-5, "rad"),
    "tip": (1e-6, "m"),
    "force": (1e-4, "N"),
    "outline": (1e-6, "m"),
}


@dataclass(frozen=True)
class Noise:
    """Standard deviations of each channel's rows, where known: m, rad, m, N; and of the outline, m.

    Values below 1 µm, 10 µrad, 1 µm, 0.1 mN or 1 µm, such as 0 in a simulation, are raised to these, since no
    model is more exact.

    Attributes:
        outline: of where a finger touches the outline, along x and y each, independent from push to push. An
            outline without it counts as exact.

    Raises:
        ValueError: a negative or not finite number.
    """

    position: float | None = None
    angle: float | None = None
    tip: float | None = None
    force: float | None = None
    outline: float | None = None

    def __post_init__(self) -> None:
        for name, (least, unit) in _LEAST_NOISE.items():
            value = getattr(self, name)
            if value is not None:
                check_not_negative(f"Noise: {name}", value, unit)
                object.__setattr__(self, name, max(value, least))


def _finite_pair(values: object) -> bool:
    """Whether these are two finite numbers."""
    try:
        numbers = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        return False
    return numbers.shape == (2,) and bool(np.isfinite(numbers).all())


def _pair(values: ArrayLike) -> tuple[float, float]:
    first, second = np.asarray(values, dtype=float)
    return float(first), float(second)


@dataclass(frozen=True)
class Table:
    """The table top in the world frame: round with a radius, or a rectangle with sides along x and y, m.

    Raises:
        ValueError: another shape, or one without the length that it needs; numbers that are not finite.

    Example:
        >>> from slipmap.models.measurements import Table
        >>> table = Table("round", (0.0, 0.0), radius=0.5)
        >>> table.radius
        0.5
    """

    shape: Literal["round", "rectangle"]
    center: tuple[float, float]
    radius: float | None = None
    size: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        check_choice("Table: shape", self.shape, ("round", "rectangle"))
        if not _finite_pair(self.center):
            raise ValueError(f"Table: center must be two finite numbers in m, got {self.center}")
        object.__setattr__(self, "center", _pair(self.center))
        if self.shape == "round":
            check_positive("Table: radius of a round table", self.radius, "m")
        elif self.size is None or not _finite_pair(self.size) or min(self.size) <= 0:
            raise ValueError(
                f"Table: size of a rectangular table must be two positive numbers in m, got {self.size}"
            )
        else:
            object.__setattr__(self, "size", _pair(self.size))

    @property
    def polygon(self) -> Polygon:
        """The table top, m; of a round one within a hundredth of the radius."""
        if self.size is None:
            return shapely.Point(self.center).buffer(self.radius or 0.0)
        half = 0.5 * np.array(self.size)
        return shapely.box(*(self.center - half), *(self.center + half))

    def margin(self, points: FloatArray) -> FloatArray:
        """(…) how far points (…, 2) lie inside the rim, m; negative beyond it."""
        off = points - np.asarray(self.center)
        if self.size is None:
            return np.asarray((self.radius or 0.0) - np.hypot(off[..., 0], off[..., 1]))
        return np.asarray((0.5 * np.array(self.size) - np.abs(off)).min(axis=-1))


@dataclass(frozen=True, eq=False)
class KnownMaps:
    """What is known about an object's maps before any push.

    A spread is a relative standard deviation; half of its variance is common to all cells with a known value,
    half independent for each cell.

    Attributes:
        mass: (n,) of each cell, kg, NaN where not known; None if no cell's is known.
        friction: (n,) friction coefficient of each cell with the table, likewise.
        finger_friction: friction coefficient with the finger.
        mass_spread: of all masses, or (n,) of each.
        friction_spread: of all coefficients, or (n,) of each.
        finger_spread: of the finger's coefficient.
        mass_ratios: only the ratios of masses are known; every cell must have one. The total is the object's
            mass if it was weighed, otherwise free.
        friction_ratios: only the ratios of coefficients are known, not their absolute values.

    Raises:
        DatasetError: a value or spread that is not positive, or of another shape.

    Example:
        >>> import dataclasses
        >>> import slipmap
        >>> from slipmap.models.measurements import KnownMaps
        >>> dataset, truth = slipmap.simulated_hammer(fit=1, heldout=0)
        >>> known = KnownMaps(truth.mass[0], truth.mu[0], mass_spread=0.01, friction_spread=0.05)
        >>> dataclasses.replace(dataset, known=known).known.complete
        True
    """

    mass: FloatArray | None = None
    friction: FloatArray | None = None
    finger_friction: float | None = None
    mass_spread: FloatArray | float = 0.05
    friction_spread: FloatArray | float = 0.05
    finger_spread: float = 0.05
    mass_ratios: bool = False
    friction_ratios: bool = False

    def __repr__(self) -> str:
        known = [
            f"{'ratios of ' if ratios else ''}{name} of {np.isfinite(values).sum()} of {len(values)} cells"
            for name, values, ratios in (
                ("mass", self.mass, self.mass_ratios),
                ("friction", self.friction, self.friction_ratios),
            )
            if values is not None
        ]
        if self.finger_friction is not None:
            known.append(f"finger friction {self.finger_friction:g}")
        return f"KnownMaps({', '.join(known)})"

    def __post_init__(self) -> None:
        shapes = []
        for name in ("mass", "friction"):
            values, spread = getattr(self, name), getattr(self, f"{name}_spread")
            if values is None:
                continue
            values = np.ascontiguousarray(values, dtype=float)
            try:
                spread = np.array(np.broadcast_to(np.asarray(spread, dtype=float), values.shape))
            except ValueError:
                raise DatasetError(
                    f"known maps: {name} has {values.shape} values and {np.shape(spread)} spreads"
                ) from None
            self._check(name, values[~np.isnan(values)], spread[~np.isnan(values)])
            if getattr(self, f"{name}_ratios") and np.isnan(values).any():
                raise DatasetError(f"known maps: ratios of {name} need a value for every cell")
            shapes.append(values.shape)
            object.__setattr__(self, name, values)
            object.__setattr__(self, f"{name}_spread", spread)
        if any(len(shape) != 1 or shape != shapes[0] for shape in shapes):
            raise DatasetError(f"known maps: mass and friction need one value per cell, got shapes {shapes}")
        if self.finger_friction is not None:
            self._check("finger_friction", np.array([self.finger_friction]), np.array([self.finger_spread]))

    @staticmethod
    def _check(name: str, values: FloatArray, spread: FloatArray) -> None:
        if not (np.isfinite(values).all() and (values > 0).all()):
            raise DatasetError(f"known maps: {name} must be positive and finite, NaN where it is not known")
        if not ((spread >= LEAST_SPREAD) & (spread <= 1.0)).all():
            raise DatasetError(
                f"known maps: a spread of {name} must lie between {LEAST_SPREAD:g} and 1 (relative standard"
                " deviation)"
            )

    @property
    def complete(self) -> bool:
        """Whether every cell's mass and friction is known, at least as a ratio."""
        maps = (self.mass, self.friction)
        return all(values is not None and not np.isnan(values).any() for values in maps)

    def check(self, cells: int, mass: float | None) -> None:
        """Refuse known maps that do not match the object's number of cells or, if it was weighed, its mass
        (kg).

        Raises:
            DatasetError: a different number of cells, or masses that contradict the object's mass.
        """
        for name in ("mass", "friction"):
            values = getattr(self, name)
            if values is not None and len(values) != cells:
                raise DatasetError(f"known maps: {name} has {len(values)} values for {cells} cells")
        if self.mass is None or mass is None or self.mass_ratios:
            return
        total, some = float(np.nansum(self.mass)), bool(np.isnan(self.mass).any())
        off = abs(float(np.log(total / mass))) > 3.0 * np.hypot(np.max(self.mass_spread), 0.02)
        if total >= mass if some else off:
            raise DatasetError(
                f"known maps: the masses add up to {total:.4g} kg, but the object weighs {mass:.4g} kg;"
                " correct one of them"
            )


@dataclass(frozen=True, eq=False)
class Setup:
    """Object, finger and table of a dataset."""

    # name, description: free text
    name: str
    description: str
    grid: CellGrid  # the object's cells and outline
    height: float | None  # of the object above the table, m, where known
    mass: float | None  # total mass, kg, if it was weighed
    finger_radius: float  # m
    table: Table | None  # the table top, where known
    gravity: float  # m/s²
    noise: Noise  # standard deviations, where known
    known: KnownMaps | None = field(default=None, kw_only=True)  # of the maps, before any push
    finger_height: float | None = field(default=None, kw_only=True)  # of its lower end above the table, m

    @property
    def reach(self) -> float:
        """Largest distance of the outline from the object frame's origin, m."""
        return self.grid.reach

    @property
    def heaviest(self) -> float:
        """Mass that hardly any object with this outline and height exceeds, kg."""
        of_height = np.inf if self.height is None else _DENSEST * self.height
        return float(self.grid.polygon.area * min(MOST_PER_AREA, of_height))

    @property
    def noise_of_motion(self) -> float:
        """Standard deviation of a point at the outline due to the declared noise of a pose, m."""
        return float(np.hypot(self.noise.position or 0.0, self.reach * (self.noise.angle or 0.0)))


@dataclass(frozen=True, eq=False)
class PushDataset(Setup):
    """Trials of one object with one finger; `slipmap.dataset_from_arrays` makes one of arrays.

    Attributes:
        trials: in the order of the experiment. Unless each has an `order` of its own, as after reading and
            selecting, they are numbered by their places.
        fingerprint: sha256 of the files that were read, wherever they are. A selection of trials keeps it.
        warnings: what looks wrong without making the data useless.
        provenance: where the pushes came from and what was done to them, in sentences.

    Raises:
        DatasetError: no trials, two with the same name, a radius, gravity, height or mass that is not
            positive, or a finger over 0.5 m thick.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(fit=3, heldout=1)
        >>> dataset.name, dataset.finger_radius, len(dataset.fit_trials), len(dataset.heldout_trials)
        ('hammer', 0.008, 3, 1)
    """

    trials: tuple[Trial, ...]
    fingerprint: str
    warnings: tuple[str, ...] = ()
    provenance: tuple[str, ...] = ()

    def __repr__(self) -> str:
        fit = len(self.fit_trials)
        return (
            f"PushDataset({self.name!r}: {len(self.grid)} cells; {fit} push{'es' * (fit != 1)} to fit,"
            f" {len(self.heldout_trials)} held out)"
        )

    def __post_init__(self) -> None:
        for what, value, optional in (
            ("height", self.height, True),
            ("mass", self.mass, True),
            ("finger radius", self.finger_radius, False),
            ("finger height", self.finger_height, True),
            ("gravity", self.gravity, False),
        ):
            number = np.asarray(value)  # as np.load gives a mass
            sound = number.ndim == 0 and number.dtype.kind in "iuf" and np.isfinite(number) and number > 0
            if not sound and not (optional and value is None):
                raise DatasetError(f"dataset {self.name}: {what} must be positive and finite, got {value!r}")
        if self.finger_radius > THICKEST_FINGER:
            raise DatasetError(TOO_THICK.format(where="finger radius", value=self.finger_radius))
        if self.known is not None:
            self.known.check(len(self.grid), self.mass)
        if not self.trials:
            raise DatasetError(f"dataset {self.name}: there are no trials; at least one push is needed")
        name, uses = Counter(trial.name for trial in self.trials).most_common(1)[0]
        if uses > 1:
            raise DatasetError(f"dataset {self.name}: {uses} trials are called {name}; names must differ")
        object.__setattr__(self, "trials", in_order(self.trials))

    @property
    def fit_trials(self) -> tuple[Trial, ...]:
        """Trials to learn from."""
        return tuple(trial for trial in self.trials if trial.role == "fit")

    @property
    def heldout_trials(self) -> tuple[Trial, ...]:
        """Trials to judge with."""
        return tuple(trial for trial in self.trials if trial.role == "heldout")

    def with_fit_pushes(self, count: int) -> PushDataset:
        """The dataset with only the first `count` fit trials and all heldout trials.

        Raises:
            ValueError: `count` is no whole number, below 1, or above the number of fit trials.
        """
        available = len(self.fit_trials)
        if not isinstance(count, Integral) or not 1 <= count <= available:
            raise ValueError(
                f"dataset {self.name}: cannot take {count!r} of {available} fit trials; take 1 to {available}"
            )
        kept = set(self.fit_trials[:count])
        return replace(self, trials=tuple(t for t in self.trials if t.role == "heldout" or t in kept))


MakeDataset = Callable[[Sequence[Trial], CellGrid], PushDataset]
"""Combines trials and the object's cells into a dataset with everything known about the setup."""


def dataset_of(
    trials: Sequence[Trial],
    grid: CellGrid,
    *,
    name: str,
    finger_radius: float,
    noise: Noise,
    mass: float | None = None,
    table: Table | None = None,
    gravity: float = 9.81,
    finger_height: float | None = None,
    height: float | None = None,
    description: str = "",
) -> PushDataset:
    """Recorded trials as a dataset, unchecked; `dataset_from_arrays` checks arrays as files are checked.

    Args:
        trials: one or more.
        finger_radius: m.
        mass: of the object, if it was weighed, kg.
        gravity: m/s².
        finger_height: of the finger's lower end above the table, where known, m.
        height: of the object, where known, m.

    Raises:
        DatasetError: there is no trial, or a mass, radius or gravity that is not positive.
    """
    digest = hashlib.sha256(grid.centers.tobytes() + grid.edges.tobytes())
    for trial in trials:
        for channel in (trial.object_pose, trial.tip_pose, trial.ft_wrench, trial.tip_angle):
            if channel is not None:
                digest.update(channel.time.tobytes() + channel.values.tobytes())
    return PushDataset(
        name=name,
        description=description,
        grid=grid,
        height=height,
        mass=mass,
        finger_radius=finger_radius,
        finger_height=finger_height,
        table=table,
        gravity=gravity,
        noise=noise,
        trials=tuple(trials),
        fingerprint=digest.hexdigest(),
    )


def check_dataset_given(dataset: object) -> None:
    """Raise TypeError for something other than a dataset, such as the path of one."""
    source = _SOURCE
    if isinstance(dataset, list | tuple) and any(isinstance(one, PushDataset) for one in dataset):
        source += ", not several, which diagnose_together, fit_together and compare_together take"
    check_kind("dataset", dataset, PushDataset, source)


_SOURCE = "such as slipmap.read_dataset returns"


def check_datasets_given(datasets: object) -> None:
    """Raise TypeError for something other than a list of datasets, such as one of them or a path."""
    if isinstance(datasets, str) or not isinstance(datasets, Iterable):
        raise TypeError(f"datasets must be a list of datasets; got one {type(datasets).__name__}")
    for place, dataset in enumerate(datasets):
        check_kind(f"datasets[{place}]", dataset, PushDataset, _SOURCE)


def check_distinct(datasets: Sequence[PushDataset]) -> None:
    """Raise DatasetError where two datasets contain the same push, which would count twice."""
    owners: dict[bytes, str] = {}
    for dataset in datasets:
        for trial in dataset.trials:
            track = trial.object_pose.time.tobytes() + trial.object_pose.values.tobytes()
            owner = owners.setdefault(track, dataset.name)
            if owner != dataset.name:
                raise DatasetError(
                    f"datasets {owner} and {dataset.name} contain the same push ({trial.name}), which would"
                    " count twice; give every push once"
                )


def gaps(setup: Setup | Slider, tips: FloatArray, poses: FloatArray) -> FloatArray:
    """(k,) gap between the finger at (k, 2) and the outline at poses (k, 3) or (3,), m; negative inside."""
    points = shapely.points(seen_from(tips, np.broadcast_to(poses, (len(tips), 3))))
    rim = shapely.distance(setup.grid.polygon.boundary, points)
    return np.where(shapely.contains(setup.grid.polygon, points), -rim, rim) - setup.finger_radius
