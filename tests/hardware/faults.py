"""Faults to put between blocks: messages, pictures and arms that go wrong.

Each is a small LeafSystem that passes its inputs on until a given time, and then does one thing wrong. They
know nothing of what is to become of it. `slipmap.diagrams.testing.faults` does the like with messages.

| system | what goes wrong |
| --- | --- |
| `StatusLink` | the arm's status: `stop`, `delay`, `repeat`, `jump`, `back` |
| `PictureLink` | depth pictures: `drop`, `freeze`, `zeros`, `nans`, `rubbish`, `torn`, `empty` |
| `FollowingArm` | an arm that goes where it is told: `refuse`, `force`, `knock` |
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.sensors import ImageDepth32F

from slipmap.diagrams.systems.python_system import PythonSystem, held, read, replace_held
from slipmap.diagrams.testing.faults import spoilt_rows

MESSAGE = 0.005
"""s between two messages of the arm."""

STATUS_FAULTS = ("stop", "delay", "repeat", "jump", "back")
PICTURE_FAULTS = ("drop", "freeze", "zeros", "nans", "rubbish", "torn", "empty")
ARM_FAULTS = ("refuse", "force", "knock")


@dataclass(frozen=True, eq=False)
class Message:
    stamp: float
    position: np.ndarray
    torque: np.ndarray


class StatusLink(PythonSystem):
    """The way of the arm's status, a message every `MESSAGE`; who receives drops what is older than it has.

    Ports in: `position` (7), `torque` (7). Out: `position`, `torque`, `age` (1), of the newest message, s.

    Args:
        fault: None, or from the time `at` (s) on
            `stop`: no message comes any more;
            `delay`: messages come `amount` seconds late;
            `repeat`: the message of that time comes again and again, with new stamps;
            `jump`: joint angles are `amount` rad larger than they are;
            `back`: the messages before come again, backwards, with their old stamps.
        at: s.
        amount: see above.
    """

    def __init__(self, fault: str | None = None, at: float = np.inf, amount: float = 0.0) -> None:
        super().__init__()
        assert fault is None or fault in STATUS_FAULTS
        self._fault, self._at, self._amount = fault, at, amount
        self.DeclareVectorInputPort("position", 7)
        self.DeclareVectorInputPort("torque", 7)
        self._log = self.DeclareAbstractState(held(()))  # what was sent
        self._newest = self.DeclareAbstractState(held(None))
        self.DeclarePeriodicUnrestrictedUpdateEvent(MESSAGE, 0.0, self._send)
        own = self.abstract_state_ticket(self._newest)
        for name in ("position", "torque"):
            self.DeclareVectorOutputPort(
                name, 7, lambda context, output, name=name: self._part(context, output, name), {own}
            )
        self.DeclareVectorOutputPort("age", 1, self._age, {own, self.time_ticket()})

    def _send(self, context, state) -> None:
        time = context.get_time()
        position, torque = (self.GetInputPort(name).Eval(context) for name in ("position", "torque"))
        sent = Message(time, position.copy(), torque.copy())
        log = (*read(context, self._log)[-400:], sent)
        newest = read(context, self._newest)
        come = self._come(log, time)
        if come is not None and (newest is None or come.stamp > newest.stamp):
            newest = come
        replace_held(state, self._log, log)
        replace_held(state, self._newest, newest)

    def _come(self, log: tuple[Message, ...], time: float) -> Message | None:
        sent = log[-1]
        if self._fault is None or time < self._at - 1e-9:
            return sent

        def at(stamp: float) -> Message:
            return min(log, key=lambda message: abs(message.stamp - stamp))

        if self._fault == "stop":
            return None
        if self._fault == "delay":
            return at(time - self._amount)
        if self._fault == "repeat":
            return replace(at(self._at), stamp=time)
        if self._fault == "jump":
            return replace(sent, position=sent.position + self._amount)
        return at(2 * self._at - time)

    def _part(self, context, output, name: str) -> None:
        newest = read(context, self._newest)
        output.SetFromVector(np.zeros(7) if newest is None else getattr(newest, name))

    def _age(self, context, output) -> None:
        newest = read(context, self._newest)
        output.SetFromVector([np.inf if newest is None else context.get_time() - newest.stamp])


class FollowingArm(PythonSystem):
    """An arm that is after `MESSAGE` where it was told to be.

    Port in: `command` (7). Out: `position` (7), `torque` (7).

    Args:
        start: (7) joint angles at the begin, rad.
        fault: None, or from the time `at` (s) on
            `refuse`: it stays where it is, whatever it is told;
            `force`: something presses against it with `amount` N m at its fourth joint, for good;
            `knock`: the same, but only for 10 ms.
        at: s.
        amount: see above.
    """

    def __init__(self, start, fault: str | None = None, at: float = np.inf, amount: float = 0.0) -> None:
        super().__init__()
        assert fault is None or fault in ARM_FAULTS
        self._fault, self._at, self._amount = fault, at, amount
        self.DeclareVectorInputPort("command", 7)
        self._q = self.DeclareDiscreteState(np.asarray(start))
        self.DeclarePeriodicDiscreteUpdateEvent(MESSAGE, 0.0, self._follow)
        self.DeclareStateOutputPort("position", self._q)
        self.DeclareVectorOutputPort("torque", 7, self._torque, {self.time_ticket()})

    def _follow(self, context, state) -> None:
        if not (self._fault == "refuse" and context.get_time() >= self._at):
            state.set_value(self.GetInputPort("command").Eval(context))

    def _torque(self, context, output) -> None:
        since = context.get_time() - self._at
        pressed = since >= 0 and (self._fault == "force" or (self._fault == "knock" and since < 0.01))
        output.SetFromVector([0, 0, 0, self._amount if pressed else 0.0, 0, 0, 0])


class PictureLink(PythonSystem):
    """The way of depth pictures, one every `period`.

    Ports in: `depth_image`. Out: `depth_image`, `age` (1) of the picture as stamped, s.

    Args:
        period: s.
        fault: None, or from the time `at` (s) on
            `drop`: no picture comes any more;
            `freeze`: the picture of that time comes again and again, with new stamps;
            `zeros`, `nans`, `rubbish`: rows `band` hold no reading, no numbers, or anything;
            `torn`: rows `band` are those of the picture before;
            `empty`: a picture of no size, as before the first.
        at: s.
        band: share of the rows, from and to.
    """

    def __init__(
        self, period: float, fault: str | None = None, at: float = np.inf, band: tuple[float, float] = (0, 1)
    ) -> None:
        super().__init__()
        assert fault is None or fault in PICTURE_FAULTS
        self._plan = self.DeclareAbstractState(held((fault, at, band)))
        self.DeclareAbstractInputPort("depth_image", AbstractValue.Make(ImageDepth32F()))
        self._now = self.DeclareAbstractState(held((-np.inf, None, None)))  # stamp, sent before, what came
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._send)
        own = self.abstract_state_ticket(self._now)
        self.DeclareAbstractOutputPort(
            "depth_image", lambda: AbstractValue.Make(ImageDepth32F()), self._picture, {own}
        )
        self.DeclareVectorOutputPort("age", 1, self._age, {own, self.time_ticket()})

    def spoil(self, root, fault: str | None, at: float = -np.inf, band: tuple[float, float] = (0, 1)) -> None:
        """Another fault, in a Context of the diagram in which this is."""
        assert fault is None or fault in PICTURE_FAULTS
        replace_held(
            self.GetMyMutableContextFromRoot(root).get_mutable_state(), self._plan, (fault, at, band)
        )

    def _send(self, context, state) -> None:
        time = context.get_time()
        _, before, come = read(context, self._now)
        sent = self.GetInputPort("depth_image").Eval(context).data[:, :, 0].copy()
        fault, at, band = read(context, self._plan)
        faulty = fault if time >= at - 1e-9 else None
        if faulty == "drop":
            return
        if faulty != "freeze":
            come = sent if faulty is None else self._spoilt(faulty, band, sent, before, time)
        replace_held(state, self._now, (time, sent, come))

    def _spoilt(self, fault, band, sent: np.ndarray, before: np.ndarray, time: float) -> np.ndarray:
        if fault == "empty":
            return sent[:0, :0]
        return spoilt_rows(fault, sent, before, band, round(1e3 * time))

    def _picture(self, context, output) -> None:
        come = read(context, self._now)[2]
        if come is None:
            come = np.zeros((0, 0), np.float32)
        picture = ImageDepth32F(come.shape[1], come.shape[0])
        picture.mutable_data[:, :, 0] = come
        output.set_value(picture)

    def _age(self, context, output) -> None:
        output.SetFromVector([context.get_time() - read(context, self._now)[0]])
