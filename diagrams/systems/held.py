"""Values in a Context that are never changed, only replaced.

Drake copies all abstract state of a diagram at every unrestricted update. What cannot change need not be
copied with it: a belief, or the rows of a recording, would cost more than the simulation.
"""

from __future__ import annotations

from typing import Any

from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import AbstractStateIndex, Context, State


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
