"""Rollouts of many models under many pushes, with exact sensitivities on request."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slipmap.models.effects.effect import Effect
from slipmap.models.effects.program import Program, program_of
from slipmap.models.effects.registry import effects_given
from slipmap.models.geometry import placed
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.physics.balance import corners_of
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.friction import CONSTANTS
from slipmap.models.physics.kernel import loads_at, rollout_all
from slipmap.models.physics.kernel_tools import (
    Common,
    Formulas,
    JoinedPushes,
    ReducedMaps,
    Results,
    empty_results,
)
from slipmap.models.physics.maps import Maps
from slipmap.models.physics.pushes import Push, join_pushes
from slipmap.models.physics.sensors import Sensors, clear_unreached
from slipmap.models.physics.step import EXTRA_COLUMNS, INERTIA_COLUMNS
from slipmap.models.physics.support import FIRST_FORCE, FIRST_POSE, REACHED, RIM_RESULTS, TIPS
from slipmap.models.settings import check_finger_radius


@dataclass(frozen=True)
class Smoothing:
    """Constants that soften Coulomb's law, too small to show in a push."""

    slip_speed: float = 1e-5  # ε of the friction norm, m/s; slower slip meets viscous base friction
    # creep speed of a sticking finger contact under the object's full friction load, m/s
    stick_speed: float = 1e-5
    penetration: float = 1e-5  # depth to which the object's full friction load presses the finger in, m
    # time constant with which a compressed contact springs back against its own damping alone, s; at about
    # 2 sqrt(penetration / (mu g)) a struck object stays on the finger
    relaxation: float = 4e-3

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"smoothing: {name} must be positive and finite, got {value}")


@dataclass(frozen=True, eq=False)
class Rollouts:
    """Results for K models and B pushes; samples of all pushes are joined, `poses_of(b)` returns one push."""

    poses: FloatArray  # (K, S, 3) world poses at the pushes' `pose_times`
    forces: FloatArray  # (K, T, 2) force of the finger on the object, world, N
    end: FloatArray  # (K, B, 6) last pose (world) and twist (object frame)
    evaluations: NDArray[np.int64]  # (K, B) evaluations of the function that a step minimises
    pose_at: NDArray[np.int64]  # (B + 1,) offsets of the pushes in S
    force_at: NDArray[np.int64]  # (B + 1,) the same in T
    # (K, S, 3, P) derivatives, empty unless requested. Reduced columns: friction loads (n), m, s_x, s_y, J,
    # finger friction, start pose (3), start twist (3) and the effects' parameters. If any push came near the
    # table's rim, n more follow: the cell masses, as far as they shift the loads.
    d_poses: FloatArray
    d_forces: FloatArray  # (K, T, 2, P) the same for the forces
    # (K, B) time from the push's start at which the object first tips over the rim, s; infinite where it does
    # not, or without a table. Later poses are not to be trusted.
    tips: FloatArray
    # (K, B) whether the object came so near the rim that cells may have been beyond it
    reached: NDArray[np.bool_]

    def __repr__(self) -> str:
        return f"Rollouts(models: {self.end.shape[0]}, pushes: {self.end.shape[1]})"

    @property
    def tipped(self) -> NDArray[np.bool_]:
        """(K, B) whether the object tips over the rim."""
        return np.isfinite(self.tips)

    def poses_of(self, push: int) -> FloatArray:
        """(K, S_b, 3) poses of one push."""
        return self.poses[:, _rows(self.pose_at, push)]

    def forces_of(self, push: int) -> FloatArray:
        """(K, T_b, 2) forces of one push."""
        return self.forces[:, _rows(self.force_at, push)]

    def d_poses_of(self, push: int) -> FloatArray:
        """(K, S_b, 3, P) derivatives of the poses of one push."""
        return self.d_poses[:, _rows(self.pose_at, push)]


def _rows(at: NDArray[np.int64], push: int) -> slice:
    """Where the rows of one push are; -1 is the last push, as in a list."""
    begin = range(len(at) - 1)[push]
    return slice(at[begin], at[begin + 1])


class RolloutError(ArithmeticError):
    """A step's convex problem was not solved to tolerance."""


