"""An audit: probes that name defects, and pushes of an object with known maps that price them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from slipmap.diagrams.application.audit import engines, probes
from slipmap.diagrams.application.audit.engines import EngineScene, Subject, two_material_scene
from slipmap.diagrams.application.audit.probes import Measure, measures
from slipmap.models.blas import one_blas_thread
from slipmap.models.effects.effect import Effect, Scene, bounds, scales
from slipmap.models.effects.library import LIBRARY
from slipmap.models.files import BadInput
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.maps import Maps
from slipmap.models.physics.paper_notation import add
from slipmap.models.physics.rollout import Push, Slider
from slipmap.models.progress import Progress
from slipmap.planners.exploration import Candidate, candidate_pushes

COUNT = 24  # number of pushes
_SEED = 34
_LENGTH, _SPEED = (0.04, 0.09), (0.03, 0.1)  # m after first touch; m/s
NOTHING = 5e-4  # m; lower prices need no explanation
_APPROACH, _RAMP, _REST = 5e-3, 0.05, 0.1  # m; s
_STEP = 1e-3  # s, of the model
_UNMOVED = 0.1  # share of the mean displacement that a finger which touches the object exceeds
_LOOKS = 12  # poses per push to which effects are fitted
_LOWER = 0.9  # largest share of the price that an explaining effect may leave
_LAWS = (
    "friction_diamond", "friction_square", "slip_load", "torsional_friction", "impulse_friction",
    "anisotropic_table", "anisotropic_object", "viscous_friction", "stribeck_friction", "load_transfer",
    "finger_compliance",
)  # fmt: skip
"""Effects that an engine may have: other laws of friction, load and contact."""


@dataclass(frozen=True, eq=False)
class StandardPushes:
    """The pushes of an audit, and their ends under Coulomb's law."""

    scene: EngineScene
    candidates: tuple[Candidate, ...]
    starts: FloatArray  # (24, 3) poses, world
    times: FloatArray  # (24, 12) times of the poses to which effects are fitted, s
    law: FloatArray  # (24, 3) final poses under Coulomb's law, world
    moved: float  # mean displacement of the object's points, m


@dataclass(frozen=True, eq=False)
class Pushed:
    """Results of the pushes in an engine."""

    ends: FloatArray  # (24, 3) poses, world
    looks: FloatArray  # (24, 12, 3) poses at `StandardPushes.times`
    errors: FloatArray  # (24,) mean distance of the object's points from Coulomb's law at the end, m

    @property
    def price(self) -> float:
        """Main result of an audit: mean of the errors, m."""
        return float(self.errors.mean())


@dataclass(frozen=True, eq=False)
class Explained:
    """Fit of an effect to an engine's pushes with the maps held fixed."""

    effect: Effect
    values: FloatArray  # (P,) its parameters
    errors: FloatArray  # (24,) as in `Pushed`, but from the law with the effect, m

    @property
    def price(self) -> float:
        """Mean of the errors, m."""
        return float(self.errors.mean())


def standard_pushes() -> StandardPushes:
    """The pushes of every audit."""
    scene, rng = two_material_scene(), np.random.default_rng(_SEED)
    candidates = candidate_pushes(
        scene.grid, scene.finger_radius, rng, COUNT, length=_LENGTH, speed=_SPEED, approach=_APPROACH
    )
    starts = np.column_stack([np.zeros((COUNT, 2)), rng.uniform(-np.pi, np.pi, COUNT)])
    pushes = _pushes(candidates, starts, _STEP)
    lasting = _STEP * np.array([len(push.tip) - 1 for push in pushes])
    times = np.linspace(0.25, 1.0, _LOOKS) * lasting[:, None]
    ends = Slider(scene.grid, scene.finger_radius).rollout(scene.maps, pushes).end[0, :, :3]
    moved = float(add(ends, starts, scene.grid.centers).mean())
    return StandardPushes(scene, tuple(candidates), starts, times, ends, moved)


