"""Where a model fails: the conditions on which the residual velocity and the residual force depend.

A factor is a set of products feature × component. A component is a residual in some frame (along the motion,
along the table's x, counter-clockwise …); a feature is a number computed from the conditions. The factor
matters where the sum of such a product over pushes is larger than chance explains. Each factor is tested with
whole pushes as the unit of evidence (`sign_flips`), and all tests of one comparison are corrected together
(Holm). Size and test refer to the coordinate that deviates most, and the test asks whether it exceeds a
negligible size.

Learning from some of the pushes makes their residuals smaller than by chance, and those of the others larger,
since they share the errors of the maps. Over all pushes the first outweighs the second as long as no more
pushes are held out than fitted; the tests are then conservative.

The second part is the memory of the residual, its correlation with the finger's motion, and the delay of
measured poses. Neighbouring residuals within a push are similar, so the usual bounds ±1.96/√samples would
find correlation everywhere. Here the bounds come from whole pushes: for the autocorrelation from pairing each
push with another one, for the correlation with the finger from random signs of whole pushes, and both hold
for all lags together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slipmap.models.geometry import rotated
from slipmap.models.inference.observations import Observation
from slipmap.models.inference.prediction import Motion
from slipmap.models.inference.residuals import PHASE_NAMES, Conditions, Phase, Residuals, centroid_tracks
from slipmap.models.inference.sign_flips import (
    SignFlipTest,
    beyond,
    holm,
    push_sums,
    random_signs,
    sign_flip_test,
)
from slipmap.models.measurements.motion import interpolated
from slipmap.models.physics.cell_grid import CellGrid, FloatArray

Columns = dict[str, FloatArray]
"""Numbers (N,) of N pieces of pushes, by name."""

_Components = Callable[[Residuals], Columns]

_ALWAYS = "always"


@dataclass(frozen=True)
class Factor:
    """One condition that residuals are tested on."""

    name: str  # key, such as `table_direction`
    title: str  # display name, such as `direction of motion on the table`
    features: Callable[[Conditions], Columns]  # numbers computed from the conditions
    components: _Components  # of the residuals; all products of the two are tested together
    # whether it compares parts of one push, which is impossible where only the ends are known
    along_the_push: bool = False

    def products(self, residuals: Residuals) -> tuple[list[str], FloatArray, FloatArray]:
        """Names (d,), features (N, d) and components (N, d) of all products that can be formed.

        Features that vary with the conditions have mean 0 and mean square 1 over all pieces.
        """
        names, left, right = [], [], []
        for what, values in self.components(residuals).items():
            for when, feature in self.features(residuals.at).items():
                scaled = feature if when == _ALWAYS else _standard(feature, residuals.weights)
                if scaled is not None:
                    names.append(what if when == _ALWAYS else f"{what}{THEN}{when}")
                    left.append(scaled)
                    right.append(values)
        if not names:
            return [], np.zeros((len(residuals.at), 0)), np.zeros((len(residuals.at), 0))
        return names, np.column_stack(left), np.column_stack(right)


def _standard(feature: FloatArray, weights: FloatArray) -> FloatArray | None:
    known = np.isfinite(feature)
    if not known.any():
        return None
    w = weights[known] / weights[known].sum()
    centred = np.where(known, feature - w @ feature[known], 0.0)
    spread = np.sqrt(w @ centred[known] ** 2)
    return centred / spread if spread > 1e-9 else None


def _always(at: Conditions) -> Columns:
    return {_ALWAYS: np.ones(len(at))}


def _table_place(at: Conditions) -> Columns:
    return {"grows with table x": at.place[:, 0], "grows with table y": at.place[:, 1]}


def _contact_place(at: Conditions) -> Columns:
    x, y = at.contact.T
    return {"grows with the contact's x": x, "grows with the contact's y": y}


def _speed(at: Conditions) -> Columns:
    return {"grows with speed": np.log(np.maximum(at.speed, 1e-6))}


def _harmonics(angle: FloatArray, share: FloatArray, frame: str) -> Columns:
    waves = {
        f"more when moving towards {frame} +x rather than -x": np.cos(angle),
        f"more when moving towards {frame} +y rather than -y": np.sin(angle),
        f"more when moving along {frame} x rather than y": np.cos(2 * angle),
        f"more when moving along the {frame}'s diagonals": np.sin(2 * angle),
    }
    return {name: share * wave for name, wave in waves.items()}


def _table_direction(at: Conditions) -> Columns:
    return _harmonics(at.table_direction, at.translating, "table")


def _object_direction(at: Conditions) -> Columns:
    return _harmonics(at.object_direction, at.translating, "object")


def _phase(at: Conditions) -> Columns:
    return {f"more in {PHASE_NAMES[phase]}": (at.phase == phase).astype(float) for phase in Phase}


def _time(at: Conditions) -> Columns:
    return {"grows during the push": at.share}


def _order(at: Conditions) -> Columns:
    return {"grows from push to push": at.push.astype(float)}


def _world(residuals: Residuals) -> Columns:
    return {"along table x": residuals.relative[:, 0], "along table y": residuals.relative[:, 1]}


def _in_object(residuals: Residuals) -> Columns:
    x, y = rotated(residuals.relative, -residuals.at.angle).T
    return {"along object x": x, "along object y": y}


def _turning(residuals: Residuals) -> Columns:
    return {"turning counter-clockwise": residuals.relative[:, 2]}


WITH_ROTATION = "in the direction of its rotation"
"""Component of a residual that is too much or too little rotation, in `Pattern.strongest`."""


def _onward(residuals: Residuals) -> Columns:
    """Components along the centroid's motion and, for residual motion, in the direction of its rotation."""
    unit = residuals.at.velocity / np.maximum(residuals.at.speed, 1e-12)[:, None]
    if residuals.values.shape[1] == 2:
        return {"along the motion": (unit[:, :2] * residuals.relative).sum(axis=1)}
    return {
        "along the motion": (unit[:, :2] * residuals.relative[:, :2]).sum(axis=1),
        WITH_ROTATION: unit[:, 2] * residuals.relative[:, 2],
    }


