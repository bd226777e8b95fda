"""What is known about an object after some pushes: hypotheses about its maps, with probabilities."""

from __future__ import annotations

import hashlib
import json
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slipmap.models.effects.effect import Effect, columns_of
from slipmap.models.effects.library import LIBRARY
from slipmap.models.files import UnreadableFile, check_archive, replaced_file
from slipmap.models.geometry import radius_of_gyration
from slipmap.models.measurements import PushDataset, Table
from slipmap.models.measurements.known_maps import known_document
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Maps, Slider, Smoothing

FORMAT = "slipmap-belief/1"
LARGEST_FILE = 2**29
"""Most bytes of an unpacked belief; 1000 hypotheses about 5000 cells take 80 MB."""

END_ERRORS = "end_errors"
"""Key under which a belief stores the `cross_validation.end_errors` of the pushes that taught it."""

RIVALS = "rivals"
"""Key under which a belief about rival sets of effects stores the share of each, see `identify`."""

OUTLINE_ERROR = "outline_error"
"""Key under which a belief stores how far its outline may be off, see `Noise.outline`."""

_PLAIN: dict[str, Callable[[Any], Any]] = {
    "finger_radius": float, "gravity": float, "dataset": str, "fingerprint": str, "method": str, "seed": int,
    "settings": dict, "versions": dict,
}  # fmt: skip
"""Fields of a belief that its file's description holds as they are."""

_ANEW = "write it again with `slipmap identify` or `slipmap fit`"

_DAMAGE = (
    OSError, ValueError, KeyError, TypeError, IndexError, AttributeError, EOFError, OverflowError,
    RuntimeError, MemoryError, struct.error, zlib.error, zipfile.BadZipFile, tokenize.TokenError, SyntaxError,
)  # fmt: skip
"""Errors that unpacking a damaged archive can raise."""


class BeliefError(ValueError):
    """A belief file that is damaged, of another kind, or does not match what it is used with."""


