"""Reports of tracker and force sensor for a true motion, according to the effects in a model.

The kernel handles the tracker's delay, since it knows every pose within a step. The rest is done here after a
rollout, with derivatives. A late force is the mean over its span, each step of which is interpolated between
the two steps around its earlier time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slipmap.models.effects.program import Delay, Program
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.kernel_tools import JoinedPushes, Results
from slipmap.models.physics.step import INERTIA_COLUMNS
from slipmap.models.physics.support import FIRST_FORCE, FIRST_POSE, REACHED


@dataclass(frozen=True, eq=False)
class TrueStarts:
    """True start poses in K models of B pushes with P parameters of effects."""

    poses: FloatArray  # (K, B, 3)
    by_report: FloatArray  # (K, B, 3, 3) derivatives with respect to the reported start poses
    by_effect: FloatArray  # (K, B, 3, P) derivatives with respect to the parameters


@dataclass(frozen=True, eq=False)
class Sensors:
    """Tracker and force sensor of K models."""

    program: Program
    values: FloatArray  # (K, P) parameters of the effects
    # (K,) delays of the tracker and of the force, s; (K, P) their derivatives
    delays: FloatArray
    delay_slopes: FloatArray
    force_delays: FloatArray
    force_delay_slopes: FloatArray

    @classmethod
    def of(cls, program: Program, values: FloatArray) -> Sensors:
        """The sensors described by a program's effects with parameters (K, P)."""
        return cls(program, values, *_delays(program.delay, values), *_delays(program.force_delay, values))

    def true_starts(self, reported: FloatArray) -> TrueStarts:
        """True poses of objects that the tracker reports at poses (K, B, 3).

        The formulas map a true pose to its report; Newton's method inverts them.
        """
        K, B, _ = reported.shape
        P = self.values.shape[1]
        if self.program.measured is None:
            identity = np.broadcast_to(np.eye(3), (K, B, 3, 3))
            return TrueStarts(reported, identity, np.zeros((K, B, 3, P)))
        true, by_report, by_effect = reported.copy(), np.empty((K, B, 3, 3)), np.empty((K, B, 3, P))
        for k in range(K):
            for _ in range(20):
                seen, by_pose, by_p = self.program.measured(*true[k].T, self.values[k])
                error = seen - reported[k]
                true[k] -= np.linalg.solve(by_pose, error[..., None])[..., 0]
                if np.abs(error).max() < 1e-13:
                    break
            by_report[k] = np.linalg.inv(by_pose)
            by_effect[k] = -by_report[k] @ by_p
        return TrueStarts(true, by_report, by_effect)

    def with_steps_before(self, joined: JoinedPushes) -> JoinedPushes:
        """The pushes with every step whose force is needed if the sensor reports forces late."""
        if self.program.force_delay is None:
            return joined
        steps, at = [], [0]
        for b in range(len(joined.h)):
            needed = [_about(*self._place(k, b, joined))[0] for k in range(len(self.values))]
            steps.append(np.unique(needed))
            at.append(at[-1] + len(steps[-1]))
        every = np.concatenate(steps)
        at_push = np.array(at, dtype=np.int64)
        return joined._replace(force_first=every, force_last=every, force_at=at_push)

    def reported(
        self, results: Results, true: JoinedPushes, joined: JoinedPushes, starts: TrueStarts, cells: int
    ) -> Results:
        """Convert true poses and forces into reported ones, with derivatives for reported starts.

        Args:
            results: of a rollout; its arrays are changed.
            true: the pushes that were simulated.
            joined: the pushes that were requested.
            starts: true starts of `true`.
            cells: n.
        """
        P = self.values.shape[1]
        derive = results.d_poses.shape[-1] > 0
        if derive and self.program.delay is not None:
            results.d_poses[..., -P:] -= results.rates[..., None] * self.delay_slopes[:, None, None]
        if self.program.force_delay is not None:
            results = self._late(results, true, joined)
        if derive and self.program.measured is not None:
            _by_reported_starts(results, joined, starts, cells + INERTIA_COLUMNS + 1)
        for k in range(len(self.values)):
            self._report_poses(results, joined, k)
            self._report_forces(results, joined, k)
        return results

    def _report_poses(self, results: Results, joined: JoinedPushes, k: int) -> None:
        measured, values = self.program.measured, self.values[k]
        if measured is None:
            return
        d_poses, by_mass = results.d_poses[k], results.mass_poses[k]
        results.poses[k], by_pose, by_p = measured(*results.poses[k].T, values)
        results.end[k, :, :3] = measured(*results.end[k, :, :3].T, values)[0]
        if d_poses.shape[-1]:
            d_poses[...] = by_pose @ d_poses
            d_poses[..., -len(values) :] += by_p
        if by_mass.shape[-1]:
            clear_unreached(
                results.mass_poses[k : k + 1], results.rim[k : k + 1], joined.sample_at, FIRST_POSE
            )
            by_mass[...] = by_pose @ by_mass

    def _report_forces(self, results: Results, joined: JoinedPushes, k: int) -> None:
        felt, values = self.program.felt, self.values[k]
        if felt is None:
            return
        d_forces, by_mass = results.d_forces[k], results.mass_forces[k]
        results.forces[k], by_force, by_p = felt(*results.forces[k].T, values)
        if d_forces.shape[-1]:
            d_forces[...] = by_force @ d_forces
            d_forces[..., -len(values) :] += by_p
        if by_mass.shape[-1]:
            clear_unreached(
                results.mass_forces[k : k + 1], results.rim[k : k + 1], joined.force_at, FIRST_FORCE
            )
            by_mass[...] = by_force @ by_mass

    def _place(self, k: int, b: int, joined: JoinedPushes) -> tuple[FloatArray, int]:
        """Fractional steps whose forces model k reports in push b, span after span, and the push's number of
        steps."""
        steps = int(joined.tip_at[b + 1] - joined.tip_at[b]) - 1
        spans = zip(*_spans(joined, b), strict=True)
        wanted = np.concatenate([np.zeros(0), *(np.arange(first, last + 1.0) for first, last in spans)])
        return wanted - self.force_delays[k] / joined.h[b], steps

    def _late(self, results: Results, true: JoinedPushes, joined: JoinedPushes) -> Results:
        """Reported forces at the requested times, interpolated between the forces of steps."""
        names = ("forces", "d_forces", "mass_forces")
        if results.mass_forces.shape[-1]:
            clear_unreached(results.mass_forces, results.rim, true.force_at, FIRST_FORCE)
            results.rim[..., FIRST_FORCE] = 0.0
        K, T = len(self.values), int(joined.force_at[-1])
        found = {name: np.empty((K, T, *getattr(results, name).shape[2:]), dtype=float) for name in names}
        P = self.values.shape[1]
        for k in range(K):
            for b in range(len(joined.h)):
                rows = slice(joined.force_at[b], joined.force_at[b + 1])
                steps, share, slope = _about(*self._place(k, b, joined))
                if steps.shape[1] == 0:
                    continue
                first, last = _spans(joined, b)
                counts = last - first + 1
                begins = np.cumsum(counts) - counts
                have = _spans(true, b)[0]
                at, after, before = true.force_at[b] + np.searchsorted(have, steps)
                for name in names:
                    own = getattr(results, name)[k]
                    ones = (1,) * (own.ndim - 1)
                    late = own[at] + share.reshape(-1, *ones) * (own[after] - own[at])
                    found[name][k, rows] = np.add.reduceat(late, begins) / counts.reshape(-1, *ones)
                if results.d_forces.shape[-1]:
                    rate = results.forces[k, after] - results.forces[k, before]
                    rate *= (slope / joined.h[b])[:, None]
                    rate = np.add.reduceat(rate, begins) / counts[:, None]
                    found["d_forces"][k, rows, :, -P:] -= rate[..., None] * self.force_delay_slopes[k]
        return results._replace(**found)