def _sideways(residuals: Residuals) -> Columns:
    unit = residuals.at.velocity[:, :2] / np.maximum(residuals.at.speed, 1e-12)[:, None]
    x, y = residuals.relative[:, :2].T
    return {"to the left of the motion": unit[:, 0] * y - unit[:, 1] * x}


def _join(*components: _Components) -> _Components:
    return lambda residuals: {name: v for part in components for name, v in part(residuals).items()}


def _factors(
    amiss: str, *turned: _Components, place: _Components, contact: _Components
) -> tuple[Factor, ...]:
    """All conditions that residuals are tested on; `turned` are further components, for motion only."""
    directed = _join(_onward, _sideways, *turned)
    return (
        Factor("overall", f"everywhere {amiss}", _always, _onward),
        Factor("table_drift", "one direction on the table", _always, _join(_world, *turned)),
        Factor("object_drift", "one direction in the object frame", _always, _in_object),
        Factor("table_place", "place on the table", _table_place, place),
        Factor("contact_place", "place of contact on the object", _contact_place, contact),
        Factor("speed", "speed", _speed, _onward),
        Factor("table_direction", "direction of motion on the table", _table_direction, directed),
        Factor("object_direction", "direction of motion in the object frame", _object_direction, directed),
        Factor("phase", "phase of the push", _phase, _onward, along_the_push=True),
        Factor("time", "time within the push", _time, _onward, along_the_push=True),
        Factor("order", "order of the pushes", _order, _join(_onward, _world, *turned)),
    )


MOTION_FACTORS = _factors(
    "too far or too short",
    _turning,
    contact=_join(_in_object, _turning),
    place=_join(_world, _turning, _onward),
)
FORCE_FACTORS = _factors(
    "too strong or too weak", contact=_join(_in_object, _onward), place=_join(_world, _onward)
)

LEVEL = 0.05
"""Probability of any false alarm in one comparison."""

NEGLIGIBLE = {"motion": 0.005, "force": 0.03, "delay": 0.005}
"""Sizes up to which patterns are ignored; the tests ask whether there is more. Half a percent of the travel
is the model error that identification always allows; it weighs forces lightly, so their level is learned only
to a few percent; and half the model's longest step, 5 ms, does not count as a delay."""

THEN = "; "
"""Between a component of the residual and the feature with which it varies, in `Pattern.strongest`."""

