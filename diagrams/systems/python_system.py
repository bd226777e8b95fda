"""Systems written in Python that Python can free, with all that they hold.

What pydrake makes of a class in Python is never freed on its own, for two reasons, and takes the diagram that
it is in, its plant and its Contexts along: 18 MB for each exploration.

- A class statement gives its instances a `__dict__` although those of pydrake's classes have one already.
  Python 3.11 then counts what is in it twice, and takes the system for one that somebody else holds, too. An
  empty `__slots__` prevents it.
- The function behind an output port is held by C++, where Python's collector does not see that it holds the
  system in turn (RobotLocomotion/drake#24162). Here the system holds it, and C++ one that does not hold the
  system.

Drake copies all abstract state of a diagram at every unrestricted update. What cannot change need not be
copied with it: a belief, or the rows of a recording, would cost more than the simulation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from weakref import WeakMethod, ref

from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import AbstractStateIndex, Context, Diagram, EventStatus, LeafSystem, State


def weakly(method: Callable[..., None]) -> Callable[..., None]:
    """What calls a method but does not hold its object, for C++ to keep; nothing, once the object is gone."""
    method_or_none = WeakMethod(method)

    def call(*args: Any) -> None:
        alive = method_or_none()
        if alive is not None:
            alive(*args)

    return call


class WithoutOwnDict(type(LeafSystem)):  # type: ignore[misc]
    """For classes whose instances have no `__dict__` but that of pydrake's class."""

    def __new__(cls, name: str, bases: tuple[type, ...], namespace: dict[str, Any]) -> type:
        """A class with empty `__slots__`."""
        return super().__new__(cls, name, bases, {"__slots__": (), **namespace})


class HoldsOutputFunctions:
    """Before a `LeafSystem` among the bases of a class: holds the functions of output ports in Python."""

    __slots__ = ()

    def DeclareVectorOutputPort(self, name: str, model: Any, calc: Callable[..., None], *tickets: Any) -> Any:
        """As that of `LeafSystem`, whose first parameters have no names here."""
        return super().DeclareVectorOutputPort(name, model, self._held(calc), *tickets)  # type: ignore[misc]

    def DeclareAbstractOutputPort(
        self, name: str, alloc: Callable[[], Any], calc: Callable[..., None], *tickets: Any
    ) -> Any:
        """As that of `LeafSystem`, whose first parameters have no names here."""
        return super().DeclareAbstractOutputPort(name, alloc, self._held(calc), *tickets)  # type: ignore[misc]

    def _held(self, calc: Callable[..., None]) -> Callable[..., None]:
        functions = self.__dict__.setdefault("_output_functions", [])
        functions.append(calc)
        number, itself = len(functions) - 1, ref(self)

        def call(context: Any, output: Any) -> None:
            system = itself()
            assert system is not None, "C++ holds the system while it is in use"
            system.__dict__["_output_functions"][number](context, output)

        return call


class Held:
    """A value that copies of a Context share.

    Args:
        value: nothing may change it afterwards.
    """

    __slots__ = ("value",)

    def __init__(self, value: Any) -> None:
        self.value = value

    def __copy__(self) -> Held:
        return self

    def __deepcopy__(self, memo: object) -> Held:
        return self


def held(value: Any) -> AbstractValue:
    """Model value of an abstract state that holds values as they are."""
    return Value[object](Held(value))


def read(context: Context | State, index: AbstractStateIndex) -> Any:
    """What an abstract state made by `held` holds."""
    return context.get_abstract_state(int(index)).get_value().value


def replace_held(state: State, index: AbstractStateIndex, value: Any) -> None:
    """Let an abstract state made by `held` hold another value."""
    state.get_mutable_abstract_state(int(index)).set_value(Held(value))


class PythonSystem(HoldsOutputFunctions, LeafSystem, metaclass=WithoutOwnDict):
    """Base of all systems here that are written in Python."""

    def declare_inputs(self, *names: str) -> None:
        """Input ports for Python's objects."""
        for name in names:
            self.DeclareAbstractInputPort(name, Value[object](None))

    def declare_steps(
        self, period: float, index: AbstractStateIndex, following: Callable[[Context, Any], Any]
    ) -> None:
        """Have an abstract state made by `held` go on; one of a system at most.

        Args:
            period: s between two steps.
            index: of the state.
            following: what comes after a Context and what the state holds, which it returns where nothing
                is to change.
        """
        self._stepped, self._following = index, following
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._take_step)

    def _take_step(self, context: Context, state: State) -> EventStatus:
        now = read(context, self._stepped)
        following = self._following(context, now)
        if following is now:
            return EventStatus.DidNothing()
        replace_held(state, self._stepped, following)
        return EventStatus.Succeeded()

    def declare_output_of(
        self, name: str, index: AbstractStateIndex, part: Callable[[Any], Any] = lambda held: held
    ) -> None:
        """An output port for (a part of) what an abstract state made by `held` holds."""
        own = {self.abstract_state_ticket(index)}
        self.declare_output(name, lambda context: part(read(context, index)), own)

    def declare_output(
        self, name: str, value: Callable[[Context], Any], after: set[Any], model: AbstractValue | None = None
    ) -> None:
        """An output port for what a function makes of a Context.

        Args:
            after: tickets of all that it depends on.
            model: of another type than Python's objects; the port then fits Drake's own of this type.
        """
        alloc = (lambda: Value[object](None)) if model is None else model.Clone
        self.DeclareAbstractOutputPort(
            name, alloc, lambda context, output: output.set_value(value(context)), after
        )

    def declare_vector_output(
        self, name: str, size: int, value: Callable[[Context], Any], after: set[Any]
    ) -> None:
        """The same for numbers (size,)."""
        self.DeclareVectorOutputPort(
            name, size, lambda context, output: output.SetFromVector(value(context)), after
        )

    def input(self, context: Context, name: str) -> Any:
        """What comes in at a port."""
        return self.GetInputPort(name).Eval(context)

    def optional_input(self, context: Context, name: str) -> Any:
        """What comes in at a port; None where it is not connected."""
        return self.input(context, name) if self.GetInputPort(name).HasValue(context) else None


class PythonDiagram(Diagram, metaclass=WithoutOwnDict):
    """Base of all diagrams here that are classes."""
