"""Algorithm 1 of Song and Boularias (IROS 2020): K bounded gradient descents, weighted by their losses.

Line numbers are those of the printed algorithm, x is its pose vector of 3n numbers (`paper_notation.py`).
Lines 1 to 6 record pushes; here they are recorded already. Where the text leaves a choice:

- The printed loop over pushes finds the K models again after each push. Those of fewer pushes are
  superseded, so only the last round, over all pushes, is run; P is over its K models.
- With t counted as printed, ẋ_t moves x_t to x_{t+1}; V takes (x_t, ẋ_t) to ẋ_{t+1}, which moves x_{t+1} to
  x_{t+2}. Observed velocities are finite differences of the poses. V is one step of `Slider` from x_{t+1}
  with the twist ẋ_t; the known motion of the finger drives it in place of the force F_t.
- Equation 1 predicts each step from the observed state, line 18 from the simulated one. Both are used:
  line 20, and with it P, judges the simulated trajectory; lines 21 and 22 descend the gradient of Equation 1,
  for which the derivative of one step is exact.
- Lines 20 and 21 print two indices, t+2 and t+1, for the pose that is compared. Here both mean x_{t+2}, the
  pose that V predicts at t (at t = 0 the printed x_{t+1} is the observed pose itself).
- W of lines 21 and 22 is not given. Here it is ∂x_{t+2}/∂mu and ∂x_{t+2}/∂M, (3n, n), by the implicit
  function theorem, and Diag(x - x^g) W is summed over its 3n rows: the gradient of ½ |x - x^g|².
- One rate cannot serve both kilograms and coefficients: each map is stepped in units of its own bound,
  mu ← mu - α mu_max² Diag(…) W with the bound of its model k, and the same for M.
- Lines 23 and 24 are clippings. The lower bound is `FLOOR` of the upper one rather than 0: an object without
  mass or friction has no unique motion.
- The pushes may be passed more than once (`epochs`). The loss starts from 0 in each pass; the last counts.

For even K the models K/2 and K have the same bounds and coincide, and the norm of a 3n vector adds metres and
radians, both as printed. One-step predictions rely on velocities differentiated from noisy poses, and on the
recorded finger touching the recorded outline: clocks that disagree mislead this method more than a comparison
of whole trajectories.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import numba
import numpy as np

from slipmap.models.geometry import rotated
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.prior import slider_for
from slipmap.models.measurements import DatasetError, PushDataset, Trial, finger_path, pose_times
from slipmap.models.measurements.motion import interpolated, smooth_track
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.paper_notation import cell_poses
from slipmap.models.physics.rollout import Maps, Push, Slider
from slipmap.models.progress import Progress, StageProgress, silent

_STEPS = 20
"""Time steps that a trial is cut into. In shorter ones the object would move less than the tracker errs."""


@dataclass(frozen=True, eq=False)
class EqualSteps:
    """A trial sampled at T + 1 times, dt apart, for Algorithm 1.

    Raises:
        ValueError: shapes that do not fit, fewer than three poses, poses not finite, dt not positive.
    """

    dt: float  # s
    poses: FloatArray  # (T + 1, 3) x^g, world pose of the object, m and unwrapped rad; T >= 2
    tip: FloatArray  # (T + 1, 2) finger centre, world, m; NaN where there is no finger

    def __post_init__(self) -> None:
        poses, tip = np.asarray(self.poses, dtype=float), np.asarray(self.tip, dtype=float)
        if not (np.isfinite(self.dt) and self.dt > 0):
            raise ValueError(f"observed push: dt must be positive, got {self.dt} s")
        if poses.ndim != 2 or poses.shape[1] != 3 or len(poses) < 3 or not np.isfinite(poses).all():
            raise ValueError(f"observed push: needs finite poses (T + 1, 3), T >= 2, got shape {poses.shape}")
        if tip.shape != (len(poses), 2):
            raise ValueError(f"observed push: tip must have shape ({len(poses)}, 2), got {tip.shape}")
        object.__setattr__(self, "poses", poses)
        object.__setattr__(self, "tip", tip)

    @property
    def twists(self) -> FloatArray:
        """(T, 3) ẋ^g_t in the object frame: the constant twist that moves pose t to pose t + 1 in dt."""
        half = 0.5 * np.diff(self.poses[:, 2])
        chord = np.diff(self.poses[:, :2], axis=0) / np.sinc(half / np.pi)[:, None]
        return np.column_stack([rotated(chord, -(self.poses[:-1, 2] + half)), 2.0 * half]) / self.dt

    def transitions(self) -> list[Push]:
        """T - 1 single steps: number t starts in the observed (x_{t+1}, ẋ_t) and predicts x_{t+2}."""
        return [
            Push(self.dt, self.tip[t + 1 : t + 3], self.poses[t + 1], twist)
            for t, twist in enumerate(self.twists[:-1])
        ]


def observe_steps(trial: Trial, reach: float = 0.0) -> EqualSteps:
    """A trial of three poses or more at equal times, linear between rows, the finger's track smoothed.

    The finger counts as one that does not turn. `reach` is that of the object's outline from its frame's
    origin, m, see `Trial.finger_near`.
    """
    times = pose_times(trial)
    steps = min(_STEPS, len(times) - 1)
    ends = np.linspace(0.0, times[-1], steps + 1)
    tip = np.full((steps + 1, 2), np.nan)
    if trial.finger_near(reach):
        tip = interpolated(ends, *smooth_track(*finger_path(trial))[:2])
    return EqualSteps(float(times[-1]) / steps, trial.object_pose.at(trial.start + ends), tip)


FLOOR = 1e-4
"""Lower bound of masses and frictions as a share of their upper bounds."""

_EPOCHS = 10
_RATE = 0.03
"""Learning rate times the mean |W|²: about the share of a step's error that one update removes."""