@dataclass(frozen=True, eq=False)
class Belief:
    """K hypotheses about one object and finger, weighted by probability.

    Attributes:
        grid: the object's cells and outline.
        finger_radius: m.
        gravity: m/s².
        maps: K mass and friction maps with finger frictions.
        probability: (K,) sums to one.
        smoothing: contact smoothing of the model with which the maps were found; predictions use the same.
        dataset: name of the dataset that taught it.
        fingerprint: hash of that dataset.
        method: `gauss-newton` or `paper`.
        seed: of every random draw.
        settings: everything else that shaped the result, JSON-serialisable.
        versions: of slipmap and of its numerical libraries.
        effects: effects in the model; the maps carry their parameters.
        table: the table on which the object was pushed, where known.
        true_poses: whether its model starts and ends with true poses, see `in_world`; files do not keep it.

    Example:
        >>> import tempfile
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=1, heldout=0)
        >>> belief = slipmap.identify(dataset, hypotheses=2, friction_laws=False).belief
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     belief.save(folder + "/belief.npz")
        ...     again = slipmap.Belief.load(folder + "/belief.npz")
        >>> len(again), again.maps.mass.shape
        (2, (2, 60))
    """

    grid: CellGrid
    finger_radius: float
    gravity: float
    maps: Maps
    probability: FloatArray
    smoothing: Smoothing
    dataset: str
    fingerprint: str
    method: str
    seed: int
    settings: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=lambda: library_versions())
    effects: tuple[Effect, ...] = ()
    table: Table | None = None
    true_poses: bool = False

    def __repr__(self) -> str:
        effects = f", effects {', '.join(effect.name for effect in self.effects)}" if self.effects else ""
        return (
            f"Belief(dataset {self.dataset!r}: {len(self)} hypotheses about {len(self.grid)} cells{effects})"
        )

    def __post_init__(self) -> None:
        if self.maps.mass.shape[1] != len(self.grid):
            cells = self.maps.mass.shape[1]
            raise BeliefError(f"belief: maps of {cells} cells on a grid of {len(self.grid)}")
        wanted = sum(len(effect.parameters) for effect in self.effects)
        if self.maps.effects.shape[1] != wanted:
            raise BeliefError(
                f"belief: the maps have {self.maps.effects.shape[1]} effect parameters, the effects {wanted}"
            )
        p = np.asarray(self.probability, dtype=float)
        numbers = p.shape == (len(self.maps),) and np.isfinite(p).all()
        if not numbers or (p < 0).any() or abs(p.sum() - 1) > 1e-6:
            raise BeliefError(
                "belief: probabilities must be one non-negative number per hypothesis and sum to 1"
            )
        object.__setattr__(self, "probability", p)

    @property
    def taught(self) -> int:
        """Number of pushes it was learned from; 0 where this was not recorded."""
        return len(self.settings.get("fit_trials", ()))

    @classmethod
    def learned(
        cls,
        dataset: PushDataset,
        slider: Slider,
        maps: Maps,
        probability: FloatArray,
        *,
        method: str,
        seed: int,
        trials: Sequence[str],
        settings: Mapping[str, Any],
    ) -> Belief:
        """A belief learned from pushes of a dataset, with its origin on record.

        Args:
            slider: the model, with its effects and its contact smoothing.
            maps: K hypotheses.
            probability: (K,) of the hypotheses.
            method: `gauss-newton` or `paper`.
            trials: names of the pushes that taught.
            settings: everything else that shaped the result.
        """
        return cls(
            grid=dataset.grid,
            finger_radius=dataset.finger_radius,
            gravity=dataset.gravity,
            maps=maps,
            probability=probability,
            smoothing=slider.smoothing,
            dataset=dataset.name,
            fingerprint=dataset.fingerprint,
            method=method,
            seed=int(seed),
            settings={
                "hypotheses": len(maps),
                "fit_trials": list(trials),
                "known_mass": dataset.mass,
                **({} if dataset.known is None else {"known_maps": known_document(dataset.known)}),
                **settings,
            },
            effects=slider.effects,
            table=slider.table,
        )

    def __len__(self) -> int:
        return len(self.maps)

    @property
    def slider(self) -> Slider:
        """The model that the maps belong to, with its effects, on its table."""
        return Slider(
            self.grid, self.finger_radius, self.gravity, self.smoothing, self.effects, self.table,
            self.true_poses,
        )  # fmt: skip

    def on(self, table: Table | None) -> Belief:
        """The same hypotheses for pushes on another table; None is a table whose rim is not known."""
        return self if table == self.table else replace(self, table=table)

    def in_world(self) -> Belief:
        """The same hypotheses about true poses, for planning: a table's rim is where it is, whatever the
        tracker reports."""
        return self if self.true_poses else replace(self, true_poses=True)

    def true_pose(self, reported: FloatArray) -> FloatArray:
        """(3,) expected true pose of an object at rest that the tracker reports at a pose (3,), world.

        The same pose, unless the model has effects of the tracker.
        """
        if self.true_poses or not self.effects:
            return reported
        by_hypothesis = self.slider.true_start_poses(self.maps, reported[None])[:, 0]
        return np.asarray(reported + self.probability @ (by_hypothesis - reported))

    def same_as(self, other: Belief | None) -> bool:
        """Whether another belief about the same object has the same hypotheses and effects, as a copy has."""
        if other is None or self is other:
            return self is other
        names = [[effect.name for effect in one.effects] for one in (self, other)]
        pairs = [(getattr(self.maps, name), getattr(other.maps, name)) for name in ("mass", "mu", "effects")]
        pairs += [(self.maps.mu_finger, other.maps.mu_finger), (self.probability, other.probability)]
        return names[0] == names[1] and all(np.array_equal(own, others) for own, others in pairs)

    @property
    def end_errors(self) -> FloatArray:
        """(J, 3) model error at the end of a push beyond the spread of the hypotheses: standard deviations of
        x, y (shares of the cells' travel) and θ (rad per metre of travel). The pushes leave open which of the
        J values is right, and they are equally likely; the smallest for place goes with the smallest for
        angle, and so on. Zero where not learned."""
        # Files of earlier versions hold a single value.
        place, turn = np.reshape(self.settings.get(END_ERRORS, [0.0, 0.0]), (2, -1))
        return np.stack([place, place, turn / radius_of_gyration(self.grid)], axis=1)

    @property
    def outline_error(self) -> float:
        """Standard deviation along x and y of where a finger touches the outline, m; 0 if it is exact."""
        return float(self.settings.get(OUTLINE_ERROR, 0.0))

    @property
    def centers_of_mass(self) -> FloatArray:
        """(K, 2) centre of mass of each hypothesis, object frame, m."""
        inertia = self.slider.inertia(self.maps.mass)
        return inertia[:, 1:3] / inertia[:, :1]

    @property
    def friction_forces(self) -> FloatArray:
        """(K,) friction force of the whole object in pure translation, Σ mu_i m_i g, N; if
        friction depends on the place by an effect (`Effect.level`), where its factor is 1."""
        return (self.maps.mass * self.maps.mu).sum(axis=1) * self.gravity

    def parameters_of(self, name: str) -> tuple[FloatArray, FloatArray]:
        """The parameters (H, P) of an effect, and the probabilities (H,), of the H hypotheses that have it.

        All have it, unless a rival may be there instead, see `identify`.

        Raises:
            ValueError: the model does not have the effect.
        """
        has = self.has(name)
        has = has if has.any() else np.ones(len(self), dtype=bool)
        (own,) = (columns_of(effect, self.effects) for effect in self.effects if effect.name == name)
        return self.maps.effects[has, own], self.probability[has] / self.probability[has].sum()

    def has(self, name: str) -> NDArray[np.bool_]:
        """(K,) whether each hypothesis has an effect: where it has rivals, those whose parameters are not all
        at their nulls; otherwise all.

        Raises:
            ValueError: the model does not have the effect.
        """
        effects = {effect.name: effect for effect in self.effects}
        if name not in effects:
            raise ValueError(f"belief: the model has no effect {name!r}, but {', '.join(effects) or 'none'}")
        if RIVALS not in self.settings:
            return np.ones(len(self), dtype=bool)
        values = self.maps.effects[:, columns_of(effects[name], self.effects)]
        return np.asarray((values != effects[name].nulls).any(axis=1))

    def save(self, path: str | Path) -> None:
        """Write to an `.npz` file, atomically.

        Raises:
            BeliefError: the folder does not exist or cannot be written.
        """
        path = Path(path)
        arrays = self._arrays()
        meta = {
            "format": FORMAT,
            **{name: getattr(self, name) for name in _PLAIN},
            "cell_width": self.grid.width,
            "holes": len(self.grid.holes),
            "smoothing": vars(self.smoothing),
            "effects": [effect.name for effect in self.effects],
            **({} if self.table is None else {"table": vars(self.table)}),
            "checksum": _checksum(arrays),
        }
        try:
            with replaced_file(path) as part, part.open("wb") as stream:
                np.savez_compressed(stream, meta=np.array(json.dumps(meta)), **arrays)  # type: ignore[arg-type]
        except OSError as error:
            raise BeliefError(f"cannot write the belief to {path}: {error.strerror or error}") from error

    def _arrays(self) -> dict[str, FloatArray]:
        return {
            "centers": self.grid.centers,
            "exterior": self.grid.exterior,
            "mass": self.maps.mass,
            "mu": self.maps.mu,
            "mu_finger": self.maps.mu_finger,
            "probability": self.probability,
            **({"effects": self.maps.effects} if self.effects else {}),
            **{f"hole_{i}": hole for i, hole in enumerate(self.grid.holes)},
        }

    @classmethod
    def load(cls, path: str | Path, known: Sequence[Effect] = LIBRARY) -> Belief:
        """Read a belief file.

        Args:
            known: effects that it may carry; the file holds their names and parameters, not their formulas.

        Raises:
            BeliefError: the file is missing, not a belief, damaged, of another format, or carries an unknown
                effect.
        """
        path = Path(path)
        if path.is_dir():
            inside = sorted(path.glob("*.npz"))
            hint = f"; did you mean {inside[0]}?" if inside else ""
            raise BeliefError(f"{path} is a folder, but a belief is a file{hint}")
        if not path.is_file():
            raise BeliefError(
                f"there is no belief file {path}; make one with `slipmap identify DATASET -o {path.name}`"
            )
        if not zipfile.is_zipfile(path):
            raise BeliefError(f"{path} is not a readable belief file: it is not an .npz archive; {_ANEW}")
        try:
            check_archive(path, LARGEST_FILE)
            with np.load(path, allow_pickle=False) as archive:
                if "meta" not in archive.files:
                    raise BeliefError(f"{path} is not a belief file: it contains no description; {_ANEW}")
                meta = json.loads(str(archive["meta"]))
                if not isinstance(meta, dict) or meta.get("format") != FORMAT:
                    found = meta.get("format") if isinstance(meta, dict) else None
                    raise BeliefError(
                        f"{path} has format {found!r}, but this version reads {FORMAT!r}; {_ANEW}"
                    )
                holes = [f"hole_{i}" for i in range(int(meta["holes"]))]
                carried = [str(name) for name in meta.get("effects", [])]
                names = ["centers", "exterior", "mass", "mu", "mu_finger", "probability", *holes]
                arrays = {name: archive[name] for name in (*names, *(["effects"] if carried else []))}
            if _checksum(arrays) != meta["checksum"]:
                raise BeliefError(f"{path} is damaged: its numbers do not match their checksum; {_ANEW}")
            by_name = {effect.name: effect for effect in known}
            for name in carried:
                if name not in by_name:
                    raise BeliefError(
                        f"{path} carries the effect {name!r}, which the library does not have; give the file"
                        " that defines it with --effect-file (in Python"
                        " known=(*slipmap.LIBRARY, *slipmap.load_effects(FILE)))"
                    )
            width, outline = float(meta["cell_width"]), arrays["exterior"]
            return cls(
                grid=CellGrid(arrays["centers"], width, outline, tuple(arrays[hole] for hole in holes)),
                maps=Maps(
                    arrays["mass"], arrays["mu"], arrays["mu_finger"], arrays.get("effects", np.zeros((0, 0)))
                ),
                probability=arrays["probability"],
                smoothing=Smoothing(**meta["smoothing"]),
                **{name: kind(meta[name]) for name, kind in _PLAIN.items()},
                effects=tuple(by_name[name] for name in carried),
                table=_table_of(meta.get("table")),
            )
        except BeliefError:
            raise
        except UnreadableFile as error:
            raise BeliefError(f"{path}: {error}") from error
        except _DAMAGE as error:
            raise BeliefError(f"{path} is not a readable belief file ({error}); {_ANEW}") from error


def _table_of(written: dict[str, Any] | None) -> Table | None:
    """The table stored in a belief file, checked; older files have none."""
    if written is None:
        return None
    center, size = [float(value) for value in written["center"]], written["size"]
    return Table(
        "round" if written["shape"] == "round" else "rectangle",
        (center[0], center[1]),
        None if written["radius"] is None else float(written["radius"]),
        None if size is None else (float(size[0]), float(size[1])),
    )


def _checksum(arrays: dict[str, FloatArray]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name}{array.dtype.str}{array.shape}".encode() + array.tobytes())
    return digest.hexdigest()


def library_versions() -> dict[str, str]:
    """Versions of slipmap and of its numerical libraries."""
    versions = {}
    for name in ("slipmap", "numpy", "scipy", "numba"):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return versions
