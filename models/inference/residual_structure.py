"""Where a model fails: which conditions the residual velocity and the residual force hang together with.

Each factor is tested with whole pushes as the unit of evidence (`push_tests`), and all tests of one
comparison are corrected together (Holm). Size and test are about the coordinate that deviates most, and the
question is whether it is more than a negligible size.

Learning from some of the pushes makes their residuals smaller than chance, and those of the others larger,
since the errors of the maps are common to them. Over all pushes together the first outweighs the second as
long as no more pushes are held out than fitted, so that the tests then err to the safe side.

A factor is a set of products feature × component. A component is a residual in some frame (along the
motion, towards the table's x, counter-clockwise …); a feature is a number that the conditions give. The
factor matters where the sum of such a product over pushes is larger than chance explains.

Residuals along a push are one story told many times, so samples are never counted. A test sums, for each
push b, the scores g_b = Σ_i φ(x_i) y_i of residuals y_i on features φ of their conditions x_i. If nothing
is wrong but chance, the residuals of a whole push could as well have had the other sign, however they hang
together within the push. Hence the distribution of

    max_j |Σ_b g_bj| / √(Σ_b g_bj²)

under random signs of whole pushes gives its p-value, without any assumption on correlation or variance
inside pushes (sign-flipping score test; Hemerik, Goeman and Finos, 2020). The maximum over coordinates j
takes care of their number.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slipmap.models.inference.residuals import PHASE_NAMES, Conditions, Phase, Residuals
from slipmap.models.physics.cell_grid import FloatArray

# What residuals may hang together with: the conditions that are looked at, as features and components.


Columns = dict[str, FloatArray]

LEAST_SPREAD = 1e-9


@dataclass(frozen=True)
class Factor:
    """One condition that residuals are held against.

    Attributes:
        name: key, such as `table_direction`.
        title: for a person, such as `direction of motion on the table`.
        blocks: pairs of (features, components); all their products are tested together.
        along_the_push: whether it compares parts of one push, which a push known by its ends cannot show.
    """

    name: str
    title: str
    blocks: tuple[tuple[Callable[[Conditions], Columns], Callable[[Residuals], Columns]], ...]
    along_the_push: bool = False

    def products(self, residuals: Residuals) -> tuple[list[str], FloatArray, FloatArray]:
        """Names (d,), features (N, d) and components (N, d) of all products that can be formed.

        Features that vary with the conditions have mean 0 and mean square 1 over all pieces.
        """
        names, left, right = [], [], []
        for features, components in self.blocks:
            for what, values in components(residuals).items():
                for when, feature in features(residuals.at).items():
                    scaled = feature if when == ALWAYS else _standard(feature, residuals.weights)
                    if scaled is not None:
                        names.append(what if when == ALWAYS else f"{what}, {when}")
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
    return centred / spread if spread > LEAST_SPREAD else None


ALWAYS = "always"


def _always(at: Conditions) -> Columns:
    return {ALWAYS: np.ones(len(at))}


def _table_place(at: Conditions) -> Columns:
    return {"more at larger table x": at.place[:, 0], "more at larger table y": at.place[:, 1]}


def _contact_place(at: Conditions) -> Columns:
    x, y = at.contact.T
    return {"more where contact has larger object x": x, "more where contact has larger object y": y}


def _speed(at: Conditions) -> Columns:
    return {"more at higher speed": np.log(np.maximum(at.speed, 1e-6))}


def _harmonics(angle: FloatArray, share: FloatArray, frame: str) -> Columns:
    waves = {
        f"moving towards {frame} +x against -x": np.cos(angle),
        f"moving towards {frame} +y against -y": np.sin(angle),
        f"moving along {frame} x against y": np.cos(2 * angle),
        f"moving along the {frame}'s diagonals": np.sin(2 * angle),
    }
    return {name: share * wave for name, wave in waves.items()}


def _table_direction(at: Conditions) -> Columns:
    return _harmonics(at.table_direction, at.translating, "table")


def _object_direction(at: Conditions) -> Columns:
    return _harmonics(at.object_direction, at.translating, "object")


def _phase(at: Conditions) -> Columns:
    return {f"more in {PHASE_NAMES[phase]}": (at.phase == phase).astype(float) for phase in Phase}


def _time(at: Conditions) -> Columns:
    return {"more later in the push": at.share}


def _order(at: Conditions) -> Columns:
    return {"more in later pushes": at.push.astype(float)}


def world(residuals: Residuals) -> Columns:
    """Components towards the table's axes."""
    return {"towards table x": residuals.relative[:, 0], "towards table y": residuals.relative[:, 1]}


