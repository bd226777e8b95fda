"""By how much the camera's clock seems late beside the arm's, from how finger and object move."""

from __future__ import annotations

from dataclasses import dataclass, replace

from slipmap.models.effects.library import SensorLatency
from slipmap.models.inference.identification import identify
from slipmap.models.measurements import DatasetError, PushDataset
from slipmap.models.progress import Progress

_CERTAIN = 0.01
"""s up to which a lag may be none: poses that are seen past the arm may be half a millimetre too far along,
as if an object that is pushed at 50 mm/s were 10 ms early."""


@dataclass(frozen=True)
class CameraLag:
    """How late object poses are beside finger positions."""

    value: float  # s; negative where poses are early
    # low, high: 90 % interval over refits, widened by `_CERTAIN`, s
    low: float
    high: float
    pushes: int  # that show it

    @property
    def shown(self) -> bool:
        """Whether there certainly is a lag."""
        return not self.low <= 0.0 <= self.high

    def to_json(self) -> dict[str, float | int | bool]:
        """All fields, and whether there certainly is a lag."""
        return {**vars(self), "shown": self.shown}


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
        # The spread comes from refits, which take most of the time: eight will do.
        pushes = replace(dataset, trials=trials)
        found = identify(
            pushes, [SensorLatency()], hypotheses=8, seed=seed, progress=progress, friction_laws=False
        )
    except DatasetError:
        return None
    latency = next(q for q in found.quantities if q.name == "sensor_latency: latency")
    return CameraLag(latency.value, latency.low - _CERTAIN, latency.high + _CERTAIN, len(trials))