OUTLYING = 2.0
"""A push whose residuals exceed those of the median push by more than this factor is scaled down to it."""


@dataclass(frozen=True)
class Pattern:
    """How strongly residuals depend on one factor, and whether chance explains that."""

    factor: str  # key of the factor, such as `table_direction`
    title: str  # display name
    quantity: str  # `motion`, `force` or `delay`
    strongest: str  # the product of feature and component that deviates most, in words
    # its size: residual per typical (rms) change of the feature, as a share of the push's speed (for motion)
    # or of the typical force (for force); for `delay` seconds
    size: float
    low: float  # lower end of its 95 % interval (pushes as units)
    high: float  # upper end
    p: float  # by sign flips of whole pushes
    p_corrected: float  # after Holm's correction over all patterns of the comparison
    pushes: int  # with any evidence

    @property
    def significant(self) -> bool:
        """Whether chance is an unlikely explanation, after correction for all tests."""
        return self.p_corrected < LEVEL

    @property
    def sureness(self) -> float:
        """Size over the half width of its interval, to order patterns with equal p-values."""
        return abs(self.size) / max(0.5 * (self.high - self.low), 1e-300)

    def to_json(self) -> dict[str, object]:
        """All fields, and whether it is significant."""
        return {**vars(self), "significant": self.significant}


def factor_patterns(
    residuals: Residuals, quantity: str, rng: np.random.Generator, *, whole_pushes: bool = False
) -> list[Pattern]:
    """Test residual velocities (`quantity` motion) or forces (`force`) on every factor, without correction.

    With `whole_pushes` only the ends of pushes are known, and factors within a push are left out.
    """
    factors = MOTION_FACTORS if quantity == "motion" else FORCE_FACTORS
    tempered = replace(
        residuals, values=residuals.values * push_weights(residuals)[residuals.at.push][:, None]
    )
    tested = [factor for factor in factors if not (whole_pushes and factor.along_the_push)]
    patterns = [_pattern(factor, tempered, quantity, rng) for factor in tested]
    return [pattern for pattern in patterns if pattern is not None]


def push_weights(residuals: Residuals) -> FloatArray:
    """(B,) factors, at most 1, that keep a push that no model explains from deciding everything.

    They depend on the size of the residuals, not on their sign, so the sign-flip test stays valid.
    """
    count = len(residuals.scale)
    weights = residuals.weights[:, None]
    squares = push_sums(weights * residuals.relative**2, residuals.at.push, count).sum(axis=1)
    sizes = np.sqrt(squares / np.maximum(push_sums(weights, residuals.at.push, count)[:, 0], 1e-300))
    used = sizes[sizes > 0]
    if len(used) == 0:
        return np.ones(count)
    return np.minimum(1.0, OUTLYING * np.median(used) / np.maximum(sizes, 1e-300))


def _pattern(factor: Factor, residuals: Residuals, quantity: str, rng: np.random.Generator) -> Pattern | None:
    names, features, components = factor.products(residuals)
    if not names:
        return None
    count = len(residuals.scale)
    weights = residuals.weights[:, None]
    total = push_sums(weights, residuals.at.push, count)
    total[total == 0] = 1.0
    # Every push counts the same, however long it took.
    scores = push_sums(weights * features * components, residuals.at.push, count) / total
    power = push_sums(weights * features**2, residuals.at.push, count) / total
    test = sign_flip_test(beyond(scores, power, NEGLIGIBLE[quantity]), rng)
    return described(test, scores, power, names, factor.name, factor.title, quantity)


def described(
    test: SignFlipTest, scores: FloatArray, power: FloatArray, names: Sequence[str], factor: str, title: str,
    quantity: str,
) -> Pattern:  # fmt: skip
    """Pattern of the strongest coordinate: its slope, with the sandwich interval over pushes.

    Args:
        scores: (B, d) sums of feature times residual.
        power: (B, d) sums of squared features, so that the slope is the ratio of both sums over pushes.
        names: (d,) of the coordinates; factor, title and quantity are as in `Pattern`.
    """
    j = test.strongest
    whole = max(float(power[:, j].sum()), 1e-300)
    slope = scores[:, j].sum() / whole
    spread = 1.96 * np.sqrt(((scores[:, j] - slope * power[:, j]) ** 2).sum()) / whole
    return Pattern(
        factor, title, quantity, names[j], float(slope), float(slope - spread), float(slope + spread),
        test.p, test.p, int((scores != 0).any(axis=1).sum()),
    )  # fmt: skip