_TEMPERATURE = 0.01
"""Soft-max temperature as a share of the loss of an object that never moves."""

_NOMINAL_MASS = 1.0  # kg, of an object that was not weighed


def bound_schedule(hypotheses: int, mass_max: float, mu_max: float) -> tuple[FloatArray, FloatArray]:
    """Lines 8 to 12: upper bounds (K,) of mass and of friction of the K models.

    Raises:
        ValueError: fewer than one model, or a maximum that is not positive.
    """
    if hypotheses < 1:
        raise ValueError(f"Algorithm 1: needs at least one hypothesis, got {hypotheses}")
    for name, value in (("mass_max", mass_max), ("mu_max", mu_max)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"Algorithm 1: {name} must be positive, got {value}")
    share = 2.0 * np.arange(1, hypotheses + 1) / hypotheses
    return np.where(share <= 1, 1.0, share - 1) * mass_max, np.minimum(share, 1.0) * mu_max


def soft_max(loss: FloatArray, temperature: float) -> FloatArray:
    """Line 30: probabilities (K,) of models with losses (K,).

    Raises:
        ValueError: a temperature that is not positive.
    """
    if not (np.isfinite(temperature) and temperature > 0):
        raise ValueError(f"Algorithm 1: the temperature must be positive, got {temperature}")
    # Subtract the smallest loss, or all exponentials could be 0.
    weight = np.exp(-(loss - loss.min()) / temperature)
    return weight / weight.sum()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Use one thread: single steps are so short that threads cost more than they save."""
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(threads)


@_one_thread()
def algorithm_1(
    slider: Slider,
    pushes: Sequence[EqualSteps],
    *,
    hypotheses: int = 20,
    mass_max: float,
    mu_max: float,
    mu_finger: float,
    learning_rate: float,
    temperature: float,
    epochs: int = 1,
    progress: StageProgress | None = None,
) -> tuple[Maps, FloatArray, FloatArray]:
    """K models of an object from recorded pushes; the head of this file says how the printed lines are read.

    Args:
        slider: the object and its step V.
        pushes: recorded trajectories, passed one after the other.
        hypotheses: K.
        mass_max: largest mass of a cell, kg.
        mu_max: largest friction coefficient of a cell.
        mu_finger: friction coefficient of the finger, which the algorithm does not identify.
        learning_rate: α_rate for maps in units of their bounds, per unit of |x - x^g|².
        temperature: τ, in units of the loss.
        epochs: passes over all pushes.
        progress: called after each push with the numbers of pushes done and of all, over all epochs.

    Returns:
        Maps of K models, their losses (K,) and probabilities (K,).

    Raises:
        ValueError: no pushes, or a parameter out of range.
        RolloutError: a step that could not be solved.
    """
    if not pushes:
        raise ValueError("Algorithm 1: there are no pushes to learn from")
    if not (np.isfinite(learning_rate) and learning_rate > 0) or epochs < 1:
        raise ValueError(f"Algorithm 1: learning_rate {learning_rate} and epochs {epochs} must be positive")
    n, K = len(slider.grid), hypotheses
    centers = slider.grid.centers
    bound = np.repeat(np.column_stack(bound_schedule(K, mass_max, mu_max)), n, axis=1)  # (K, 2n), mass first
    estimate = 0.5 * bound  # lines 14, 15
    finger = np.full(K, float(mu_finger))
    transitions = [push.transitions() for push in pushes]

    maps = Maps(estimate[:, :n], estimate[:, n:], finger)
    for epoch in range(epochs):
        loss = np.zeros(K)  # line 16
        for b, push in enumerate(pushes):
            q, v = np.tile(push.poses[1], (K, 1)), np.tile(push.twists[0], (K, 1))  # line 13
            for t, step in enumerate(transitions[b]):
                observed = cell_poses(push.poses[t + 2], centers)
                # Two rollouts in one: the first from the simulated state, the second from the observed one.
                result = slider.rollout(
                    maps,
                    [step, step],
                    sensitivities=True,
                    start_poses=np.stack([q, np.broadcast_to(step.start_pose, (K, 3))], axis=1),
                    start_twists=np.stack([v, np.broadcast_to(step.start_twist, (K, 3))], axis=1),
                )
                q, v = result.end[:, 0, :3], result.end[:, 0, 3:]  # lines 18, 19
                loss += np.linalg.norm(cell_poses(q, centers) - observed, axis=1)  # line 20
                predicted = result.poses[:, 1]
                # (x - x^g)ᵀ W with W = ∂x/∂q ∂q/∂(M, mu), multiplied from the left.
                difference = cell_poses(predicted, centers) - observed
                by_pose = np.einsum("ki,kic->kc", difference, _cells_by_pose(predicted, centers))
                by_maps = slider.map_columns(maps, result.d_poses[:, 1])[..., : 2 * n]
                gradient = np.einsum("kc,kcp->kp", by_pose, by_maps)
                estimate = estimate - learning_rate * bound**2 * gradient  # lines 21, 22
                estimate = np.clip(estimate, FLOOR * bound, bound)  # lines 23, 24
                maps = Maps(estimate[:, :n], estimate[:, n:], finger)
            if progress is not None:
                progress(epoch * len(pushes) + b + 1, epochs * len(pushes))
    return maps, loss, soft_max(loss, temperature)


def identify_by_algorithm_1(
    dataset: PushDataset, *, hypotheses: int = 20, seed: int = 0, progress: Progress | None = None
) -> Belief:
    """Algorithm 1 on the fit pushes of a dataset, with parameters that suit small and heavy objects alike.

    Each push is cut into equal steps, see `observe_steps`. A cell's mass is at most twice
    the object's mass (`_NOMINAL_MASS` if it was not weighed) over n, so that the first half of the models
    start from the known mass; nothing holds them to it. Learning rate and temperature follow from the
    pushes, see `_RATE` and `_TEMPERATURE`. Forces are not used.

    Args:
        dataset: measured pushes. Trials with fewer than three poses show no time steps and are left out.
        hypotheses: K.
        seed: recorded in the belief; the algorithm makes no random draws.

    Raises:
        DatasetError: no fit push with three poses or more, or none that moves the object.
        ValueError: fewer than one hypothesis.
    """
    trials = [trial for trial in dataset.fit_trials if len(trial.object_pose.time) >= 3]
    if not trials:
        raise DatasetError(
            f"dataset {dataset.name}: Algorithm 1 compares single time steps and needs a fit push with three "
            "poses or more; use the method gauss-newton for pushes of which only the ends are known"
        )
    slider = slider_for(dataset)
    pushes = [observe_steps(trial, dataset.reach) for trial in trials]
    total = dataset.mass if dataset.mass is not None else _NOMINAL_MASS
    parameters = {"mass_max": 2.0 * total / len(dataset.grid), "mu_max": 1.0, "mu_finger": 0.35}
    still = _loss_of_rest(pushes, dataset.grid.centers)
    square = _mean_square_weight(slider, pushes, **parameters)
    if still == 0 or square == 0:
        raise DatasetError(
            f"dataset {dataset.name}: no fit push moves the object, so there is nothing to learn from; give "
            "pushes in which the finger reaches the outline"
        )
    parameters |= {"learning_rate": _RATE / square, "temperature": _TEMPERATURE * still}
    maps, loss, probability = algorithm_1(
        slider,
        pushes,
        hypotheses=hypotheses,
        **parameters,
        epochs=_EPOCHS,
        progress=partial(progress or silent, "Algorithm 1"),
    )
    return Belief.learned(
        dataset,
        slider,
        maps,
        probability,
        method="paper",
        seed=seed,
        trials=[trial.name for trial in trials],
        settings={
            "left_out": [trial.name for trial in dataset.fit_trials if trial not in trials],
            "steps": [len(push.poses) - 1 for push in pushes],
            "epochs": _EPOCHS,
            "floor": FLOOR,
            "rate": _RATE,
            "temperature_share": _TEMPERATURE,
            **parameters,
            "loss": loss.tolist(),
            "loss_of_rest": still,
        },
    )


def _loss_of_rest(pushes: Sequence[EqualSteps], centers: FloatArray) -> float:
    """The loss of line 20 for an object that stays where it is first seen."""
    x = [cell_poses(push.poses, centers) for push in pushes]
    return float(sum(np.linalg.norm(poses[2:] - poses[1], axis=1).sum() for poses in x))


def _mean_square_weight(
    slider: Slider, pushes: Sequence[EqualSteps], *, mass_max: float, mu_max: float, mu_finger: float
) -> float:
    """Mean |W|² (Frobenius) over all steps of a uniform object, with maps in units of their bounds."""
    n = len(slider.grid)
    start = Maps(np.full((1, n), 0.5 * mass_max), np.full((1, n), 0.5 * mu_max), np.array([mu_finger]))
    bound = np.repeat([mass_max, mu_max], n)
    steps = [step for push in pushes for step in push.transitions()]
    result = slider.rollout(start, steps, sensitivities=True)
    by_maps = slider.map_columns(start, result.d_poses)[0, ..., : 2 * n] * bound
    by_pose = _cells_by_pose(result.poses[0], slider.grid.centers)
    # |E D|² = tr(Eᵀ E D Dᵀ), over rigid motions instead of cells.
    square = np.einsum("sic,sid,scp,sdp->s", by_pose, by_pose, by_maps, by_maps, optimize=True)
    return float(square.mean())


def _cells_by_pose(q: FloatArray, centers: FloatArray) -> FloatArray:
    """∂x/∂q: derivative (K, 3n, 3) of the 3n pose vector with respect to the planar poses q (K, 3)."""
    K, n = len(q), len(centers)
    arm = cell_poses(q, centers).reshape(K, n, 3)[..., :2] - q[:, None, :2]
    result = np.tile(np.eye(3), (K, n, 1, 1))
    result[..., 0, 2], result[..., 1, 2] = -arm[..., 1], arm[..., 0]
    return result.reshape(K, 3 * n, 3)