def in_object(residuals: Residuals) -> Columns:
    """Components towards the object's axes."""
    x, y = residuals.relative[:, :2].T
    c, s = np.cos(residuals.at.angle), np.sin(residuals.at.angle)
    return {"towards object x": c * x + s * y, "towards object y": c * y - s * x}


def turning(residuals: Residuals) -> Columns:
    """Turning, counter-clockwise."""
    return {"turning counter-clockwise": residuals.relative[:, 2]}


def onward(residuals: Residuals) -> Columns:
    """Along the motion of the centroid and, for residual motion, in the sense of its turning."""
    unit = residuals.at.velocity / np.maximum(residuals.at.speed, 1e-12)[:, None]
    if residuals.values.shape[1] == 2:
        return {"along the motion": (unit[:, :2] * residuals.relative).sum(axis=1)}
    return {
        "along the motion": (unit[:, :2] * residuals.relative[:, :2]).sum(axis=1),
        "in the sense of its turning": unit[:, 2] * residuals.relative[:, 2],
    }


def sideways(residuals: Residuals) -> Columns:
    """To the left of the motion."""
    unit = residuals.at.velocity[:, :2] / np.maximum(residuals.at.speed, 1e-12)[:, None]
    x, y = residuals.relative[:, :2].T
    return {"to the left of the motion": unit[:, 0] * y - unit[:, 1] * x}


def _join(*components: Callable[[Residuals], Columns]) -> Callable[[Residuals], Columns]:
    return lambda residuals: {name: v for part in components for name, v in part(residuals).items()}


MOTION_FACTORS = (
    Factor("overall", "everywhere alike: too far or too short", ((_always, onward),)),
    Factor("table_drift", "one direction of the table", ((_always, _join(world, turning)),)),
    Factor("object_drift", "one direction of the object", ((_always, in_object),)),
    Factor("table_place", "place on the table", ((_table_place, _join(world, turning, onward)),)),
    Factor("contact_place", "place of contact on the object", ((_contact_place, _join(in_object, turning)),)),
    Factor("speed", "speed", ((_speed, onward),)),
    Factor(
        "table_direction",
        "direction of motion on the table",
        ((_table_direction, _join(onward, sideways, turning)),),
    ),
    Factor(
        "object_direction",
        "direction of motion seen from the object",
        ((_object_direction, _join(onward, sideways, turning)),),
    ),
    Factor("phase", "phase of the push", ((_phase, onward),), along_the_push=True),
    Factor("time", "time within the push", ((_time, onward),), along_the_push=True),
    Factor("order", "order of the pushes", ((_order, _join(onward, world, turning)),)),
)

FORCE_FACTORS = (
    Factor("overall", "everywhere alike: too strong or too weak", ((_always, onward),)),
    Factor("table_drift", "one direction of the table", ((_always, world),)),
    Factor("object_drift", "one direction of the object", ((_always, in_object),)),
    Factor("table_place", "place on the table", ((_table_place, _join(world, onward)),)),
    Factor("contact_place", "place of contact on the object", ((_contact_place, _join(in_object, onward)),)),
    Factor("speed", "speed", ((_speed, onward),)),
    Factor(
        "table_direction", "direction of motion on the table", ((_table_direction, _join(onward, sideways)),)
    ),
    Factor(
        "object_direction",
        "direction of motion seen from the object",
        ((_object_direction, _join(onward, sideways)),),
    ),
    Factor("phase", "phase of the push", ((_phase, onward),), along_the_push=True),
    Factor("time", "time within the push", ((_time, onward),), along_the_push=True),
    Factor("order", "order of the pushes", ((_order, _join(onward, world)),)),
)


