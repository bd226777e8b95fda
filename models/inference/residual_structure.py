"""Where a model fails: which conditions the residual velocity and the residual force hang together with.

Each factor is tested with whole pushes as the unit of evidence (`push_tests`), and all tests of one
comparison are corrected together (Holm). Size and test are about the coordinate that deviates most, and the
question is whether it is more than a negligible size.

Learning from some of the pushes makes their residuals smaller than chance, and those of the others larger,
since the errors of the maps are common to them. Over all pushes together the first outweighs the second as
long as no more pushes are held out than fitted, so that the tests then err to the safe side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from models.inference.push_tests import SignFlipTest, holm, push_sums, sign_flip_test
from models.inference.residual_factors import FORCE_FACTORS, MOTION_FACTORS, Factor
from models.inference.residuals import Residuals
from models.physics.cell_grid import FloatArray

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
