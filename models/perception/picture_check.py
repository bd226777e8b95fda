"""Whether a depth picture can be believed: a camera may stop, repeat itself, or send half a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from slipmap.models.perception.object_mask import Mask
from slipmap.models.perception.pinhole_camera import DepthImage

Fault = Literal["", "no picture", "old picture", "torn picture", "corrupt picture"]

REMEMBERED = 4
"""Pictures with whose rows those of a new one are compared."""

_SPAN = (0.05, 20.0)  # m; a finite reading beyond is none
_USABLE = 30  # readings that make a row worth comparing
_TORN = 0.02  # of the rows
_CORRUPT = 0.1  # of the pixels, without a reading beyond those that usually have none
_SPOILT = 0.01  # the same for a picture in which the object is not found


@dataclass(frozen=True, eq=False)
class PictureHistory:
    """What is known of the pictures before."""

    # sums (H,) of the rows of the newest that could be believed, at most `REMEMBERED`
    recent: tuple[NDArray[np.uint64], ...] = ()
    taken: float = 0.0  # when the newest was, s
    # whether no two pictures of this camera have a row in common, so that one that does is not new
    noisy: bool = False
    missing: float = 1.0  # usual share of pixels without a reading

    def learned(self, frames: Sequence[DepthImage], blocked: Mask | None) -> PictureHistory:
        """With what pictures (H, W) of a scene at rest tell of their noise.

        Two pictures of a camera without noise have rows in common wherever nothing moves.
        """
        noisy = any(
            not (_row_sums(one) == _row_sums(other))[_usable(one)].any() for one, other in pairwise(frames)
        )
        return replace(self, noisy=noisy, missing=float(np.mean([missing(f, blocked) for f in frames])))

    def judged(
        self, image: DepthImage, taken: float, now: float, oldest: float, blocked: Mask | None
    ) -> tuple[Fault, bool, PictureHistory]:
        """What is wrong with a picture, whether it is new, and the history with it.

        Args:
            image: (H, W) m, as from `readings`.
            taken: when it was, as its sender says, s.
            now: s.
            oldest: age from which a picture is too old, s.
            blocked: (H, W) pixels that show the arm.
        """
        sums, usable = _row_sums(image), _usable(image)
        same = [(sums == other)[usable] for other in self.recent] if self.noisy else []
        new = taken > self.taken + 1e-6 or not self.recent
        if new and not any(len(rows) and rows.all() for rows in same):
            if any(rows.mean() > _TORN for rows in same if len(rows)):
                return "torn picture", True, self
            if missing(image, blocked) > self.missing + _CORRUPT:
                return "corrupt picture", True, self
            return "", True, replace(self, recent=(*self.recent, sums)[-REMEMBERED:], taken=taken)
        return ("old picture" if now - self.taken > oldest else ""), False, self

    def spoilt(self, image: DepthImage, blocked: Mask | None) -> bool:
        """Whether pixels without a reading may be why an object is not found."""
        return missing(image, blocked) > self.missing + _SPOILT


def readings(image: DepthImage) -> DepthImage:
    """A copy (H, W) of a depth picture, m; 0 for all that cannot be a reading, inf beyond the range."""
    low, high = _SPAN
    possible = (image >= low) & ((image <= high) | np.isposinf(image))
    return np.where(possible, image, np.float32(0))


def missing(image: DepthImage, blocked: Mask | None) -> float:
    """Share of the pixels without a reading, of those that do not show the arm."""
    empty = image == 0 if blocked is None else (image == 0)[~blocked]
    return float(empty.mean()) if empty.size else 1.0


def _row_sums(image: DepthImage) -> NDArray[np.uint64]:
    """(H,) a number for each row of a picture that is practically never that of another row."""
    bits = np.ascontiguousarray(image, dtype=np.float32).view(np.uint32).astype(np.uint64)
    weights = np.random.default_rng(0).integers(1, 2**63, size=bits.shape[1], dtype=np.uint64)
    return np.asarray(bits @ (2 * weights + 1))  # modulo 2^64


def _usable(image: DepthImage) -> NDArray[np.bool_]:
    """(H,) rows with readings enough to be worth comparing."""
    return np.asarray((np.isfinite(image) & (image > 0)).sum(axis=1) >= _USABLE)