def corrected(patterns: Sequence[Pattern]) -> tuple[Pattern, ...]:
    """Patterns with p-values corrected for their number, the most certain first."""
    together = holm(np.array([pattern.p for pattern in patterns]))
    results = [replace(pattern, p_corrected=float(p)) for pattern, p in zip(patterns, together, strict=True)]
    return tuple(sorted(results, key=lambda pattern: (pattern.p, -pattern.sureness)))


_LAG_STEP, _LONGEST_LAG = 0.05, 1.0  # s
_DRAWS = 1999
_LEAST_PUSHES = 4


@dataclass(frozen=True, eq=False)
class Correlation:
    """Correlation over lags, with the bounds of chance."""

    name: str  # `memory`, `finger_along` or `finger_left`
    lags: FloatArray  # (L,) s; at a positive one the residual follows
    values: FloatArray  # (L,) correlation, -1 to 1
    bounds: FloatArray  # (L,) chance keeps |values| below them at all lags together with 95 % probability
    p: float  # of the largest excess


@dataclass(frozen=True, eq=False)
class Correlations:
    """All correlations of one comparison."""

    memory: Correlation  # of the residual with itself
    finger_along: Correlation  # of the residual with the finger's velocity, in its direction
    finger_left: Correlation  # of the residual with the finger's velocity, to its left
    memory_time: float  # lag at which the memory has fallen to 1/e, s; NaN if it never does
    independent: float  # approximate number of independent residuals per push: its duration over twice that


@dataclass(frozen=True, eq=False)
class _Track:
    """One push at evenly spaced times: residual (n, 3) and velocity of the finger (n, 2)."""

    residual: FloatArray
    finger: FloatArray