def _spans(joined: JoinedPushes, b: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(T,) first and last steps of the forces of push b."""
    rows = slice(joined.force_at[b], joined.force_at[b + 1])
    return joined.force_first[rows], joined.force_last[rows]


def _delays(delay: Delay | None, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Delays (K,) and their derivatives (K, P)."""
    found, slopes = np.zeros(len(values)), np.zeros(values.shape)
    if delay is not None:
        for k, own in enumerate(values):
            found[k], slopes[k] = delay(own)
    return found, slopes


def _about(place: FloatArray, steps: int) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Steps (3, T) at or before each place (T,), after it and before it, with weights for interpolation.

    Also returns the share of the step after, and the factor that turns the difference of the last two into
    the slope with respect to the place. Beyond its ends a push keeps its first or last force.
    """
    held = np.clip(place, 0.0, steps - 1)
    at = np.floor(held).astype(np.int64)
    after, before = np.minimum(at + 1, steps - 1), np.maximum(np.ceil(held).astype(np.int64) - 1, 0)
    moves = (held == place) & (after > before)
    return np.array([at, after, before]), held - at, np.where(moves, 1.0 / np.maximum(after - before, 1), 0.0)


def _by_reported_starts(results: Results, joined: JoinedPushes, starts: TrueStarts, first: int) -> None:
    """Convert derivatives with respect to the true start, from column `first` on, to the reported start."""
    P = starts.by_effect.shape[-1]
    columns = slice(first, first + 3)
    for b in range(len(joined.h)):
        for d, at in ((results.d_poses, joined.sample_at), (results.d_forces, joined.force_at)):
            rows = d[:, at[b] : at[b + 1]]
            by_start = rows[..., columns].copy()
            rows[..., -P:] += np.einsum("ksij,kjp->ksip", by_start, starts.by_effect[:, b])
            rows[..., columns] = np.einsum("ksij,kjl->ksil", by_start, starts.by_report[:, b])


def clear_unreached(d: FloatArray, rim: FloatArray, at: NDArray[np.int64], first: int) -> None:
    """Set derivatives with respect to masses (K, S, …) to zero where the kernel wrote none, far from the rim.

    Args:
        d: derivatives, changed in place.
        rim: (K, B, RIM_RESULTS).
        at: (B + 1,) offsets of the pushes in S.
        first: entry of `rim` with the first row of a push that the kernel wrote.
    """
    reached, begun = rim[..., REACHED] > 0, rim[..., first].astype(np.int64)
    for k, b in np.ndindex(*reached.shape):
        d[k, at[b] : at[b] + begun[k, b] if reached[k, b] else at[b + 1]] = 0.0