class Slider:
    """The cell-grid model of one object under one finger, with or without effects.

    Maps carry the parameters of the effects; maps without them switch all effects off. Start poses and
    resulting poses are those that the tracker reports, since a tracker that is off or late is an effect too.

    Args:
        grid: cells and outline.
        finger_radius: m.
        gravity: m/s².
        smoothing: see `Smoothing`.
        effects: in the order of the columns of `Maps.effects`; those of the library may be given by name.
        table: the table top. Cells beyond its rim carry no load and the others carry all of it, see
            `support.py`. Without a table every cell is supported everywhere.
        true_poses: whether start poses and resulting poses are true ones, whatever the tracker reports.

    Attributes:
        program: compiled formulas of the effects, None if there are none.

    Raises:
        EffectError: an unknown effect, one given twice, or a formula that cannot be used.
        ValueError: a number is not positive, or the finger is over half a metre thick.

    Example:
        >>> import numpy as np
        >>> import slipmap
        >>> grid, truth = slipmap.hammer()
        >>> push = slipmap.candidate_pushes(grid, 0.008, np.random.default_rng(0), 1)[0].push([0, 0, 0])
        >>> rollouts = slipmap.Slider(grid, finger_radius=0.008).rollout(truth, [push])
        >>> rollouts.end.shape
        (1, 1, 6)
    """

    program: Program | None

    def __init__(
        self,
        grid: CellGrid,
        finger_radius: float,
        gravity: float = 9.81,
        smoothing: Smoothing | None = None,
        effects: Sequence[Effect | str] = (),
        table: Table | None = None,
        true_poses: bool = False,
    ) -> None:
        check_finger_radius("finger radius", finger_radius)
        if not (np.isfinite(gravity) and gravity > 0):
            raise ValueError(f"gravity must be positive, got {gravity} m/s²")
        self.grid = grid
        self.finger_radius = float(finger_radius)
        self.gravity = float(gravity)
        self.smoothing = smoothing or Smoothing()
        size = float(np.linalg.norm(grid.exterior, axis=1).max())
        smooth = np.array([*vars(self.smoothing).values()])
        rx, ry = np.ascontiguousarray(grid.centers.T)
        common = Common(rx, ry, float(grid.width), grid.edges, self.finger_radius, size, smooth)
        self._common = tuple(common)
        self.effects = effects_given(effects)
        self.program = program_of(self.effects) if self.effects else None
        self.true_poses = true_poses
        if true_poses and self.program is not None:
            self.program = replace(self.program, measured=None, delay=None)
        self.table = table
        self._top = None if table is None else _top_of(table)

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle without the machine code, whose addresses mean nothing in another process."""
        return Slider, (
            self.grid, self.finger_radius, self.gravity, self.smoothing, self.effects, self.table,
            self.true_poses,
        )  # fmt: skip

    def on(self, table: Table | None) -> Slider:
        """The same model on another table, or on a floor without a rim."""
        if table == self.table:
            return self
        return Slider(
            self.grid, self.finger_radius, self.gravity, self.smoothing, self.effects, table, self.true_poses
        )

    def true_start_poses(self, maps: Maps, poses: FloatArray) -> FloatArray:
        """(K, B, 3) true poses of an object that the tracker reports, at rest, at poses (B, 3), world."""
        reported = np.repeat(np.asarray(poses, dtype=float)[None], len(maps), axis=0)
        if self.program is None:
            return reported
        return Sensors.of(self.program, self._effect_values(maps)).true_starts(reported).poses

    @property
    def columns(self) -> int:
        """P: number of reduced columns away from the table's rim; the effects' parameters come last."""
        return len(self.grid) + EXTRA_COLUMNS + len(self.nulls)

    @cached_property
    def nulls(self) -> FloatArray:
        """(…,) parameter values at which the effects vanish."""
        return np.concatenate([np.zeros(0), *(effect.nulls for effect in self.effects)])

    def inertia(self, mass: FloatArray) -> FloatArray:
        """(…, 4) m, s_x, s_y, J of mass maps (…, n); each cell has I_i = m_i w²/6, as in the paper."""
        return mass @ self.inertia_basis

    @cached_property
    def inertia_basis(self) -> FloatArray:
        """(n, 4) what one kilogram in each cell adds to m, s_x, s_y, J."""
        r = self.grid.centers
        second = (r**2).sum(axis=1) + self.grid.width**2 / 6.0
        return np.column_stack([np.ones(len(r)), r, second])

    def loads(self, maps: Maps, poses: FloatArray) -> FloatArray:
        """(K, G, n) normal forces N_i between cells and table, N, for objects at world poses (G, 3).

        Without a table each cell carries its own weight.
        """
        poses = np.ascontiguousarray(np.atleast_2d(poses), dtype=float)
        factors = np.ones((len(maps), len(poses), len(self.grid)))
        if self._top is not None:
            loads_at(self._common, self._reduced(maps), self._top, poses, factors)
        return self.gravity * maps.mass[:, None] * factors

    def map_columns(self, maps: Maps, d_reduced: FloatArray) -> FloatArray:
        """Convert derivatives from reduced columns (K, …, P or P + n) to the columns of the maps.

        With f_i = mu_i m_i g:  d/dm_i = mu_i g d/df_i + Σ_c (∂inertia_c/∂m_i) d/dinertia_c, plus the term of
        shifting loads if there is one, and  d/dmu_i = m_i g d/df_i.

        Returns:
            (K, …, 2n + 7 + …) derivatives with respect to mass (n), mu (n), finger friction, start pose (3),
            start twist (3) and the effects' parameters.
        """
        return self._map_columns(maps, d_reduced[..., : self.columns], d_reduced[..., self.columns :])

    def _map_columns(self, maps: Maps, d_reduced: FloatArray, by_shift: FloatArray) -> FloatArray:
        """Do the same with the masses' effect through shifting loads apart: (K, …, n), or no columns."""
        n = len(self.grid)
        shape = (len(maps),) + (1,) * (d_reduced.ndim - 2) + (n,)
        by_load = d_reduced[..., :n]
        by_mass = by_load * (maps.mu * self.gravity).reshape(shape)
        by_mass += d_reduced[..., n : n + INERTIA_COLUMNS] @ self.inertia_basis.T
        if by_shift.shape[-1]:
            by_mass += by_shift
        by_mu = by_load * (maps.mass * self.gravity).reshape(shape)
        return np.concatenate([by_mass, by_mu, d_reduced[..., n + INERTIA_COLUMNS :]], axis=-1)

    def rollout(
        self,
        maps: Maps,
        pushes: Sequence[Push],
        *,
        sensitivities: bool = False,
        start_poses: FloatArray | None = None,
        start_twists: FloatArray | None = None,
        table_poses: FloatArray | None = None,
    ) -> Rollouts:
        """Simulate every model under every push.

        Args:
            maps: K models.
            pushes: B pushes.
            sensitivities: whether to differentiate with respect to the reduced columns.
            start_poses: (K, B, 3) instead of the pushes' own starts.
            start_twists: (K, B, 3) instead of the pushes' own starts, object frame.
            table_poses: (K, B, 3) pose of the table's world frame in that of the pushes, for each model and
                push; by default the two frames coincide.

        Returns:
            Of K models and B pushes: `poses_of(b)` is (K, S, 3), x, y (m) and theta (rad) in the world at the
            `pose_times` of push b; `forces_of(b)` is (K, T, 2), force of the finger on the object in the
            world at its `force_times`, N; `end` is (K, B, 6), last pose and twist (object frame; m/s, rad/s).

        Raises:
            TypeError: something else than a list of pushes.
            ValueError: maps for a different grid, or table poses of the wrong shape.
            RolloutError: a step was not solved; names the model and the push.
        """
        joined = join_pushes(pushes, len(maps), start_poses, start_twists)
        columns = self.columns if sensitivities else 0
        tables = self._top if table_poses is None else self._tables(table_poses, (len(maps), len(pushes), 3))
        rim, masses = (0, 0) if self._top is None else (RIM_RESULTS, len(self.grid) if sensitivities else 0)
        if self.program is None:
            results = empty_results(len(maps), joined, columns, False, rim, masses)
            rollout_all(self._common, self._reduced(maps), joined, None, tables, results)
        else:
            order = [push.order for push in pushes]
            results = self._with_effects(self.program, maps, joined, order, tables, columns, rim, masses)
        return _finished(joined, results)

    def _tables(self, poses: FloatArray, shape: tuple[int, ...]) -> FloatArray | None:
        """(K, B, 7) tables, as kernels take them, with their world frame at poses (K, B, 3)."""
        if np.shape(poses) != shape or not np.isfinite(poses).all():
            raise ValueError(
                f"rollout: table_poses must be finite and of shape {shape}, got {np.shape(poses)}"
            )
        if self._top is None:
            return None
        tables = np.repeat(np.repeat(self._top, shape[0], axis=0), shape[1], axis=1)
        tables[..., :2] = placed(tables[..., :2], poses)
        tables[..., 5], tables[..., 6] = np.cos(poses[..., 2]), np.sin(poses[..., 2])
        return tables

    def _effect_values(self, maps: Maps) -> FloatArray:
        """(K, …) parameters of the effects; checks that the maps match them."""
        values, nulls = maps.effects, self.nulls
        if values.shape[1] == 0:
            return np.repeat(nulls[None], len(maps), axis=0)
        if values.shape[1] != len(nulls):
            names = ", ".join(effect.name for effect in self.effects)
            owner = f"effects {names} have" if names else "model has"
            raise ValueError(f"maps have {values.shape[1]} effect parameters, the {owner} {len(nulls)}")
        return values

    def _with_effects(
        self,
        program: Program,
        maps: Maps,
        joined: JoinedPushes,
        order: Sequence[float],
        tables: FloatArray | None,
        columns: int,
        rim: int,
        masses: int,
    ) -> Results:
        """Simulate with effects; `order` as in `Push`, `tables` as kernels take them, sizes as in
        `empty_results`."""
        values = np.ascontiguousarray(self._effect_values(maps))
        sensors = Sensors.of(program, values)
        starts = sensors.true_starts(joined.start_poses)
        true = sensors.with_steps_before(joined)._replace(start_poses=starts.poses)
        rates = program.delay is not None and columns > 0
        results = empty_results(len(maps), true, columns, rates, rim, masses)
        formulas = Formulas(
            program.addresses, program.sizes, self._constants(joined.h, order), values, sensors.delays
        )
        rollout_all(self._common, self._reduced(maps), true, formulas, tables, results)
        return sensors.reported(results, true, joined, starts, len(self.grid))

    def _constants(self, h: ArrayLike, order: ArrayLike) -> FloatArray:
        """(B, CONSTANTS) for pushes with steps h (B,) and indices `order` (B,); time is 0."""
        centers = self.grid.centers
        centroid = centers.mean(axis=0)
        arms = centers - centroid
        second = arms.T @ arms / len(arms) + np.eye(2) * self.grid.width**2 / 12.0
        inverse = np.linalg.inv(second)
        shared = [self.gravity, self.grid.width, *centroid, inverse[0, 0], inverse[0, 1], inverse[1, 1]]
        result = np.empty((np.size(h), CONSTANTS))
        result[:, 0], result[:, 1], result[:, 2] = 0.0, h, order
        result[:, 3:] = [*shared, float(len(centers))]
        return result

    def _reduced(self, maps: Maps) -> tuple[FloatArray, ...]:
        """Fields of `ReducedMaps`; checks that the maps fit the grid."""
        if maps.mass.shape[1] != len(self.grid):
            raise ValueError(f"maps have {maps.mass.shape[1]} cells, the grid has {len(self.grid)}")
        load = np.ascontiguousarray(maps.mass * maps.mu * self.gravity)
        if not (load.sum(axis=1) > 0).all():
            raise ValueError("maps: a model without any friction cannot be simulated")
        mass = maps.mass[:, :0] if self._top is None else maps.mass
        return tuple(ReducedMaps(load, self.inertia(maps.mass), maps.mu_finger, np.ascontiguousarray(mass)))


