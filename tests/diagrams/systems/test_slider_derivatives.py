"""Derivatives of the model as a Drake system, against those of rollouts and differences."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from moving_blocks import H, block, table_pushes
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.systems.primitives import Linearize
from stepped_blocks import (
    VALUES,
    FloatArray,
    autodiff_system_of,
    every_step,
    finger,
    maps_of,
    rollout,
    steps,
    system_of,
)

from slipmap.diagrams.systems.cell_grid_slider import EFFECTS, FINGER_FRICTION, FRICTION, MASS, PUSH
from slipmap.models.physics.rollout import Push


def autodiff_context(name: str, context: Any) -> Any:
    system = autodiff_system_of(name)
    converted = system.CreateDefaultContext()
    converted.SetTimeStateAndParametersFrom(context)
    return converted


@pytest.mark.parametrize("name", VALUES)
def test_derivatives_over_many_steps_are_those_of_the_rollout(name: str) -> None:
    """By all maps, the finger's friction, the effects' parameters and the start, step by step by AutoDiffXd,
    against the sensitivities that a rollout carries along."""
    push = every_step(table_pushes(1, 3)[0])
    count = 80
    system = autodiff_system_of(name)
    context = autodiff_context(name, system_of(name).CreateDefaultContext())
    maps = maps_of(name)
    n, P = len(block()), maps.effects.shape[1]
    columns = 2 * n + 1 + P
    values = InitializeAutoDiff(np.concatenate([maps.mass[0], maps.mu[0], maps.mu_finger, maps.effects[0]]))[
        :, 0
    ]
    ends = np.cumsum([0, n, n, 1, P])
    for index, (a, b) in zip((MASS, FRICTION, FINGER_FRICTION, EFFECTS), pairwise(ends), strict=True):
        context.get_mutable_numeric_parameter(index).SetFromVector(values[a:b])
    start = rollout_start(name, push)
    context.SetDiscreteState(start)
    context.get_mutable_numeric_parameter(PUSH).SetFromVector([AutoDiffXd(0.0), AutoDiffXd(push.order)])
    for k in range(count):
        context.SetTime(AutoDiffXd(k * push.h))
        system.GetInputPort("finger").FixValue(context, np.array([AutoDiffXd(x) for x in finger(push, k)]))
        after = system.EvalUniquePeriodicDiscreteUpdate(context).get_vector().CopyToVector()
        context.SetDiscreteState(after)
    found = ExtractGradient(system.GetOutputPort("object_pose").Eval(context))
    assert found.shape == (3, columns)

    expected = rollout(name, push, sensitivities=True)
    slider = system_of(name).stepper
    reduced = expected.d_poses[:, count - 1]
    by_maps = slider.map_columns(maps, reduced)[0]
    wanted = np.concatenate([by_maps[:, : 2 * n + 1], by_maps[:, 2 * n + 7 :]], axis=1)
    if name == "tracker_offset":
        # There the rollout's start is a report; here the true start was held.
        wanted, found = wanted[:, : 2 * n + 1], found[:, : 2 * n + 1]
    scale = np.abs(wanted).max(axis=0)
    assert (np.abs(found - wanted) <= 1e-7 * scale + 1e-12).all()
    assert (scale > 0).all()
    assert (
        np.abs(
            ExtractValue(system.GetOutputPort("object_pose").Eval(context))[:, 0]
            - expected.poses[0, count - 1]
        ).max()
        < 1e-11
    )


def rollout_start(name: str, push: Push) -> FloatArray:
    context = system_of(name).CreateDefaultContext()
    system_of(name).set_motion(context, push.start_pose, push.start_twist)
    return np.array([AutoDiffXd(x) for x in context.get_discrete_state_vector().CopyToVector()])


def differences(f: Callable[[FloatArray], FloatArray], at: FloatArray, h: float) -> FloatArray:
    shifts = h * np.eye(len(at))
    columns = [(8 * (f(at + s) - f(at - s)) - (f(at + 2 * s) - f(at - 2 * s))) / (12 * h) for s in shifts]
    return np.column_stack(columns)


@pytest.mark.parametrize(("port", "h"), [("finger", 1e-8), ("wrench", 1e-6)])
def test_derivatives_by_inputs_agree_with_differences(port: str, h: float) -> None:
    push = table_pushes(1, 3)[0]
    system = system_of("plain")
    context = system.CreateDefaultContext()
    steps(system, context, push, 80, lambda: None)
    context.SetTime(80 * H)
    for name, value in (("finger", finger(push, 80)), ("wrench", np.array([0.1, 0.2, 0.01, 0.02, 0.003]))):
        system.GetInputPort(name).FixValue(context, value)
    at = system.GetInputPort(port).Eval(context).copy()

    def after(value: FloatArray) -> FloatArray:
        system.GetInputPort(port).FixValue(context, value)
        return system.EvalUniquePeriodicDiscreteUpdate(context).get_vector().CopyToVector()

    wanted = differences(after, at, h)
    converted = autodiff_system_of("plain")
    other = autodiff_context("plain", context)
    for name in ("finger", "wrench"):
        value = at if name == port else system.GetInputPort(name).Eval(context)
        numbers = InitializeAutoDiff(at)[:, 0] if name == port else np.array([AutoDiffXd(x) for x in value])
        converted.GetInputPort(name).FixValue(other, numbers)
    found = ExtractGradient(converted.EvalUniquePeriodicDiscreteUpdate(other).get_vector().CopyToVector())
    scale = np.abs(wanted).max(axis=1, keepdims=True)
    assert (np.abs(found - wanted) < 1e-5 * scale + 1e-9).all()
    assert (scale[[0, 1, 2, 3, 4, 5]] > 1e-4).all()


@pytest.mark.parametrize("latency", [0.033, -0.013])
def test_late_and_early_reports_are_differentiated_by_the_latency(latency: float) -> None:
    """The pose reported now moves back by its velocity with growing latency."""
    push = table_pushes(1, 3)[0]
    system = system_of("sensor_latency")
    context = system.CreateDefaultContext()
    steps(system, context, push, 80, lambda: None)

    def report(value: FloatArray) -> FloatArray:
        context.get_mutable_numeric_parameter(EFFECTS).SetFromVector(value)
        return system.GetOutputPort("object_pose").Eval(context).copy()

    wanted = differences(report, np.array([latency]), 1e-5)
    report(np.array([latency]))
    other = autodiff_context("sensor_latency", context)
    other.get_mutable_numeric_parameter(EFFECTS).SetFromVector(InitializeAutoDiff([latency])[:, 0])
    found = ExtractGradient(autodiff_system_of("sensor_latency").GetOutputPort("object_pose").Eval(other))
    assert np.allclose(found, wanted, rtol=1e-6, atol=1e-9)
    assert np.abs(wanted).max() > 0.01


def test_early_reports_are_where_the_object_will_be() -> None:
    """While the finger pushes it steadily on, the model keeps its velocity."""
    push = table_pushes(1, 3)[0]
    system = system_of("sensor_latency")
    context = system.CreateDefaultContext()
    context.get_mutable_numeric_parameter(EFFECTS).SetFromVector([-3 * H])

    def see() -> tuple[FloatArray, FloatArray]:
        told = system.GetOutputPort("object_pose").Eval(context).copy()
        return told, context.get_discrete_state_vector().value()[:3].copy()

    seen = steps(system, context, push, 83, see)
    (told, now), (_, then) = seen[79], seen[82]
    assert np.abs(then - now).max() > 1e-3
    assert told == pytest.approx(then, abs=0.05 * np.abs(then - now).max())


def test_linearize_at_rest() -> None:
    """A body held by the smoothed friction: x⁺ = A x + B u, with B as a small force shows it."""
    system = system_of("plain")
    context = system.CreateDefaultContext()
    system.set_motion(context, np.array([0.1, 0.2, 0.7]))
    system.GetInputPort("finger").FixValue(context, np.full(4, np.nan))
    system.GetInputPort("wrench").FixValue(context, np.zeros(5))
    ports = (system.GetInputPort("wrench").get_index(), system.GetOutputPort("object_pose").get_index())
    linear = Linearize(system, context, *ports)
    assert linear.time_period() == H
    assert np.allclose(linear.A()[:3, :3], np.eye(3))
    assert np.array_equal(linear.C(), np.eye(3, 8))

    def after(value: FloatArray) -> FloatArray:
        system.GetInputPort("wrench").FixValue(context, value)
        return system.EvalUniquePeriodicDiscreteUpdate(context).get_vector().CopyToVector()

    wanted = differences(after, np.zeros(5), 1e-5)
    assert np.abs(linear.B() - wanted).max() < 1e-6 * np.abs(wanted).max()
    assert np.abs(wanted[:3]).max() > 0