# Tests whose unit of evidence is the push: sign flips of whole pushes, and Holm's correction.


FLIPS = 9999
EXHAUSTIVE = 12
"""With so few pushes all patterns of signs are tried."""


@dataclass(frozen=True, eq=False)
class SignFlipTest:
    """Result of one test.

    Attributes:
        z: (d,) standardised sum of each coordinate.
        p: probability of so large a maximum by chance alone.
    """

    z: FloatArray
    p: float

    @property
    def strongest(self) -> int:
        """Coordinate that deviates most."""
        return int(np.argmax(np.abs(self.z)))


def sign_flip_test(scores: FloatArray, rng: np.random.Generator, flips: int = FLIPS) -> SignFlipTest:
    """Test scores (B, d) of B pushes against sign flips of whole pushes."""
    scores = scores[(scores != 0).any(axis=1)]
    B, d = scores.shape
    scale = np.sqrt((scores**2).sum(axis=0))
    if B == 0 or not (scale > 0).any():
        return SignFlipTest(np.zeros(d), 1.0)
    scores = scores / np.where(scale > 0, scale, 1.0)
    z = scores.sum(axis=0)
    largest = np.abs(z).max()
    signs = all_signs(B) if B <= EXHAUSTIVE else random_signs(flips, B, rng)
    beyond = int((np.abs(signs @ scores).max(axis=1) >= largest * (1 - 1e-9)).sum())
    # All patterns hold the observed one; random ones need it added for the test to be exact.
    p = beyond / len(signs) if B <= EXHAUSTIVE else (1 + beyond) / (1 + len(signs))
    return SignFlipTest(z, float(p))


def all_signs(count: int) -> FloatArray:
    """(2^count, count) every pattern of signs."""
    bits = (np.arange(2**count)[:, None] >> np.arange(count)) & 1
    return np.where(bits == 1, -1.0, 1.0)


def random_signs(draws: int, count: int, rng: np.random.Generator) -> FloatArray:
    """(draws, count) random signs."""
    return np.where(rng.integers(0, 2, size=(draws, count)) == 1, -1.0, 1.0)


def smallest_p(pushes: int) -> float:
    """The smallest p-value that so many pushes can give: all signs equal, or all turned."""
    if pushes == 0:
        return 1.0
    return 2.0 ** (1 - pushes) if pushes <= EXHAUSTIVE else 1.0 / (FLIPS + 1)


def holm(p: FloatArray) -> FloatArray:
    """(m,) p-values of m tests corrected so that 5 % is the chance of any false alarm (Holm, 1979)."""
    p = np.asarray(p, dtype=float)
    order = np.argsort(p)
    steps = p[order] * np.arange(len(p), 0, -1)
    corrected = np.empty(len(p))
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(steps))
    return corrected


def push_sums(rows: FloatArray, push: NDArray[np.int64], count: int) -> FloatArray:
    """(count, d) sums of rows (N, d) over each push."""
    sums = np.zeros((count, rows.shape[1]))
    np.add.at(sums, push, rows)
    return sums


LEVEL = 0.05
"""Chance of any false alarm in one comparison."""

NEGLIGIBLE = {"motion": 0.005, "force": 0.03, "delay": 0.005}
"""Patterns up to these sizes are not looked for; the tests ask whether there is more. Half a percent of the
way is what identification allows its model anyway; the level of forces is learnt to a few percent, since
it weighs them lightly; and half the model's longest step, 5 ms, is no delay."""

OUTLYING = 2.0
"""A push whose residuals are larger than this many times the median push's is scaled down to that."""