def _top_of(table: Table) -> FloatArray:
    """(1, 1, 7) centre, radius, half sides, cosine and sine of a table, see `Rim.top`."""
    corners = corners_of(table)
    if len(corners) == 0:
        return np.array([[[*table.center, float(table.radius or 0.0), 0.0, 0.0, 1.0, 0.0]]])
    return np.array([[[*table.center, 0.0, *(corners[2] - np.asarray(table.center)), 1.0, 0.0]]])


def _finished(joined: JoinedPushes, results: Results) -> Rollouts:
    """`Rollouts` from the results that a kernel filled in.

    Raises:
        RolloutError: a step was not solved (names the model and the push), or a derivative is not finite.
    """
    poses, forces, end = results.poses, results.forces, results.end
    d_poses, d_forces, rim = results.d_poses, results.d_forces, results.rim
    if not (np.isfinite(end).all() and end[..., 6].min() >= 0):
        model, push = np.argwhere((end[..., 6] < 0) | ~np.isfinite(end).all(axis=-1))[0]
        raise RolloutError(f"model {model}, push {push}: a step did not converge")
    tips, reached = np.full(end.shape[:2], np.inf), np.zeros(end.shape[:2], dtype=bool)
    if rim.shape[-1]:
        tips, reached = rim[..., TIPS], rim[..., REACHED] > 0
    if results.mass_poses.shape[-1] and reached.any():
        clear_unreached(results.mass_poses, rim, joined.sample_at, FIRST_POSE)
        clear_unreached(results.mass_forces, rim, joined.force_at, FIRST_FORCE)
        d_poses = np.concatenate([d_poses, results.mass_poses], axis=-1)
        d_forces = np.concatenate([d_forces, results.mass_forces], axis=-1)
    if not (np.isfinite(d_poses).all() and np.isfinite(d_forces).all()):
        raise RolloutError("a derivative is not finite; an effect's formula may have none there")
    evaluations = end[..., 6].astype(np.int64)
    at = joined.sample_at, joined.force_at
    return Rollouts(poses, forces, end[..., :6], evaluations, *at, d_poses, d_forces, tips, reached)


__all__ = ["Maps", "Push", "RolloutError", "Rollouts", "Slider", "Smoothing"]
