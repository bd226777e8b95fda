"""The law of friction that slides show, and an engine that obeys it.

In slides of a plate of uniform weight and friction without rotation, friction is one force. Over the
direction of motion it is a sum of harmonics, and each defect has its own: a constant force one per turn, a
grain two, a pyramid four and more, and a lean a constant angle between friction and the line of motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from slipmap.diagrams.application.audit.engines import GRAVITY, MU, EngineScene
from slipmap.models.geometry import cross, rotated
from slipmap.models.physics.cell_grid import FloatArray

DIRECTIONS = np.arange(24) * np.pi / 12  # (24,) directions of the free slides, rad
STEADY_SPEEDS = np.array([0.02, 0.05, 0.1, 0.3])  # speeds of the steady slides along x, m/s
EARLY = (0.05, 0.45)  # evaluated share of the time until a slide stops, in which its direction changes little
_SLIDE_SPEEDS = np.array([0.2, 0.3, 0.45])  # m/s
_STEPS = 40  # fewest time steps until a free slide stops
_FINE = 4  # steps of a point per step of the engine
_FINE_SPIN = 2  # steps of the law's plate per step of the engine
_CORNER = 0.02  # share of the speed within which a pyramid's corners are round
_SLOWEST = 1e-9  # m/s, below which motion has no direction

PyramidKind = Literal["diamond", "square"]


@dataclass(frozen=True)
class Pyramid:
    """Degree to which friction follows a pyramid instead of a cone."""

    kind: PyramidKind
    share: float  # 1 for a pyramid, 0 for a cone


@dataclass(frozen=True, eq=False)
class Harmonics:
    """Dependence of friction on direction. Shares are of its mean along the motion."""

    pyramid: Pyramid
    along: FloatArray  # (2,) cosine and sine of twice the direction in the friction along the motion
    lean: float  # part of the friction across the motion that is the same in every direction
    across: FloatArray  # (2,) as `along`, across the motion, counter-clockwise
    force: FloatArray  # (2,) constant force over μ N, world
    scatter: float  # standard deviation of a slide from these harmonics, share of μ N
    # standard deviations of the above as far as they follow from the scatter
    along_unsure: float
    lean_unsure: float
    force_unsure: float

    @property
    def grain(self) -> float:
        """Half the difference of friction along and across a grain."""
        return float(np.hypot(*self.along))

    @property
    def leaning(self) -> float:
        """Largest angle between friction and the line of motion, rad, without what a grain explains.

        Counter-clockwise if positive.
        """
        # A variation of friction with direction of amplitude g deflects it by up to 2 g.
        varying = max(float(np.hypot(*self.across)) - 2 * self.grain, 0.0)
        return float(np.arctan(self.lean + (varying if self.lean >= 0 else -varying)))

    def friction(self, direction: FloatArray) -> FloatArray:
        """(n, 2) friction over its mean, without the constant force, for directions of motion (n, 2)."""
        twice = 2 * np.arctan2(direction[:, 1], direction[:, 0])
        waves = np.column_stack([np.cos(twice), np.sin(twice)])
        along, across = waves @ self.along, self.lean + waves @ self.across
        left = np.column_stack([-direction[:, 1], direction[:, 0]])
        return blended(direction, self.pyramid) - along[:, None] * direction - across[:, None] * left


@dataclass(frozen=True, eq=False)
class Law:
    """A law of friction."""

    harmonics: Harmonics
    of_object: bool  # whether the grain is of the object, not of the table
    level: FloatArray  # (4,) mean friction over directions at `STEADY_SPEEDS`, relative to Coulomb's

    def friction(self, velocity: FloatArray, heading: float) -> FloatArray:
        """(n, 2) friction over μ N, without the constant force, of cells.

        Args:
            velocity: (n, 2) world, m/s.
            heading: of the object, rad.
        """
        speed = np.linalg.norm(velocity, axis=1)
        direction = velocity / np.maximum(speed, _SLOWEST)[:, None]
        level = np.interp(speed, STEADY_SPEEDS, self.level)
        rise = (self.level[-1] - self.level[-2]) / (STEADY_SPEEDS[-1] - STEADY_SPEEDS[-2])
        level = level + rise * np.maximum(speed - STEADY_SPEEDS[-1], 0.0)
        turn = heading if self.of_object else 0.0
        return level[:, None] * rotated(self.harmonics.friction(rotated(direction, -turn)), turn)


class LawEngine:
    """An engine that obeys a `Law`; it has no finger."""

    dt: ClassVar[float]
    law: ClassVar[Law]

    def __init__(self, scene: EngineScene, gravity: FloatArray) -> None:
        self._load = scene.mu * scene.mass * GRAVITY
        self._mass, self._moment = scene.mass.sum(), scene.moment_of_inertia
        self._center = scene.center_of_mass
        self._arms = scene.grid.centers - self._center
        self._pull = gravity[:2] + self._load.sum() / self._mass * self.law.harmonics.force

    def reset(self, pose: FloatArray, velocity: FloatArray, tip: FloatArray) -> None:
        """See `Engine`."""
        arm = rotated(self._center, pose[2])
        self._place, self._angle, self._omega = pose[:2] + arm, float(pose[2]), float(velocity[2])
        self._velocity = velocity[:2] + self._omega * np.array([-arm[1], arm[0]])

    def step(
        self, tip: FloatArray, tip_velocity: FloatArray, next_tip: FloatArray, next_velocity: FloatArray
    ) -> FloatArray:
        """See `Engine`."""
        h = self.dt / _FINE_SPIN
        for _ in range(_FINE_SPIN):
            arms = rotated(self._arms, self._angle)
            velocity = self._velocity + self._omega * np.column_stack([-arms[:, 1], arms[:, 0]])
            force = self._load[:, None] * self.law.friction(velocity, self._angle)
            self._velocity = self._velocity + h * (force.sum(axis=0) / self._mass + self._pull)
            self._omega += h * float(cross(arms, force).sum()) / self._moment
            self._place = self._place + h * self._velocity
            self._angle += h * self._omega
        return np.zeros(2)

    def pose(self) -> FloatArray:
        """See `Engine`."""
        return np.append(self._place - rotated(self._center, self._angle), self._angle)


def pyramid_force(kind: str, direction: FloatArray) -> FloatArray:
    """(…, 2) friction over μ N of a full pyramid along the world's axes, for directions of motion (…, 2)."""
    x, y = direction[..., 0], direction[..., 1]
    if kind == "square":
        return np.stack([-_sign(x), -_sign(y)], axis=-1)
    up, down = _sign((x + y) / np.sqrt(2)), _sign((x - y) / np.sqrt(2))
    return np.stack([-(up + down) / 2, -(up - down) / 2], axis=-1)


