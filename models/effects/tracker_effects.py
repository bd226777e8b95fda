"""Effects of the tracker: it reports other poses than the object has, or reports them late."""

from __future__ import annotations

from typing import Any

from models.effects.effect import Effect, Parameter
from models.effects.sympy_on_use import sp


class SensorLatency(Effect):
    name = "sensor_latency"
    sentence = "The tracker reports the object's pose late."
    parameters = (Parameter("latency", "s", "by how much the tracker is late", -0.3, 0.5, 0.03, 0.0),)

    def delay(self, p: Any) -> Any:
        return p.latency


class TrackerOffset(Effect):
    name = "tracker_offset"
    sentence = "The tracked frame is not the object frame."
    parameters = (
        Parameter("x", "m", "where the tracked frame sits in the object frame", -0.1, 0.1, 3e-3, 0.0),
        Parameter("y", "m", "the same, y", -0.1, 0.1, 3e-3, 0.0),
        Parameter("angle", "rad", "by how much it is turned", -0.6, 0.6, 0.02, 0.0),
    )

    def measured(self, pose: Any, p: Any) -> Any:
        c, s = sp.cos(pose.theta), sp.sin(pose.theta)
        return pose.x + c * p.x - s * p.y, pose.y + s * p.x + c * p.y, pose.theta + p.angle


class TrackerScale(Effect):
    name = "tracker_scale"
    sentence = "The tracker's lengths are off by a few percent."
    parameters = (
        Parameter("excess", "1", "reported lengths above true ones, as a share", -0.3, 0.3, 0.01, 0.0),
    )

    def measured(self, pose: Any, p: Any) -> Any:
        return (1 + p.excess) * pose.x, (1 + p.excess) * pose.y, pose.theta
