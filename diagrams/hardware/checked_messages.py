"""Messages from the network as ports of a diagram: only good ones come through, the others are counted."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, EventStatus, State
from pydrake.systems.lcm import LcmPublisherSystem, _Serializer_

from slipmap.diagrams.hardware.validation import BadMessage, Rule, check_stamp
from slipmap.diagrams.systems.python_system import PythonSystem, held, read, replace_held

STANDSTILL = 0.01
"""s that count at most as silence between two steps: what takes longer is that this process stood still, and
then it could not hear either."""

CLOCKS = 0.5
"""s in which the difference of two clocks is followed; where one is slow, ages err by a share of this."""

_log = logging.getLogger("slipmap.hardware")


@dataclass(frozen=True, eq=False)
class Received:
    """State: the newest good message and what was wrong with others.

    Attributes:
        data: of the newest good message, encoded anew; empty before the first.
        stamp: the sender's clock in it, s.
        offset: what the clock of the diagram shows more than the sender's where messages just come, s.
        good: number of good messages.
        dropped: number of bad ones by their cause.
        silence: s of this computer's clock since a good one was found here.
        looked: what that clock showed then, s.
    """

    data: bytes = b""
    stamp: float = np.nan
    offset: float = -np.inf
    good: int = 0
    dropped: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    silence: float = 0.0
    looked: float = np.nan


class CheckedMessages(PythonSystem):
    """Lets good messages of a channel through, and warns of others.

    .. pydrake_system::

        name: CheckedMessages
        output_ports:
        - message
        - stamp
        - age
        - silence
        - received

    What comes is told it with `hear`, and is looked at in the next step.

    - `message`: the newest good message as Drake's own receivers take it, all zero before the first.
    - `stamp` (1,): the sender's clock in it, s, NaN before the first.
    - `age` (1,): time since it was sent, s, infinite before the first. It is told from the stamp, so that a
      diagram that was busy for a while and then reads several messages at once is not misled; how far the two
      clocks are apart, the way of a message included, is followed within `CLOCKS`. While the diagram's clock
      is late the age may be negative.
    - `silence` (1,): s since a good message was found, by this computer's clock: also where the diagram's
      clock is late. Time in which this process stood still does not count. 0 without a clock.
    - `received`: `Received`.

    A warning names channel and cause at the 1st, 10th, 100th … message that is bad in one way. Drake's own
    subscriber would end the process at a message that cannot be decoded.

    Args:
        channel: whose messages these are.
        rule: what they must be.
        clock: of this computer, s; none in a simulation, which takes the time that it takes.
    """

    def __init__(self, channel: str, rule: Rule, clock: Callable[[], float] | None = None) -> None:
        super().__init__()
        self._clock = clock
        # What was heard and not yet looked at belongs to the network, not to a Context.
        self._heard: deque[tuple[bytes, float] | BadMessage] = deque(maxlen=16)
        self._channel = channel
        self._rule = rule
        self._serializer = _Serializer_[rule.lcm_type]()
        self._received = self.DeclareAbstractState(held(Received()))
        self.DeclarePerStepUnrestrictedUpdateEvent(self._update)
        own = self.abstract_state_ticket(self._received)
        self.DeclareAbstractOutputPort(
            "message", self._serializer.CreateDefaultValue, self._calc_message, {own}
        )
        self.DeclareVectorOutputPort("stamp", 1, self._calc_stamp, {own})
        self.DeclareVectorOutputPort("age", 1, self._calc_age, {own, self.time_ticket()})
        self.DeclareVectorOutputPort("silence", 1, self._calc_silence, {own})
        self.DeclareAbstractOutputPort(
            "received",
            lambda: Value[object](None),
            lambda context, output: output.set_value(self.received(context)),
            {own},
        )

    def received(self, context: Context) -> Received:
        """What came until now, of this system's Context."""
        return read(context, self._received)

    def hear(self, data: bytes) -> None:
        """Check a message and keep it for the next step; may be called by another thread.

        Args:
            data: as received.
        """
        try:
            message, stamp = self._rule.read(data)
        except BadMessage as error:
            self._heard.append(error)
        else:
            self._heard.append((message.encode(), stamp))

    def take(self, context: Context) -> Received:
        """Look at what was heard before the diagram runs.

        Args:
            context: of this system, changed.
        """
        now = self._taken(context)
        replace_held(context.get_mutable_state(), self._received, now)
        return now

    def _update(self, context: Context, state: State) -> EventStatus:
        if not self._heard and self._clock is None:
            return EventStatus.DidNothing()
        before = self.received(context)
        now = self._taken(context)
        if self._clock is not None:
            now = _listened(now, self._clock(), new=now.good > before.good)
        replace_held(state, self._received, now)
        return EventStatus.Succeeded()

    def _taken(self, context: Context) -> Received:
        now = self.received(context)
        while self._heard:
            now = self._after(now, self._heard.popleft(), context.get_time())
        return now

    def _after(self, now: Received, heard: tuple[bytes, float] | BadMessage, time: float) -> Received:
        try:
            if isinstance(heard, BadMessage):
                raise heard
            data, stamp = heard
            check_stamp(stamp, now.stamp, self._rule.anew)
        except BadMessage as error:
            cause = str(error)
            count = now.dropped.get(cause, 0) + 1
            if np.log10(count).is_integer():
                _log.warning("%s: message dropped, %s (%d so far)", self._channel, cause, count)
            return replace(now, dropped=MappingProxyType({**now.dropped, cause: count}))
        offset = time - stamp
        if now.good and stamp >= now.stamp:
            offset = now.offset + (offset - now.offset) * -np.expm1((now.stamp - stamp) / CLOCKS)
        return replace(now, data=data, stamp=stamp, offset=float(offset), good=now.good + 1)

    def _calc_message(self, context: Context, output: AbstractValue) -> None:
        data = self.received(context).data
        if data:
            self._serializer.Deserialize(data, output)
        else:
            output.SetFrom(self._serializer.CreateDefaultValue())

    def _calc_stamp(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector([self.received(context).stamp])

    def _calc_silence(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector([self.received(context).silence])

    def _calc_age(self, context: Context, output: BasicVector) -> None:
        now = self.received(context)
        output.SetFromVector([context.get_time() - now.offset - now.stamp if now.good else np.inf])


def _listened(now: Received, clock: float, *, new: bool) -> Received:
    passed = min(max(clock - now.looked, 0.0), STANDSTILL) if np.isfinite(now.looked) else 0.0
    return replace(now, silence=0.0 if new else now.silence + passed, looked=clock)


def publish(
    builder: DiagramBuilder, lcm: DrakeLcmInterface, channel: str, lcm_type: Any, period: float
) -> LcmPublisherSystem:
    """Add a publisher of Drake's messages to a channel, named like the channel.

    Where it is given a system of the diagram for the connection, pydrake never frees the diagram.
    """
    serializer = _Serializer_[lcm_type]()
    return builder.AddNamedSystem(
        f"{channel}_publisher", LcmPublisherSystem(channel, serializer, lcm, publish_period=period)
    )


# Messages of a connection are heard at each step of a diagram, while Python's lock is held.


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