def blended(direction: FloatArray, pyramid: Pyramid) -> FloatArray:
    """(…, 2) friction over μ N between a cone and a pyramid, for directions of motion (…, 2)."""
    return (pyramid.share - 1) * direction + pyramid.share * pyramid_force(pyramid.kind, direction)


def _sign(values: FloatArray) -> FloatArray:
    return values / np.sqrt(values**2 + _CORNER**2)


def slide_speeds(dt: float) -> FloatArray:
    """(3,) speeds of free slides, m/s, for a time step of the engine, s; higher for long steps."""
    return np.asarray(_SLIDE_SPEEDS * max(1.0, _STEPS * dt * MU * GRAVITY / _SLIDE_SPEEDS[0]))


def parabola(times: NDArray[np.floating[Any]], values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Velocity half-way and acceleration of values at given times, by least squares."""
    bend, slope, _ = np.polyfit(times - times.mean(), values, 2)
    return slope, 2 * bend


def seen_in_slides(paths: Sequence[FloatArray], dt: float) -> tuple[FloatArray, FloatArray]:
    """Mean direction and friction over μ N (…, 2) of free slides: paths (T + 1, …, 2), steps dt.

    The paths last for `EARLY[1]` of the time until they stop.
    """
    ways, frictions = [], []
    for path in paths:
        first = round(EARLY[0] / EARLY[1] * (len(path) - 1))
        times = dt * np.arange(float(first), len(path))
        flat = path[first:].reshape(len(times), -1)
        velocity, acceleration = (part.reshape(path.shape[1:]) for part in parabola(times, flat))
        ways.append(velocity / np.linalg.norm(velocity, axis=-1, keepdims=True))
        frictions.append(acceleration / (MU * GRAVITY))
    way = np.mean(ways, axis=0)
    return way / np.linalg.norm(way, axis=-1, keepdims=True), np.mean(frictions, axis=0)


def slides_of_point(
    friction: Callable[[FloatArray], FloatArray], dt: float, full_dt: float
) -> tuple[FloatArray, FloatArray]:
    """Direction and friction (24, 2), as in `seen_in_slides`, of free slides under a law of friction.

    Args:
        friction: maps directions of motion (24, 2) to friction over μ N (24, 2).
        dt, full_dt: of the `Subject`, s.
    """
    paths = []
    for speed in slide_speeds(full_dt):
        steps = round(EARLY[1] * speed / (MU * GRAVITY) / dt)
        velocity = speed * np.column_stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)])
        place = np.zeros_like(velocity)
        path = [place]
        for _ in range(steps):
            for _ in range(_FINE):
                length = np.linalg.norm(velocity, axis=1, keepdims=True)
                velocity = velocity + dt / _FINE * MU * GRAVITY * friction(velocity / length)
                place = place + dt / _FINE * velocity
            path.append(place)
        paths.append(np.array(path))
    return seen_in_slides(paths, dt)


def harmonics_of(direction: FloatArray, friction: FloatArray, dt: float, full_dt: float) -> Harmonics:
    """The best-fitting pyramid, with the other harmonics.

    Args:
        direction, friction: (24, 2) directions of motion and friction over μ N half-way of free slides.
        dt, full_dt: of the `Subject`, s.
    """

    def misfit(share: float, kind: PyramidKind) -> float:
        return _beside(direction, friction, Pyramid(kind, share), dt, full_dt).scatter

    kinds: tuple[PyramidKind, ...] = ("diamond", "square")
    fits = []
    for kind in kinds:
        best = minimize_scalar(
            misfit, args=(kind,), bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-3}
        )
        fits.append((float(best.fun), kind, float(best.x)))
    _, kind, share = min(fits)
    found = _beside(direction, friction, Pyramid(kind, share), dt, full_dt)
    # Paths that curve blur the harmonics. Slides of a point under the law that was found tell how much.
    seen = _beside(
        *slides_of_point(lambda u: found.friction(u) + found.force, dt, full_dt), found.pyramid, dt, full_dt
    )
    return replace(
        found, along=2 * found.along - seen.along, lean=2 * found.lean - seen.lean,
        across=2 * found.across - seen.across, force=2 * found.force - seen.force,
    )  # fmt: skip


def _beside(
    direction: FloatArray, friction: FloatArray, pyramid: Pyramid, dt: float, full_dt: float
) -> Harmonics:
    """Harmonics beside a given pyramid, by least squares."""
    way, force = slides_of_point(lambda u: blended(u, pyramid), dt, full_dt)
    angle = np.arctan2(direction[:, 1], direction[:, 0])
    c, s = np.cos(angle), np.sin(angle)
    waves, none, one = np.column_stack([np.cos(2 * angle), np.sin(2 * angle)]), np.zeros((24, 2)), np.ones(24)
    level, beside = -np.sum(force * way, axis=1), -cross(way, force)
    columns = np.vstack(
        [
            # mean, constant force, friction that is larger one way than back (as by place), grain
            np.column_stack([level, -c, -s, c, s, waves, 0 * one, none]),
            np.column_stack([beside, s, -c, none, none, one, waves]),
        ]
    )
    seen = np.append(-np.sum(friction * direction, axis=1), -cross(direction, friction))
    found, *_ = np.linalg.lstsq(columns, seen, rcond=None)
    left = columns @ found - seen
    scatter = float(np.sqrt(left @ left / (columns.shape[0] - columns.shape[1])))
    unsure = scatter * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
    mean = found[0]
    return Harmonics(
        pyramid, found[5:7] / mean, float(found[7] / mean), found[8:] / mean, found[1:3], scatter,
        float(unsure[5]), float(np.hypot(unsure[7], unsure[8])), float(unsure[1]),
    )  # fmt: skip