@dataclass(frozen=True)
class Pattern:
    """One factor, how strongly residuals hang together with it, and whether chance explains that.

    Attributes:
        factor: key of the factor, such as `table_direction`.
        title: for a person.
        quantity: `motion`, `force` or `delay`.
        strongest: the product of feature and component that deviates most, in words.
        size: its size: residual per typical (rms) change of the feature, as a share of the push's speed (for
            motion) or of the typical force (for force); for `delay` seconds.
        low: lower end of its 95 % interval (pushes as units).
        high: upper end.
        p: by sign flips of whole pushes.
        p_corrected: after Holm's correction over all patterns of the comparison.
        pushes: with any evidence.
    """

    factor: str
    title: str
    quantity: str
    strongest: str
    size: float
    low: float
    high: float
    p: float
    p_corrected: float
    pushes: int

    @property
    def significant(self) -> bool:
        """Whether chance is an unlikely explanation, all tests considered."""
        return self.p_corrected < LEVEL

    @property
    def sureness(self) -> float:
        """Size over the half width of its interval, which orders patterns of one p-value."""
        return abs(self.size) / max(0.5 * (self.high - self.low), 1e-300)

    def to_json(self) -> dict[str, object]:
        """All fields, and whether it is significant."""
        return {**asdict(self), "significant": self.significant}


def factor_patterns(
    residuals: Residuals, quantity: str, rng: np.random.Generator, *, whole_pushes: bool = False
) -> list[Pattern]:
    """Test residual velocities (`quantity` motion) or forces (`force`) on every factor; not yet corrected.

    Args:
        residuals: velocities or forces of B pushes.
        quantity: `motion` or `force`.
        rng: of the sign flips.
        whole_pushes: only ends of pushes are known, so factors within a push are left out.
    """
    factors = MOTION_FACTORS if quantity == "motion" else FORCE_FACTORS
    tempered = replace(
        residuals, values=residuals.values * push_weights(residuals)[residuals.at.push][:, None]
    )
    patterns = [
        _pattern(factor, tempered, quantity, rng)
        for factor in factors
        if not (whole_pushes and factor.along_the_push)
    ]
    return [pattern for pattern in patterns if pattern is not None]


def push_weights(residuals: Residuals) -> FloatArray:
    """(B,) factors, at most 1, that keep a push which no model explains from deciding everything.

    They depend on the size of residuals and not on their sign, which the sign-flip test allows.
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
    # Every push counts alike, however long it took.
    scores = push_sums(weights * features * components, residuals.at.push, count) / total
    power = push_sums(weights * features**2, residuals.at.push, count) / total
    test = sign_flip_test(beyond(scores, power, NEGLIGIBLE[quantity]), rng)
    return described(test, scores, power, names, factor.name, factor.title, quantity)


def beyond(scores: FloatArray, power: FloatArray, slope: float) -> FloatArray:
    """Scores (B, d) less those of a pattern of a negligible size, so that only larger ones show in a test.

    Args:
        scores: (B, d) sums of feature times residual.
        power: (B, d) sums of squared features.
        slope: what is negligible. Coordinates whose own slope is smaller become 0.
    """
    total = scores.sum(axis=0)
    larger = np.abs(total) > slope * power.sum(axis=0)
    return np.where(larger, scores - np.sign(total) * slope * power, 0.0)


def described(
    test: SignFlipTest, scores: FloatArray, power: FloatArray, names: Sequence[str], factor: str, title: str,
    quantity: str,
) -> Pattern:  # fmt: skip
    """Pattern of the strongest coordinate: slope, with the sandwich interval over pushes.

    Args:
        test: of the scores.
        scores: (B, d) sums of feature times residual.
        power: (B, d) sums of squared features, so that the slope is the ratio of both sums over pushes.
        names: (d,) of the coordinates.
        factor: key.
        title: for a person.
        quantity: `motion`, `force` or `delay`.
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
    """Patterns with p-values corrected for their number, the surest first."""
    together = holm(np.array([pattern.p for pattern in patterns]))
    results = [replace(pattern, p_corrected=float(p)) for pattern, p in zip(patterns, together, strict=True)]
    return tuple(sorted(results, key=lambda pattern: (pattern.p, -pattern.sureness)))
