"""Lag of the camera's clock behind the arm's, from the motion of finger and object."""

from __future__ import annotations

from dataclasses import dataclass, replace

from slipmap.models.blas import one_blas_thread
from slipmap.models.effects.library import SensorLatency
from slipmap.models.inference.identification import identify
from slipmap.models.measurements import DatasetError, PushDataset
from slipmap.models.progress import Progress

_CERTAIN = 0.01
"""Lag, in s, below which there may be none: poses seen past the arm may be half a millimetre too far along,
which for an object pushed at 50 mm/s looks like being 10 ms early."""


@dataclass(frozen=True)
class CameraLag:
    """Lag of object poses behind finger positions."""

    value: float  # s; negative where poses are early
    # low, high: 90 % interval over refits, widened by `_CERTAIN`, s
    low: float
    high: float
    pushes: int  # number of pushes that it was learned from

    @property
    def shown(self) -> bool:
        """Whether the lag is certain."""
        return not self.low <= 0.0 <= self.high

    def to_json(self) -> dict[str, float | int | bool]:
        """All fields, and whether the lag is certain."""
        return {**vars(self), "shown": self.shown}


@one_blas_thread()
def camera_lag(dataset: PushDataset, progress: Progress | None = None) -> CameraLag | None:
    """Learn the maps and the effect `sensor_latency` together from all pushes; None if they cannot show it.

    The lag shows where the object was seen while the finger pushed: its first motion, and any change of
    speed, ties the two clocks together. Pushes of all roles are used, since nothing is judged.
    """
    trials = tuple(replace(trial, role="fit") for trial in dataset.trials if not trial.ends_only)
    if not trials:
        return None
    try:
        # The spread comes from refits, which take most of the time; eight are enough.
        pushes = replace(dataset, trials=trials)
        found = identify(pushes, [SensorLatency()], hypotheses=8, progress=progress, friction_laws=False)
    except DatasetError:
        return None
    latency = next(q for q in found.quantities if q.name == "sensor_latency: latency")
    return CameraLag(latency.value, latency.low - _CERTAIN, latency.high + _CERTAIN, len(trials))
