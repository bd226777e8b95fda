"""A block alone, its inputs in the test's hand."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, LeafSystem, PortDataType

from slipmap.models.perception.seen_object import ObservedPose


class DrivenBlock:
    """Steps a LeafSystem through time while inputs are set and outputs are read by name."""

    def __init__(self, system: LeafSystem, **inputs: Any) -> None:
        self._system = system
        self._simulator = Simulator(system)
        self._context = self._simulator.get_mutable_context()
        self.set(**inputs)

    @property
    def context(self) -> Context:
        return self._context

    @property
    def time(self) -> float:
        return float(self._context.get_time())

    def set(self, **inputs: Any) -> None:
        for name, value in inputs.items():
            port = self._system.GetInputPort(name)
            if port.get_data_type() == PortDataType.kVectorValued:
                port.FixValue(self._context, np.asarray(value, dtype=float))
            elif isinstance(value, RigidTransform):
                port.FixValue(self._context, Value(value))
            else:
                port.FixValue(self._context, Value[object](value))

    def advance(self, duration: float) -> None:
        self._simulator.AdvanceTo(self.time + duration)

    def read(self, name: str) -> Any:
        return self._system.GetOutputPort(name).Eval(self._context)


def seen_at(x: float, y: float, theta: float, time: float = 0.0) -> ObservedPose:
    """A pose that a picture showed."""
    return ObservedPose(np.array([x, y, theta]), np.eye(3) * 1e-6, True, "", time)
