"""Roll out many models times many pushes, with exact sensitivities if wanted: door to the compiled kernel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate

import numpy as np
from numpy.typing import ArrayLike, NDArray

from models.physics.cell_grid import CellGrid
from models.physics.kernel import rollout_all, rollout_one
from models.physics.step import EXTRA_COLUMNS

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Smoothing:
    """Where the model is softer than Coulomb's law; small enough not to show in a push.

    Attributes:
        slip_speed: ε of the friction norm, m/s; below it base friction acts like a viscous hold.
        stick_speed: creep of a sticking finger contact under the object's whole friction load, m/s.
        penetration: depth to which the finger sinks in under the object's whole friction load, m.
    """

    slip_speed: float = 1e-5
    stick_speed: float = 1e-5
    penetration: float = 1e-5

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"smoothing: {name} must be positive and finite, got {value}")


@dataclass(frozen=True, eq=False)
class Push:
    """What drives the object for N steps of length h, and when to look.

    Attributes:
        h: step, s.
        tip: (N + 1, 2) finger centre at the ends of the steps, world, m; NaN where there is no finger.
        start_pose: (3,) x, y, θ in the world.
        start_twist: (3,) v_x, v_y, omega in the object frame.
        pose_times: (S,) ascending times from the start at which poses are wanted, s; default ends of steps.
        force_times: (T,) the same for the contact force (the mean over the step that holds the time).
        wrench: (N, 5) applied force (world, N), its point (object frame, m) and a torque (N m), or None.

    Raises:
        ValueError: shapes that do not fit, a step that is not positive, times that lie outside the push or
            do not ascend.
    """

    h: float
    tip: FloatArray
    start_pose: FloatArray
    start_twist: FloatArray = field(default_factory=lambda: np.zeros(3))
    pose_times: FloatArray | None = None
    force_times: FloatArray = field(default_factory=lambda: np.zeros(0))
    wrench: FloatArray | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.h) and self.h > 0):
            raise ValueError(f"push: the step h must be positive, got {self.h} s")
        tip = np.ascontiguousarray(self.tip, dtype=float)
        if tip.ndim != 2 or tip.shape[1] != 2 or len(tip) < 2:
            raise ValueError(f"push: tip must have shape (N + 1, 2) with at least one step, got {tip.shape}")
        absent = np.isnan(tip).all(axis=1)
        if not np.isfinite(tip[~absent]).all():
            row = int(np.flatnonzero(~absent & ~np.isfinite(tip).all(axis=1))[0])
            raise ValueError(
                f"push: tip must be finite, or NaN in both columns; row {row} is {tip[row].tolist()}"
            )
        object.__setattr__(self, "tip", tip)
        steps = len(tip) - 1
        for name in ("start_pose", "start_twist"):
            value = np.ascontiguousarray(getattr(self, name), dtype=float)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise ValueError(f"push: {name} must be three finite numbers, got {value}")
            object.__setattr__(self, name, value)
        if self.pose_times is None:
            object.__setattr__(self, "pose_times", self.h * np.arange(1, steps + 1))
        for name in ("pose_times", "force_times"):
            value = np.ascontiguousarray(getattr(self, name), dtype=float)
            end = steps * self.h * (1 + 1e-9)
            ascending = value.ndim == 1 and bool(np.all(np.diff(value) >= 0))
            if not ascending or (len(value) and not (value[0] >= 0 and value[-1] <= end)):
                raise ValueError(
                    f"push: {name} must be one row of times that ascend within 0 and {end:.6g} s"
                )
            object.__setattr__(self, name, value)
        if self.wrench is not None:
            wrench = np.ascontiguousarray(self.wrench, dtype=float)
            if wrench.shape != (steps, 5):
                raise ValueError(f"push: wrench must have shape ({steps}, 5), got {wrench.shape}")
            if not np.isfinite(wrench).all():
                row = int(np.flatnonzero(~np.isfinite(wrench).all(axis=1))[0])
                raise ValueError(f"push: wrench must be finite; row {row} is {wrench[row].tolist()}")
            object.__setattr__(self, "wrench", wrench)

    @cached_property
    def pose_samples(self) -> tuple[NDArray[np.int64], FloatArray]:
        """(S,) step in whose course each pose time falls, and (S,) the place in it, 0 to 1."""
        return _sample_steps(self.h, len(self.tip) - 1, self.pose_times)

    @cached_property
    def force_steps(self) -> NDArray[np.int64]:
        """(T,) step in whose course each force time falls."""
        return _sample_steps(self.h, len(self.tip) - 1, self.force_times)[0]

    @classmethod
    def by_force(
        cls,
        force: ArrayLike,
        point: ArrayLike,
        *,
        duration: float,
        steps: int,
        h: float,
        start_pose: ArrayLike = (0.0, 0.0, 0.0),
        start_twist: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Push:
        """Constant world force (2,) N on an object-frame point (2,) m for `duration` s, then none.

        Raises:
            ValueError: force or point are not pairs, or the duration is not within the push.
        """
        if not (np.isfinite(h) and h > 0):
            raise ValueError(f"push: the step h must be positive, got {h} s")
        if not 0 <= duration <= steps * h * (1 + 1e-9):
            raise ValueError(f"push: duration must lie within 0 and {steps * h:.6g} s, got {duration}")
        for name, pair in (("force", force), ("point", point)):
            if np.shape(pair) != (2,):
                raise ValueError(f"push: {name} must be a pair (x, y), got {pair!r}")
        wrench = np.zeros((steps, 5))
        wrench[: round(duration / h), :4] = [*np.asarray(force), *np.asarray(point)]
        nowhere = np.full((steps + 1, 2), np.nan)
        return cls(h, nowhere, np.asarray(start_pose), np.asarray(start_twist), wrench=wrench)


@dataclass(frozen=True, eq=False)
class Maps:
    """K hypotheses about the object.

    Attributes:
        mass: (K, n) cell masses, kg.
        mu: (K, n) friction coefficients with the table.
        mu_finger: (K,) friction coefficients with the finger.
    """

    mass: FloatArray
    mu: FloatArray
    mu_finger: FloatArray

    def __post_init__(self) -> None:
        mass = np.atleast_2d(np.ascontiguousarray(self.mass, dtype=float))
        mu = np.atleast_2d(np.ascontiguousarray(self.mu, dtype=float))
        finger = np.atleast_1d(np.ascontiguousarray(self.mu_finger, dtype=float))
        if mass.ndim != 2 or mass.shape != mu.shape or finger.shape != (len(mass),):
            raise ValueError(
                f"maps: mass {mass.shape} and mu {mu.shape} need one shape (K, n), mu_finger "
                f"{finger.shape} one number a map"
            )
        for name, value in (("mass", mass), ("mu", mu), ("mu_finger", finger)):
            if not np.isfinite(value).all() or (value < 0).any():
                raise ValueError(f"maps: {name} must be finite and not negative")
        if not (mass.sum(axis=1) > 0).all():
            raise ValueError("maps: the total mass must be positive")
        object.__setattr__(self, "mass", mass)
        object.__setattr__(self, "mu", mu)
        object.__setattr__(self, "mu_finger", finger)

    def __len__(self) -> int:
        return len(self.mass)

    def __getitem__(self, index: int | slice | NDArray[np.integer]) -> Maps:
        return Maps(self.mass[index], self.mu[index], np.atleast_1d(self.mu_finger[index]))


@dataclass(frozen=True, eq=False)
class Rollouts:
    """Results for K models and B pushes; samples of all pushes are joined, `poses_of(b)` takes one push.

    Attributes:
        poses: (K, S, 3) world poses at the pushes' `pose_times`.
        forces: (K, T, 2) force of the finger on the object, world, N.
        end: (K, B, 6) last pose (world) and twist (object frame).
        evaluations: (K, B) evaluations of the step's function.
        pose_at: (B + 1,) offsets of the pushes in S.
        force_at: (B + 1,) the same in T.
        d_poses: (K, S, 3, P) derivative by the reduced columns (`ReducedColumns`), empty if not asked for.
        d_forces: (K, T, 2, P) the same for the forces.
    """

    poses: FloatArray
    forces: FloatArray
    end: FloatArray
    evaluations: NDArray[np.int64]
    pose_at: NDArray[np.int64]
    force_at: NDArray[np.int64]
    d_poses: FloatArray
    d_forces: FloatArray

    def poses_of(self, push: int) -> FloatArray:
        """(K, S_b, 3) poses of one push."""
        return self.poses[:, self.pose_at[push] : self.pose_at[push + 1]]

    def forces_of(self, push: int) -> FloatArray:
        """(K, T_b, 2) forces of one push."""
        return self.forces[:, self.force_at[push] : self.force_at[push + 1]]


class RolloutError(ArithmeticError):
    """A step's convex problem was not solved to its tolerance."""