def correlations(
    observations: Sequence[Observation], motions: Sequence[Motion], grid: CellGrid, rng: np.random.Generator
) -> Correlations | None:
    """Correlations over all pushes that were measured along the way; None where there are too few."""
    found = [_track(o, motion, grid) for o, motion in zip(observations, motions, strict=True)]
    tracks = [track for track in found if track is not None]
    if len(tracks) < _LEAST_PUSHES:
        return None
    typical = int(np.median([len(track.residual) for track in tracks]))
    most = max(2, min(round(_LONGEST_LAG / _LAG_STEP), typical // 2))
    memory = _memory(tracks, most, rng)
    below = np.flatnonzero(memory.values < np.exp(-1.0))
    time = float(memory.lags[below[0]]) if len(below) else float("nan")
    duration = _LAG_STEP * float(np.mean([len(track.residual) for track in tracks]))
    return Correlations(
        memory=memory,
        finger_along=_with_finger(tracks, most, "finger_along", rng),
        finger_left=_with_finger(tracks, most, "finger_left", rng),
        memory_time=time,
        independent=max(1.0, duration / (2 * time)) if np.isfinite(time) else 1.0,
    )


def delay_pattern(
    observations: Sequence[Observation], motions: Sequence[Motion], grid: CellGrid, rng: np.random.Generator
) -> Pattern | None:
    """Delay of measured poses: minus the slope of the residual over the predicted velocity."""
    scores, powers = [], []
    for observation, motion in zip(observations, motions, strict=True):
        if len(observation.poses) < 3:
            continue
        times, measured, predicted = centroid_tracks(observation, motion.middle_poses, grid)
        velocity = np.gradient(predicted, np.maximum.accumulate(times + 1e-9 * np.arange(len(times))), axis=0)
        speed = np.sqrt((velocity**2).sum(axis=1).mean())
        if speed == 0.0:
            continue
        # A constant delay shows as a residual that follows changes of velocity; a residual that grows along
        # the push is not a delay, so mean and trend of both are removed first.
        residual, motion_now = (_without_trend(values, times) for values in (measured - predicted, velocity))
        scores.append((residual * motion_now).sum() / speed**2 / len(times))
        powers.append((motion_now**2).sum() / speed**2 / len(times))
    if len(scores) < _LEAST_PUSHES:
        return None
    values = -np.array(scores)[:, None]
    sizes = np.abs(values[:, 0])
    limit = OUTLYING * np.median(sizes)
    tempered = values * np.minimum(1.0, limit / np.maximum(sizes, 1e-300))[:, None]
    power = np.array(powers)[:, None]
    test = sign_flip_test(beyond(tempered, power, NEGLIGIBLE["delay"]), rng)
    return described(
        test, tempered, power, ["measured pose behind the predicted one"], "delay",
        "delay of the measured pose", "delay",
    )  # fmt: skip


def _without_trend(values: FloatArray, times: FloatArray) -> FloatArray:
    basis = np.column_stack([np.ones(len(times)), times])
    return values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]


def _track(observation: Observation, motion: Motion, grid: CellGrid) -> _Track | None:
    if len(observation.poses) < 3 or np.isnan(observation.push.tip).any():
        return None
    times, measured, predicted = centroid_tracks(observation, motion.middle_poses, grid)
    even = np.arange(0.0, times[-1], _LAG_STEP)
    if len(even) < 4:
        return None
    push = observation.push
    steps = push.h * np.arange(len(push.tip))
    residual = interpolated(even, times, measured - predicted)
    tip = interpolated(even, steps, push.tip)
    size = np.sqrt((residual**2).sum(axis=1).mean())
    finger = np.gradient(tip, _LAG_STEP, axis=0)
    speed = np.sqrt((finger**2).sum(axis=1).mean())
    if size == 0.0 or speed == 0.0:
        return None
    # Each push counts the same: residual and finger speed are scaled to a mean square of one.
    return _Track(residual / size, finger / speed)


def _memory(tracks: list[_Track], most: int, rng: np.random.Generator) -> Correlation:
    """Autocorrelation at every lag; correlations between different pushes give the bounds of chance."""
    B = len(tracks)
    longest = max(len(track.residual) for track in tracks)
    padded = np.zeros((B, longest, 3))
    for b, track in enumerate(tracks):
        padded[b, : len(track.residual)] = track.residual
    total = float((padded**2).sum())
    lags = np.arange(most + 1)
    pairs = np.array(
        [np.einsum("asc,bsc->ab", padded[:, : longest - k], padded[:, k:]) / total for k in lags]
    )
    values = pairs[:, np.arange(B), np.arange(B)].sum(axis=1)
    chance = np.empty((_DRAWS, len(lags)))
    for draw in range(_DRAWS):
        order = rng.permutation(B)
        signs = 1.0 - 2.0 * rng.integers(0, 2, B)
        chance[draw] = (pairs[:, order, np.roll(order, 1)] * signs).sum(axis=1)
    return _bounded("memory", lags, values, chance, skip=1)


def _with_finger(tracks: list[_Track], most: int, name: str, rng: np.random.Generator) -> Correlation:
    lags = np.arange(-most, most + 1)
    per_push = np.zeros((len(tracks), len(lags)))
    for b, track in enumerate(tracks):
        finger = track.finger
        if name == "finger_left":
            finger = np.column_stack([-finger[:, 1], finger[:, 0]])
        n = len(finger)
        for j, k in enumerate(lags):
            if abs(k) >= n:
                continue
            later, now = (slice(k, n), slice(0, n - k)) if k >= 0 else (slice(0, n + k), slice(-k, n))
            per_push[b, j] = (track.residual[later, :2] * finger[now]).sum() / n
    chance = random_signs(_DRAWS, len(tracks), rng) @ per_push / len(tracks)
    return _bounded(name, lags, per_push.mean(axis=0), chance)


def _bounded(
    name: str, lags: NDArray[np.int64], values: FloatArray, chance: FloatArray, skip: int = 0
) -> Correlation:
    """Bounds that hold jointly at all lags (in steps) from `skip` on."""
    scale = np.sqrt((chance**2).mean(axis=0))
    scale = np.maximum(scale, 1e-12)
    largest = (np.abs(chance) / scale)[:, skip:].max(axis=1)
    found = float((np.abs(values) / scale)[skip:].max())
    p = (1 + int((largest >= found).sum())) / (1 + len(chance))
    return Correlation(name, np.array(_LAG_STEP * lags), values, float(np.quantile(largest, 0.95)) * scale, p)
