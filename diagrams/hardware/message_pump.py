"""Messages of a connection are heard at each step of a diagram, while Python's lock is held."""

from __future__ import annotations

from typing import Any

from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.framework import EventStatus

from diagrams.collectable import PythonSystem


class MessagePump(PythonSystem):
    """Lets a connection call the functions in Python that are subscribed to it, at each step.

    In place of Drake's `LcmInterfaceSystem`, which calls them out of `Simulator.AdvanceTo`: pydrake has let
    go of the interpreter's lock there, and takes memory of Python's for a message before it has the lock
    again. Where another thread runs Python meanwhile, such as the one that looks at pictures, the process
    crashes.

    To be added before the systems that look at what was heard at each step, for which it then comes at the
    same step. It has no ports.

    Args:
        lcm: the connection.
    """

    def __init__(self, lcm: DrakeLcmInterface) -> None:
        super().__init__()
        self._lcm = lcm
        self.DeclarePerStepUnrestrictedUpdateEvent(self._hear)

    def _hear(self, context: Any, state: Any) -> EventStatus:
        self._lcm.HandleSubscriptions(0)
        return EventStatus.DidNothing()
