"""Which functions are compiled, and that calls by address equal calls by name."""

from __future__ import annotations

import runpy

import numpy as np
import pytest
from numba.core.compiler import Flags
from numba.core.errors import TypingError
from sliding_objects import FINGER_RADIUS, coast, random_maps, rectangle

from slipmap.models.physics.compiled import address_of, call_compiled, compiled
from slipmap.models.physics.kernel import rollout_one
from slipmap.models.physics.rollout import Slider


@compiled()
def add_to(values, amount):
    if amount < 0.0:
        raise ValueError("negative")
    for k in range(len(values)):
        values[k] += amount


@compiled()
def add_by_address(address, values, amount):
    call_compiled(add_to, address, (values, amount))


def test_a_function_is_called_by_its_address():
    values = np.arange(3.0)
    address = address_of(add_to, (values, 0.5))
    add_by_address(address, values, 0.5)
    assert values.tolist() == [0.5, 1.5, 2.5]
    assert address_of(add_to, (np.zeros(7), 0.25)) == address
    with pytest.raises(ValueError, match="negative"):
        add_by_address(address, values, -1.0)


def test_a_call_by_address_of_other_kinds_is_refused():
    address = address_of(add_to, (np.zeros(2), 0.5))
    with pytest.raises(TypingError, match="add_to: not compiled for"):
        add_by_address(address, np.zeros(2, dtype=np.int64), 0.5)


@compiled(forceinline=True)
def doubled(value):
    return 2.0 * value


@compiled()
def four_times(value):
    return doubled(doubled(value))


def test_an_inlined_function_can_be_called_from_kernels_alone():
    assert four_times(1.5) == 6.0
    with pytest.raises(TypeError, match="doubled is inlined into kernels"):
        doubled(1.5)


def test_arrays_that_must_not_be_written_do_not_compile_the_kernel_again():
    grid = rectangle(5, 3)
    maps = random_maps(np.random.default_rng(0), len(grid))
    push = coast((0.1, 0.0, 0.0), 0.03, 0.01)
    slider = Slider(grid, FINGER_RADIUS)
    twist = np.array([[[0.2, 0.0, 1.0]]])
    expected = slider.rollout(maps, [push], start_twists=twist)
    before = len(rollout_one.signatures)
    held = slider.rollout(maps, [push], start_twists=np.broadcast_to(twist, (1, 1, 3)))
    assert held.poses.tolist() == expected.poses.tolist()
    assert len(rollout_one.signatures) == before


def test_a_copy_of_a_file_uses_what_the_first_has_compiled(tmp_path):
    text = "def double(values):\n    for k in range(len(values)):\n        values[k] *= 2.0\n"
    for folder in ("first", "second"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "doubling.py").write_text(text)

    def run(path):
        space = runpy.run_path(str(path))
        double = compiled(tmp_path / "kernels")(space["double"])
        values = np.ones(2)
        double(values)
        return values[0], sum(double.stats.cache_hits.values())

    assert run(tmp_path / "first" / "doubling.py") == (2.0, 0)
    assert run(tmp_path / "second" / "doubling.py") == (2.0, 1)
    (tmp_path / "second" / "doubling.py").write_text(text.replace("2.0", "3.0"))
    assert run(tmp_path / "second" / "doubling.py") == (3.0, 0)


def test_a_call_by_name_uses_what_a_call_by_address_has_compiled(tmp_path):
    path = tmp_path / "doubling.py"
    path.write_text("def double(values):\n    values[0] *= 2.0\n")

    def double():
        return compiled(tmp_path / "kernels")(runpy.run_path(str(path))["double"])

    values = np.ones(2)
    address_of(double(), (values,))
    by_name = double()
    by_name(values)
    assert values[0] == 2.0
    assert sum(by_name.stats.cache_hits.values()) == 1


def test_what_returns_something_cannot_be_called_by_address(tmp_path):
    path = tmp_path / "first.py"
    path.write_text("def first(values):\n    return values[0]\n")
    function = compiled(tmp_path / "kernels")(runpy.run_path(str(path))["first"])
    with pytest.raises(TypingError, match="must not return"):
        address_of(function, (np.ones(2),))


def test_options_of_compilation_are_equal_where_all_values_are():
    plain, same, other = Flags(), Flags(), Flags()
    same.release_gil = same.forceinline = False  # the defaults
    other.release_gil = True
    for first in (plain, same, other):
        for second in (plain, same, other):
            assert (first == second) == (first.values() == second.values())
    assert plain == same != other
    assert {plain: 1}[same] == 1 and other not in {plain: 1} and plain != "plain"
