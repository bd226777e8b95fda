"""Bases for systems written in Python that Python can free, together with everything they hold.

A pydrake system defined in Python is otherwise never freed, for two reasons, and keeps its diagram, plant and
Contexts alive: 18 MB for each exploration.

- A class statement gives instances a `__dict__` although instances of pydrake's classes already have one.
  Python 3.11 then counts its contents twice and assumes that something else holds the system, too. An empty
  `__slots__` prevents this.
- C++ holds the function behind an output port, and Python's collector does not see that the function in turn
  holds the system (RobotLocomotion/drake#24162). Here the system holds the function, and C++ holds one that
  does not hold the system.

Drake copies all abstract state of a diagram at every unrestricted update. Immutable values need no copies:
copying a belief or the rows of a recording would cost more than the simulation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from weakref import WeakMethod, ref

from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import AbstractStateIndex, Context, Diagram, EventStatus, LeafSystem, State

DRAWN_EVERY = 0.05
"""s between two drawings in Meshcat: the period of the loops' blocks, so that in a loop no further event
divides a step of the simulation, and a run that is drawn is the run that is not."""


def weakly(method: Callable[..., None]) -> Callable[..., None]:
    """A function for C++ to keep that calls a method without holding its object, while the object lives."""
    method_or_none = WeakMethod(method)

    def call(*args: Any) -> None:
        alive = method_or_none()
        if alive is not None:
            alive(*args)

    return call


class WithoutOwnDict(type(LeafSystem)):  # type: ignore[misc]
    """Metaclass of classes whose instances have only the `__dict__` of pydrake's class."""

    def __new__(cls, name: str, bases: tuple[type, ...], namespace: dict[str, Any]) -> type:
        """A class with empty `__slots__`."""
        return super().__new__(cls, name, bases, {"__slots__": (), **namespace})


class HoldsOutputFunctions:
    """Mixin, placed before `LeafSystem` in the bases: holds the functions of output ports in Python."""

    __slots__ = ()

    def DeclareVectorOutputPort(self, name: str, model: Any, calc: Callable[..., None], *tickets: Any) -> Any:
        """As in `LeafSystem`, with positional parameters."""
        return super().DeclareVectorOutputPort(name, model, self._held(calc), *tickets)  # type: ignore[misc]

    def DeclareAbstractOutputPort(
        self, name: str, alloc: Callable[[], Any], calc: Callable[..., None], *tickets: Any
    ) -> Any:
        """As in `LeafSystem`, with positional parameters."""
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
    """A value shared by all copies of a Context.

    Args:
        value: must not be changed afterwards.
    """

    __slots__ = ("value",)

    def __init__(self, value: Any) -> None:
        self.value = value

    def __copy__(self) -> Held:
        return self

    def __deepcopy__(self, memo: object) -> Held:
        return self


def held(value: Any) -> AbstractValue:
    """Model value of an abstract state whose values are shared, not copied."""
    return Value[object](Held(value))


def read(context: Context | State, index: AbstractStateIndex) -> Any:
    """The value of an abstract state declared with `held`."""
    return context.get_abstract_state(int(index)).get_value().value


def replace_held(state: State, index: AbstractStateIndex, value: Any) -> None:
    """Set the value of an abstract state declared with `held`."""
    state.get_mutable_abstract_state(int(index)).set_value(Held(value))


class PythonSystem(HoldsOutputFunctions, LeafSystem, metaclass=WithoutOwnDict):
    """Base of all Python systems here."""

    def declare_inputs(self, *names: str, **kinds: type) -> None:
        """Declare input ports for Python objects.

        Args:
            names: of the ports.
            kinds: of the values at some of them, if not None; another one raises TypeError when it is read.
        """
        self.__dict__.setdefault("_kinds", {}).update(kinds)
        for name in names:
            self.DeclareAbstractInputPort(name, Value[object](None))

    def declare_steps(
        self, period: float, index: AbstractStateIndex, following: Callable[[Context, Any], Any]
    ) -> None:
        """Declare a periodic update of an abstract state declared with `held`; at most one per system.

        Args:
            period: s between two steps.
            index: of the state.
            following: computes the next value from a Context and the present value; returns the latter itself
                if nothing changes.
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
        """Declare an output port for (a part of) the value of an abstract state declared with `held`."""
        own = {self.abstract_state_ticket(index)}
        self.declare_output(name, lambda context: part(read(context, index)), own)

    def declare_output(
        self, name: str, value: Callable[[Context], Any], after: set[Any], model: AbstractValue | None = None
    ) -> None:
        """Declare an output port whose value a function computes from a Context.

        Args:
            after: tickets of everything it depends on.
            model: a value of the port's type, to match Drake's own ports; None for Python objects.
        """
        alloc = (lambda: Value[object](None)) if model is None else model.Clone
        self.DeclareAbstractOutputPort(
            name, alloc, lambda context, output: output.set_value(value(context)), after
        )

    def declare_vector_output(
        self, name: str, size: int, value: Callable[[Context], Any], after: set[Any]
    ) -> None:
        """Declare a vector output port of some size."""
        self.DeclareVectorOutputPort(
            name, size, lambda context, output: output.SetFromVector(value(context)), after
        )

    def input(self, context: Context, name: str) -> Any:
        """The value at an input port."""
        value = self.GetInputPort(name).Eval(context)
        kind = self.__dict__.get("_kinds", {}).get(name)
        if kind is not None and value is not None and not isinstance(value, kind):
            raise TypeError(
                f"{type(self).__name__}: the port {name} takes a {kind.__name__},"
                f" got a {type(value).__name__}"
            )
        return value

    def optional_input(self, context: Context, name: str) -> Any:
        """The value at an input port; None if it is not connected."""
        return self.input(context, name) if self.GetInputPort(name).HasValue(context) else None


class PythonDiagram(Diagram, metaclass=WithoutOwnDict):
    """Base of all diagram classes here."""
