"""The cell-grid model with effects: the same rollouts, with parameters of effects among the maps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slipmap.models.effects.effect import Effect
from slipmap.models.effects.program import program_of
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.effect_kernel import effect_rollout_all
from slipmap.models.physics.maps import Maps
from slipmap.models.physics.pushes import JoinedPushes, Push
from slipmap.models.physics.rollout import Rollouts, Slider, Smoothing, finished


class EffectSlider(Slider):
    """A `Slider` whose maps carry the parameters of effects; at their nulls it is the plain one.

    Start poses are those that the tracker reports, as the poses of the results are: a tracker that is off
        or late
    is an effect too.

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

    def rollout(
        self,
        maps: Maps,
        pushes: Sequence[Push],
        *,
        sensitivities: bool = False,
        start_poses: FloatArray | None = None,
        start_twists: FloatArray | None = None,
    ) -> Rollouts:
        """See `Slider.rollout`; maps without effects' parameters are those where all effects vanish.

        Raises:
            ValueError: maps of another grid or of other effects.
            RolloutError: a step was not solved; names the model and the push.
        """
        K = len(maps)
        program = self.program
        values = maps.effects
        if values.shape[1] == 0:
            values = np.repeat(np.concatenate([effect.nulls for effect in self.effects])[None], K, axis=0)
        if values.shape[1] != program.parameters:
            raise ValueError(
                f"maps have {values.shape[1]} effect parameters, the effects"
                f" {', '.join(effect.name for effect in self.effects)} have {program.parameters}"
            )
        joined = JoinedPushes(pushes, K, start_poses, start_twists)
        true_starts, by_measured, by_effect = self._true_starts(joined.start_poses, values)
        delays, delay_slopes = np.zeros(K), np.zeros((K, program.parameters))
        if program.delay is not None:
            for k in range(K):
                delays[k], delay_slopes[k] = program.delay(values[k])
        load = self._loads(maps)
        columns = self.columns if sensitivities else 0
        S, F = joined.sample_at[-1], joined.force_at[-1]
        poses, rates, forces = np.empty((K, S, 3)), np.empty((K, S, 3)), np.empty((K, F, 2))
        d_poses, d_forces = np.empty((K, S, 3, columns)), np.empty((K, F, 2, columns))
        end = np.empty((K, len(pushes), 7))
        effect_rollout_all(
            load, self._centers[0], self._centers[1], self.inertia(maps.mass), maps.mu_finger,
            self.grid.width, self.grid.edges, self.finger_radius, self._size, self._smoothing,
            joined.h, joined.tip, joined.tip_at, joined.wrench, joined.wrench_at,
            true_starts, joined.start_twists, joined.sample_time, joined.sample_at, delays,
            joined.force_step, joined.force_at,
            program.addresses, program.sizes, self._constants(joined), np.ascontiguousarray(values),
            np.zeros(program.memory), poses, rates, forces, d_poses, d_forces, end,
        )  # fmt: skip
        P = program.parameters
        if sensitivities and program.delay is not None:
            d_poses[..., -P:] -= rates[..., None] * delay_slopes[:, None, None]
        if sensitivities and program.measured is not None:
            n = len(self.grid)
            starts = slice(n + 5, n + 8)
            for b in range(len(pushes)):
                for d, at in ((d_poses, joined.sample_at), (d_forces, joined.force_at)):
                    rows = d[:, at[b] : at[b + 1]]
                    by_start = rows[..., starts].copy()
                    rows[..., -P:] += np.einsum("ksij,kjp->ksip", by_start, by_effect[:, b])
                    rows[..., starts] = np.einsum("ksij,kjl->ksil", by_start, by_measured[:, b])
        if program.measured is not None:
            for k in range(K):
                poses[k], by_pose, by_p = program.measured(*poses[k].T, values[k])
                end[k, :, :3] = program.measured(*end[k, :, :3].T, values[k])[0]
                if sensitivities:
                    d_poses[k] = by_pose @ d_poses[k]
                    d_poses[k][..., -P:] += by_p
        return finished(joined, poses, forces, d_poses, d_forces, end)

    def _constants(self, joined: JoinedPushes) -> FloatArray:
        """(B, CONSTANTS) of each push, see `effect_layout`."""
        centers = self.grid.centers
        centroid = centers.mean(axis=0)
        arms = centers - centroid
        second = arms.T @ arms / len(arms) + np.eye(2) * self.grid.width**2 / 12.0
        inverse = np.linalg.inv(second)
        shared = [self.gravity, self.grid.width, *centroid, inverse[0, 0], inverse[0, 1], inverse[1, 1]]
        return np.array(
            [
                [0.0, h, order, *shared, float(len(centers))]
                for h, order in zip(joined.h, joined.order, strict=True)
            ]
        )

    def _true_starts(
        self, reported: FloatArray, values: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Where the object is when the tracker reports poses (K, B, 3), and derivatives by report and
        parameters.

        The formulas give the report of a true pose; Newton's method turns them round.
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
