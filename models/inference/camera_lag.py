"""By how much the camera's clock seems late beside the arm's, told from how finger and object move."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from slipmap.models.effects.library import SensorLatency
from slipmap.models.inference.diagnosis.effect_fit import fit_effects
from slipmap.models.measurements import DatasetError, PushDataset

Progress = Callable[[str, int, int], None]

HYPOTHESES = 8
"""Refits from which the spread comes; they take most of the time."""

CERTAIN = 0.01
"""s up to which a lag may be none: poses that are seen past the arm may be half a millimetre too far along,
as if an object that is pushed at 50 mm/s were 10 ms early."""


@dataclass(frozen=True)
class CameraLag:
    """How late object poses are beside finger positions.

    Attributes:
        value: s; negative where poses are early.
        low, high: 90 % interval over refits, widened by `CERTAIN`, s.
        pushes: from which it was told.
    """

    value: float
    low: float
    high: float
    pushes: int

    @property
    def shown(self) -> bool:
        """Whether there certainly is a lag."""
        return not self.low <= 0.0 <= self.high

    def to_json(self) -> dict[str, float | int | bool]:
        """All fields, and whether there certainly is a lag."""
        fields = {"value": self.value, "low": self.low, "high": self.high, "pushes": self.pushes}
        return {**fields, "shown": self.shown}


def camera_lag(dataset: PushDataset, *, seed: int = 0, progress: Progress | None = None) -> CameraLag | None:
    """Learn maps and the effect `sensor_latency` together from all pushes; None where they cannot tell.

    They tell where the object was seen while the finger pushed: its first motion, and any change of speed,
    fixes the time between the two clocks. All roles count, since nothing is judged.

    Args:
        dataset: measured pushes.
        seed: of the refits.
        progress: called with (stage, done, total).
    """
    trials = tuple(replace(trial, role="fit") for trial in dataset.trials if not trial.ends_only)
    if not trials:
        return None
    try:
        found = fit_effects(
            replace(dataset, trials=trials), [SensorLatency()],
            hypotheses=HYPOTHESES, seed=seed, progress=progress,
        )  # fmt: skip
    except DatasetError:
        return None
    latency = next(q for q in found.quantities if q.name == "sensor_latency: latency")
    return CameraLag(latency.value, latency.low - CERTAIN, latency.high + CERTAIN, len(trials))
