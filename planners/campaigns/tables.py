"""Numbers of a campaign with what chance leaves open of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

LEVEL = 0.95
"""Of all intervals."""


@dataclass(frozen=True)
class Estimate:
    """A number and its 95 % interval.

    Attributes:
        value: NaN where there is nothing to estimate it from.
        low, high: ends of the interval.
        count: trials that it comes from.
    """

    value: float
    low: float
    high: float
    count: int

    def percent(self) -> str:
        """As in a table: `97 (91 to 99)`."""
        return self.told(100.0, 0)

    def told(self, factor: float = 1.0, digits: int = 1) -> str:
        """Multiplied by a factor and rounded, such as `5.2 (4.9 to 5.5)`; a dash where there is nothing."""
        if not np.isfinite(self.value):
            return "–"
        value, low, high = (f"{factor * number:.{digits}f}" for number in (self.value, self.low, self.high))
        return f"{value} ({low} to {high})" if np.isfinite(self.low + self.high) else value

    def short(self, factor: float = 1.0, digits: int = 1) -> str:
        """As `told`, with half the interval's width, such as `5.2 ± 0.3`."""
        if not np.isfinite(self.high - self.low):
            return self.told(factor, digits)
        return f"{factor * self.value:.{digits}f} ± {factor * (self.high - self.low) / 2:.{digits}f}"

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, None for what is not known."""
        return {key: value if np.isfinite(value) else None for key, value in asdict(self).items()}


def share(successes: int, count: int) -> Estimate:
    """Of successes among `count` independent trials, with Wilson's interval.

    Raises:
        ValueError: numbers that are no share.
    """
    from scipy.stats import binomtest

    if count == 0 and successes == 0:
        return Estimate(float("nan"), 0.0, 1.0, 0)
    interval = binomtest(successes, count).proportion_ci(LEVEL, method="wilson")
    return Estimate(successes / count, float(interval.low), float(interval.high), count)


def mean(values: Sequence[float]) -> Estimate:
    """Of independent values, with Student's interval; no interval for fewer than two."""
    from scipy.stats import t

    data = np.asarray(values, dtype=float)
    count = len(data)
    if count == 0:
        return Estimate(float("nan"), float("nan"), float("nan"), 0)
    middle = float(data.mean())
    if count == 1:
        return Estimate(middle, float("nan"), float("nan"), 1)
    half = float(t.ppf(0.5 + LEVEL / 2, count - 1) * data.std(ddof=1) / np.sqrt(count))
    return Estimate(middle, middle - half, middle + half, count)