def push_all(subject: Subject, standard: StandardPushes, report: probes.Report) -> Pushed:
    """Run the pushes in an engine.

    Raises:
        BadInput: the engine fails, or its finger does not move the object.
    """
    laid = subject.lay(standard.scene)
    ends, looks = [], []
    pushes = _pushes(standard.candidates, standard.starts, subject.dt)
    for done, (push, times) in enumerate(zip(pushes, standard.times, strict=True), start=1):
        poses = laid.push(push.tip, push.start_pose)
        clock = subject.dt * np.arange(len(poses))
        ends.append(poses[-1])
        looks.append(np.column_stack([np.interp(times, clock, column) for column in poses.T]))
        report(done)
    grid = standard.scene.grid
    moved = float(add(np.array(ends), standard.starts, grid.centers).mean())
    if moved < _UNMOVED * standard.moved:
        raise BadInput(
            f"engine {subject.name}: pushes move the object by {1e3 * moved:.1f} mm instead of"
            f" {1e3 * standard.moved:.0f} mm; step() must carry the finger, a disc of radius"
            " scene.finger_radius, from tip to next_tip, and the object out of its way"
        )
    errors = add(np.array(ends), standard.law, grid.centers)
    return Pushed(np.array(ends), np.array(looks), errors)


def explain(pushed: Pushed, standard: StandardPushes, effect: Effect) -> Explained:
    """Fit an effect's parameters to an engine's pushes with the maps held fixed.

    Least squares over the object's poses, with angles scaled by the object's radius, from each of the
    effect's start values; the best fit is kept. A robust loss (soft L1, 1 mm) keeps single pushes, such as
    one in which the finger slips off another side, from dominating.
    """
    scene, grid = standard.scene, standard.scene.grid
    slider = Slider(grid, scene.finger_radius, effects=[effect])
    stepped = _pushes(standard.candidates, standard.starts, _STEP)
    pushes = [
        Push(_STEP, push.tip, push.start_pose, pose_times=times, order=float(index))
        for index, (push, times) in enumerate(zip(stepped, standard.times, strict=True))
    ]
    radius = float(np.sqrt(np.mean((grid.centers**2).sum(axis=1))))
    weights = 1e3 * np.array([1.0, 1.0, radius])  # mm
    seen = pushed.looks.reshape(-1, 3)

    def rolled(values: FloatArray, derive: bool) -> tuple[FloatArray, FloatArray]:
        maps = Maps(scene.mass, scene.mu, np.array([scene.mu_finger]), values[None])
        out = slider.rollout(maps, pushes, sensitivities=derive)
        return out.poses[0], out.d_poses[0][..., -len(values) :] if derive else out.d_poses

    def misfit(values: FloatArray) -> FloatArray:
        return ((rolled(values, False)[0] - seen) * weights).ravel()

    def slopes(values: FloatArray) -> FloatArray:
        by_effect = rolled(values, True)[1]
        return np.asarray((by_effect * weights[:, None]).reshape(-1, len(values)))

    speed = float(np.median([candidate.speed for candidate in standard.candidates]))
    weight = float(scene.mass.sum() * slider.gravity)
    around = Scene((0.0, 0.0), reach=0.1, radius=radius, speed=speed, pushes=COUNT, weight=weight)
    low, high = bounds([effect])
    spans = scales([effect], weight)
    fits = []
    for begin in effect.start_values(around):
        # Slightly off the null, where parameters that shape the effect have zero derivative.
        begin = np.clip(begin + np.where(effect.amplitudes, 0.1 * spans, 0.0), low, high)
        fits.append(
            least_squares(
                misfit, begin, jac=slopes, bounds=(low, high), x_scale=spans, max_nfev=30, loss="soft_l1"
            )
        )
    best = min(fits, key=lambda fit: fit.cost)
    ends = rolled(best.x, False)[0].reshape(COUNT, _LOOKS, 3)[:, -1]
    return Explained(effect, best.x, add(pushed.ends, ends, grid.centers))


