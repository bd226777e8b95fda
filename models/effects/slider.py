"""The cell-grid model with effects: the same rollouts, with parameters of effects among the maps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from slipmap.models.effects.effect import Effect
from slipmap.models.effects.program import program_of
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.effect_cells import CONSTANTS
from slipmap.models.physics.effect_kernel import effect_rollout_all
from slipmap.models.physics.kernel_arguments import Formulas, JoinedPushes, Results
from slipmap.models.physics.maps import Maps
from slipmap.models.physics.pushes import Push
from slipmap.models.physics.rollout import Slider, Smoothing
from slipmap.models.physics.step import INERTIA_COLUMNS


class EffectSlider(Slider):
    """A `Slider` whose maps carry the parameters of effects; without any, all effects vanish.

    Start poses are those that the tracker reports, as the poses of the results are: a tracker that is off or
    late is an effect too.

    Args:
        grid: cells and outline.
        finger_radius: m.
        effects: in the order of the columns of `Maps.effects`.
        gravity: m/s².
        smoothing: see `Smoothing`.

    Raises:
        EffectError: a formula cannot be used.
    """

    def __init__(
        self,
        grid: CellGrid,
        finger_radius: float,
        effects: Sequence[Effect],
        gravity: float = 9.81,
        smoothing: Smoothing | None = None,
    ) -> None:
        super().__init__(grid, finger_radius, gravity, smoothing)
        self.effects = tuple(effects)
        self.program = program_of(self.effects)

    def __reduce__(self) -> tuple[object, ...]:
        """Pickled without its machine code, whose addresses mean nothing in another process."""
        return EffectSlider, (self.grid, self.finger_radius, self.effects, self.gravity, self.smoothing)

    @property
    def columns(self) -> int:
        """Reduced parameters of the plain model, then the effects' own."""
        return super().columns + self.program.parameters

    @property
    def nulls(self) -> FloatArray:
        """(P,) parameters of the effects at which they vanish."""
        return np.concatenate([np.zeros(0), *(effect.nulls for effect in self.effects)])

    def _fill(self, results: Results, maps: Maps, pushes: Sequence[Push], joined: JoinedPushes) -> None:
        K, program = len(maps), self.program
        values = maps.effects
        if values.shape[1] == 0:
            values = np.repeat(self.nulls[None], K, axis=0)
        if values.shape[1] != program.parameters:
            raise ValueError(
                f"maps have {values.shape[1]} effect parameters, the effects"
                f" {', '.join(effect.name for effect in self.effects)} have {program.parameters}"
            )
        starts = self._true_starts(joined.start_poses, values)
        delays, delay_slopes = np.zeros(K), np.zeros((K, program.parameters))
        if program.delay is not None:
            for k in range(K):
                delays[k], delay_slopes[k] = program.delay(values[k])
        constants = self._constants(joined.h, [push.order for push in pushes])
        formulas = Formulas(program.addresses, program.sizes, constants, np.ascontiguousarray(values), delays)
        true = joined._replace(start_poses=starts[0])
        effect_rollout_all(self._common, self._reduced(maps), true, formulas, results)
        if results.d_poses.shape[-1] > 0 and program.delay is not None:
            late = results.rates[..., None] * delay_slopes[:, None, None]
            results.d_poses[..., -program.parameters :] -= late
        if program.measured is not None:
            self._report(results, joined, values, *starts[1:])

    def _report(
        self,
        results: Results,
        joined: JoinedPushes,
        values: FloatArray,
        by_measured: FloatArray,
        by_effect: FloatArray,
    ) -> None:
        """Turn true poses into reported ones, and derivatives by true starts into those by reported ones."""
        poses, _, _, d_poses, d_forces, end = results
        assert self.program.measured is not None
        n, P = len(self.grid), self.program.parameters
        derive = d_poses.shape[-1] > 0
        starts = slice(n + INERTIA_COLUMNS + 1, n + INERTIA_COLUMNS + 4)
        for b in range(len(joined.h) if derive else 0):
            for d, at in ((d_poses, joined.sample_at), (d_forces, joined.force_at)):
                rows = d[:, at[b] : at[b + 1]]
                by_start = rows[..., starts].copy()
                rows[..., -P:] += np.einsum("ksij,kjp->ksip", by_start, by_effect[:, b])
                rows[..., starts] = np.einsum("ksij,kjl->ksil", by_start, by_measured[:, b])
        for k in range(len(poses)):
            poses[k], by_pose, by_p = self.program.measured(*poses[k].T, values[k])
            end[k, :, :3] = self.program.measured(*end[k, :, :3].T, values[k])[0]
            if derive:
                d_poses[k] = by_pose @ d_poses[k]
                d_poses[k][..., -P:] += by_p

    def _constants(self, h: ArrayLike, order: ArrayLike) -> FloatArray:
        """(B, CONSTANTS) of pushes with steps h (B,) at places `order` (B,) in the experiment; time is 0."""
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

    def _true_starts(
        self, reported: FloatArray, values: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """True poses where the tracker reports some (K, B, 3), and derivatives by report and parameters.

        The formulas give the report of a true pose; Newton's method inverts them.
        """
        K, B, _ = reported.shape
        P = values.shape[1]
        identity = np.broadcast_to(np.eye(3), (K, B, 3, 3))
        if self.program.measured is None:
            return reported, identity, np.zeros((K, B, 3, P))
        true, by_report, by_effect = reported.copy(), np.empty((K, B, 3, 3)), np.empty((K, B, 3, P))
        for k in range(K):
            for _ in range(20):
                seen, by_pose, by_p = self.program.measured(*true[k].T, values[k])
                error = seen - reported[k]
                true[k] -= np.linalg.solve(by_pose, error[..., None])[..., 0]
                if np.abs(error).max() < 1e-13:
                    break
            by_report[k] = np.linalg.inv(by_pose)
            by_effect[k] = -by_report[k] @ by_p
        return true, by_report, by_effect