class Slider:
    """The cell-grid model of one object under one finger.

    Args:
        grid: cells and outline.
        finger_radius: m.
        gravity: m/s².
        smoothing: see `Smoothing`.
    """

    def __init__(
        self, grid: CellGrid, finger_radius: float, gravity: float = 9.81, smoothing: Smoothing | None = None
    ) -> None:
        if not (np.isfinite(finger_radius) and finger_radius > 0):
            raise ValueError(f"finger radius must be a positive length in m, got {finger_radius}")
        if not (np.isfinite(gravity) and gravity > 0):
            raise ValueError(f"gravity must be positive, got {gravity} m/s²")
        self.grid = grid
        self.finger_radius = float(finger_radius)
        self.gravity = float(gravity)
        self.smoothing = smoothing or Smoothing()
        s = self.smoothing
        self._centers = np.ascontiguousarray(grid.centers.T)
        self._smoothing = np.array([s.slip_speed, s.stick_speed, s.penetration])
        self._size = float(np.linalg.norm(grid.exterior, axis=1).max())

    @property
    def columns(self) -> int:
        """P: number of reduced parameters a rollout is differentiated by."""
        return len(self.grid) + EXTRA_COLUMNS

    def inertia(self, mass: FloatArray) -> FloatArray:
        """(…, 4) m, s_x, s_y, J of mass maps (…, n), with I_i = m_i w²/6 as in the paper."""
        return mass @ self.inertia_basis

    @cached_property
    def inertia_basis(self) -> FloatArray:
        """(n, 4) what one kilogram in each cell adds to m, s_x, s_y, J."""
        r = self.grid.centers
        second = (r**2).sum(axis=1) + self.grid.width**2 / 6.0
        return np.column_stack([np.ones(len(r)), r, second])

    def map_columns(self, maps: Maps, d_reduced: FloatArray) -> FloatArray:
        """Turn derivatives by reduced columns (K, …, P) into derivatives by the maps.

        With f_i = mu_i m_i g:  d/dm_i = mu_i g d/df_i + Σ_c (∂inertia_c/∂m_i) d/dinertia_c  and
        d/dmu_i = m_i g d/df_i.

        Returns:
            (K, …, 2n + 7) by mass (n), mu (n), finger friction, start pose (3) and start twist (3).
        """
        n = len(self.grid)
        shape = (len(maps),) + (1,) * (d_reduced.ndim - 2) + (n,)
        by_load = d_reduced[..., :n]
        by_mass = by_load * (maps.mu * self.gravity).reshape(shape)
        by_mass += d_reduced[..., n : n + 4] @ self.inertia_basis.T
        by_mu = by_load * (maps.mass * self.gravity).reshape(shape)
        return np.concatenate([by_mass, by_mu, d_reduced[..., n + 4 :]], axis=-1)

    def rollout(
        self,
        maps: Maps,
        pushes: Sequence[Push],
        *,
        sensitivities: bool = False,
        start_poses: FloatArray | None = None,
        start_twists: FloatArray | None = None,
    ) -> Rollouts:
        """Simulate every model under every push.

        Args:
            maps: K models.
            pushes: B pushes.
            sensitivities: also differentiate by the reduced columns.
            start_poses: (K, B, 3) instead of the pushes' own starts.
            start_twists: (K, B, 3) instead of the pushes' own starts, object frame.

        Raises:
            ValueError: maps of another grid.
            RolloutError: a step was not solved; names the model and the push.
        """
        n = len(self.grid)
        if maps.mass.shape[1] != n:
            raise ValueError(f"maps have {maps.mass.shape[1]} cells, the grid has {n}")
        K, B = len(maps), len(pushes)
        if B == 0:
            raise ValueError("rollout: needs at least one push")
        for name, value in (("start_poses", start_poses), ("start_twists", start_twists)):
            if value is not None and (np.shape(value) != (K, B, 3) or not np.isfinite(value).all()):
                raise ValueError(
                    f"rollout: {name} must be finite and of shape ({K}, {B}, 3), got {np.shape(value)}"
                )
        load = np.ascontiguousarray(maps.mass * maps.mu * self.gravity)
        if not (load.sum(axis=1) > 0).all():
            raise ValueError("maps: a model without any friction cannot be simulated")
        samples = [push.pose_samples for push in pushes]
        force_steps = [push.force_steps for push in pushes]
        sample_at = _offsets([len(s) for s, _ in samples])
        force_at = _offsets([len(s) for s in force_steps])
        wrenches = [_NO_WRENCH if push.wrench is None else push.wrench for push in pushes]
        if start_poses is None:
            start_poses = _of_all_models([p.start_pose for p in pushes], K)
        if start_twists is None:
            start_twists = _of_all_models([p.start_twist for p in pushes], K)
        columns = self.columns if sensitivities else 0
        poses = np.empty((K, sample_at[-1], 3))
        forces = np.empty((K, force_at[-1], 2))
        d_poses = np.empty((K, sample_at[-1], 3, columns))
        d_forces = np.empty((K, force_at[-1], 2, columns))
        end = np.empty((K, B, 7))
        arguments = (
            load, self._centers[0], self._centers[1], self.inertia(maps.mass), maps.mu_finger,
            self.grid.width, self.grid.edges, self.finger_radius, self._size, self._smoothing,
            np.array([push.h for push in pushes]),
            np.concatenate([push.tip for push in pushes]), _offsets([len(push.tip) for push in pushes]),
            np.concatenate(wrenches), _offsets([len(w) for w in wrenches]),
            np.ascontiguousarray(start_poses, dtype=float), np.ascontiguousarray(start_twists, dtype=float),
            np.concatenate([s for s, _ in samples]), np.concatenate([f for _, f in samples]), sample_at,
            np.concatenate(force_steps), force_at, poses, forces, d_poses, d_forces, end,
        )  # fmt: skip
        # A single job is not worth waking the other threads.
        if K * B == 1:
            rollout_one(0, *arguments)
        else:
            rollout_all(*arguments)
        if not (np.isfinite(end).all() and end[..., 6].min() >= 0):
            model, push = np.argwhere((end[..., 6] < 0) | ~np.isfinite(end).all(axis=-1))[0]
            raise RolloutError(f"model {model}, push {push}: a step did not converge")
        return Rollouts(
            poses,
            forces,
            end[..., :6],
            end[..., 6].astype(np.int64),
            sample_at,
            force_at,
            d_poses,
            d_forces,
        )


def _sample_steps(h: float, steps: int, times: FloatArray | None) -> tuple[NDArray[np.int64], FloatArray]:
    """Step in whose course each time falls, and the place in it (0 to 1)."""
    assert times is not None
    index = np.clip(np.ceil(times / h - 1e-9).astype(np.int64) - 1, 0, steps - 1)
    return index, np.clip(times / h - index, 0.0, 1.0)


def _offsets(lengths: Sequence[int]) -> NDArray[np.int64]:
    return np.array([0, *accumulate(lengths)], dtype=np.int64)


def _of_all_models(starts: Sequence[FloatArray], models: int) -> FloatArray:
    """(models, B, 3) the same starts (B of (3,)) for each model."""
    return np.repeat(np.array([starts]), models, axis=0)


_NO_WRENCH = np.zeros((0, 5))