def _pushes(candidates: Sequence[Candidate], starts: FloatArray, dt: float) -> list[Push]:
    """Pushes on an object at poses (m, 3), in steps of `dt`, s."""
    return [
        candidate.push(start, h=dt, ramp=_RAMP, rest=_REST)
        for candidate, start in zip(candidates, starts, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class Audit:
    """The audit of one engine."""

    name: str
    version: str  # name and version of its package, empty for a user's engine
    dt: float  # s
    answers: probes.Answers
    measures: tuple[Measure, ...]  # of all possible defects
    pushed: Pushed
    pushed_half: Pushed  # at half the time step
    # effects that lower the price with the maps held fixed, best first
    explained: tuple[Explained, ...]
    standard: StandardPushes

    @property
    def defects(self) -> list[Measure]:
        """Measures that are defects."""
        return [measure for measure in self.measures if measure.named]

    @property
    def remedies(self) -> list[str]:
        """Settings that bring the engine closer to Coulomb's law."""
        found = (engines.remedy(self.name, defect.key) for defect in self.defects)
        return sorted(filter(None, found), key=lambda remedy: remedy.startswith("against"))

    def to_json(self) -> dict[str, Any]:
        """The audit as JSON."""
        return {
            "engine": self.name,
            "version": self.version,
            "step": self.dt,
            "price_mm": 1e3 * self.pushed.price,
            "worst_mm": 1e3 * self.pushed.errors.max(),
            "price_at_half_step_mm": 1e3 * self.pushed_half.price,
            "defects": [defect.key for defect in self.defects],
            "measures": [
                vars(measure) | {"named": measure.named} for measure in self.measures
            ],
            "remedies": self.remedies,
            "friction_by_direction": [
                {"degrees": float(np.degrees(way)), "over_coulomb": size, "leaning_degrees": lean}
                for way, size, lean in zip(
                    np.arctan2(*self.answers.direction.T[::-1]),
                    np.linalg.norm(self.answers.friction, axis=1),
                    np.degrees(probes.leaned(self.answers)),
                    strict=True,
                )
            ],
            "explained": [
                {
                    "effect": one.effect.name, "price_mm": 1e3 * one.price,
                    "parameters": {
                        p.name: value for p, value in zip(one.effect.parameters, one.values, strict=True)
                    },
                }
                for one in self.explained
            ],
        }  # fmt: skip


@one_blas_thread()
def audit(subject: Subject, standard: StandardPushes, report: Progress) -> Audit:
    """Audit one engine.

    Raises:
        BadInput: it fails.
    """
    half = subject.halved()
    answers, answers_half = (
        probes.ask(one, _counter(report, f"{subject.name}, probes at {1e3 * one.dt:g} ms", probes.COUNT))
        for one in (subject, half)
    )
    pushed, pushed_half = (
        push_all(one, standard, _counter(report, f"{subject.name}, pushes at {1e3 * one.dt:g} ms", COUNT))
        for one in (subject, half)
    )
    tried = [effect for effect in LIBRARY if effect.name in _LAWS] if pushed.price > NOTHING else []
    explained = []
    for number, effect in enumerate(tried):
        report(f"{subject.name}, fitting effects: {effect.name}", number, len(tried))
        explained.append(explain(pushed, standard, effect))
    better = [one for one in explained if one.price < _LOWER * pushed.price]
    better.sort(key=lambda one: one.price)
    return Audit(
        subject.name, engines.version(subject.name), subject.dt, answers,
        tuple(measures(answers, answers_half)), pushed, pushed_half, tuple(better), standard,
    )  # fmt: skip


def prices_beside(audited: Sequence[str], standard: StandardPushes, report: Progress) -> Mapping[str, float]:
    """Prices, m, of the installed built-in engines with default settings, without the audited ones."""
    result = {}
    for name in engines.installed():
        if name not in audited:
            counter = _counter(report, f"{name}, pushes for comparison", COUNT)
            try:
                result[name] = push_all(engines.find_engine(name), standard, counter).price
            except BadInput:  # an engine that does not run here is left out
                continue
    return result


def _counter(report: Progress, stage: str, total: int) -> probes.Report:
    report(stage, 0, total)
    return lambda done: report(stage, done, total)
