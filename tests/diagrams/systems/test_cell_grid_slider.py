"""The model as a Drake system: the same numbers as rollouts, its parameters in the Context."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy as sp
from moving_blocks import RADIUS, H, block, block_belief, table_pushes
from pydrake.systems.analysis import Simulator
from stepped_blocks import (
    VALUES,
    autodiff_system_of,
    every_step,
    maps_of,
    rollout,
    steps,
    system_of,
)

from slipmap.diagrams.systems.cell_grid_slider import (
    EFFECTS,
    MASS,
    CellGridSlider,
    CellGridSlider_,
    slider_of_hypothesis,
)
from slipmap.models.effects.effect import Effect, Parameter
from slipmap.models.physics.paper_notation import cell_poses
from slipmap.models.physics.rollout import Maps, Push, Slider


@pytest.mark.parametrize("name", VALUES)
def test_steps_follow_the_rollout(name: str) -> None:
    push = every_step(table_pushes(1, 3)[0])
    count = len(push.tip) - 1
    system = system_of(name)
    context = system.CreateDefaultContext()
    ports = [system.GetOutputPort(port) for port in ("object_pose", "finger_force")]
    rows = steps(system, context, push, count, lambda: np.concatenate([p.Eval(context) for p in ports]))
    expected = rollout(name, push)
    assert np.abs(np.array(rows)[:, :3] - expected.poses[0]).max() < 1e-11
    assert np.abs(np.array(rows)[:, 3:] - expected.forces[0]).max() < 1e-7
    assert np.hypot(*(expected.poses[0, -1] - push.start_pose)[:2]) > 0.02
    assert np.abs(system.GetOutputPort("object_twist").Eval(context) - expected.end[0, 0, 3:]).max() < 1e-9


class Gusts(Effect):
    """An effect that depends on the time within the push, as none of the library does."""

    name = "gusts"
    sentence = "A wind comes and goes."
    parameters = (Parameter("strength", "N", "force", -9.0, 9.0, 1.0, 0.0),)

    def force(self, body: Any, p: Any) -> Any:
        return p.strength * sp.sin(9 * body.time), 0, 0


def test_the_time_of_an_effect_counts_from_the_begin_of_the_push() -> None:
    maps = Maps(maps_of("plain").mass, maps_of("plain").mu, np.array([0.3]), np.array([[2.5]]))
    push = Push(H, np.full((41, 2), np.nan), np.zeros(3))
    expected = Slider(block(), RADIUS, effects=[Gusts()]).rollout(maps, [push]).poses[0]
    system = CellGridSlider(block(), maps, RADIUS, H, [Gusts()])
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    context.SetTime(3 * H)
    system.set_push(context, 3 * H)
    simulator.Initialize()
    simulator.AdvanceTo(42.5 * H)
    assert np.abs(system.GetOutputPort("object_pose").Eval(context) - expected[39]).max() < 1e-10
    assert np.ptp(expected[:, 0]) > 0.003


def test_a_force_and_a_throw_follow_the_rollout() -> None:
    wrench = np.tile([0.9, 0.4, 0.01, -0.02, 0.004], (40, 1))
    wrench[25:] = 0.0
    push = Push(
        H, np.full((41, 2), np.nan), np.array([0.1, 0.2, 0.5]), np.array([0.4, -0.2, 3.0]), wrench=wrench
    )
    system = system_of("plain")
    context = system.CreateDefaultContext()
    rows = steps(system, context, push, 40, lambda: system.GetOutputPort("object_pose").Eval(context))
    expected = rollout("plain", push).poses[0]
    assert np.abs(np.array(rows) - expected).max() < 1e-12
    assert np.ptp(expected[:, 0]) > 0.01


def test_simulated_with_nothing_connected_it_slides_to_rest() -> None:
    system = slider_of_hypothesis(block_belief(), 3, H)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    start, twist = np.array([0.1, -0.1, 1.0]), np.array([0.3, 0.1, 2.0])
    system.set_motion(context, start, twist)
    simulator.AdvanceTo(0.4)
    coast = Push(H, np.full((41, 2), np.nan), start, twist)
    expected = Slider(block(), RADIUS).rollout(block_belief().maps[3:], [coast]).end[0, 0]
    pose = system.GetOutputPort("object_pose").Eval(context)
    assert np.abs(pose - expected[:3]).max() < 1e-12
    assert np.hypot(*(pose - start)[:2]) > 0.01
    cells = system.GetOutputPort("cell_positions").Eval(context).reshape(-1, 2)
    assert np.allclose(cells, cell_poses(pose, block().centers).reshape(-1, 3)[:, :2], atol=1e-14)


def test_parameters_live_in_the_context() -> None:
    push = table_pushes(1, 5)[0]
    system = system_of("plain")
    context = system.CreateDefaultContext()
    other = context.Clone()
    maps = Maps(1.5 * maps_of("plain").mass[:, ::-1], maps_of("plain").mu, np.array([0.1]))
    system.set_maps(other, maps)
    assert np.array_equal(context.get_numeric_parameter(MASS).value(), maps_of("plain").mass[0])
    count = len(push.tip) - 1
    for which, told in ((context, maps_of("plain")), (other, maps)):
        rows = steps(system, which, push, count, lambda c=which: system.GetOutputPort("object_pose").Eval(c))
        expected = rollout("plain", push, told).end[0, 0, :3]
        assert np.abs(rows[-1] - expected).max() < 1e-11
    ends = [c.get_discrete_state_vector().value()[2] for c in (context, other)]
    assert abs(ends[0] - ends[1]) > 0.01


def test_copies_of_the_system() -> None:
    system = system_of("loose_mass")
    assert CellGridSlider_[float] is CellGridSlider
    assert autodiff_system_of("loose_mass").num_input_ports() == 2
    copy = system.Clone()
    context = copy.CreateDefaultContext()
    assert np.array_equal(context.get_numeric_parameter(EFFECTS).value(), VALUES["loose_mass"])
    back = autodiff_system_of("loose_mass").ToScalarType[float]()
    assert np.array_equal(
        back.CreateDefaultContext().get_numeric_parameter(EFFECTS).value(), VALUES["loose_mass"]
    )


def test_one_model_only() -> None:
    with pytest.raises(ValueError, match="holds one model, the maps are of 4"):
        CellGridSlider(block(), block_belief().maps, RADIUS, H)
    system = system_of("plain")
    with pytest.raises(ValueError, match="holds one model"):
        system.set_maps(system.CreateDefaultContext(), block_belief().maps)


@pytest.mark.parametrize(
    ("pose", "twist", "told"),
    [
        ([np.nan, 0.0, 0.0], None, "pose must be three finite numbers, got .*nan"),
        ([0.0, 0.0], None, "pose must be three"),
        ([0.0, 0.0, 0.0], [0.0, np.inf, 0.0], "twist must be three finite numbers, got .*inf"),
        ([0.0, 0.0, 0.0], [0.1], "twist must be three"),
    ],
)
def test_a_motion_that_is_none_is_refused(pose: list[float], twist: list[float] | None, told: str) -> None:
    system = CellGridSlider(block(), block_belief().maps[:1], RADIUS, H)
    with pytest.raises(ValueError, match=told):
        system.set_motion(system.CreateDefaultContext(), pose, twist)


@pytest.mark.parametrize("hypothesis", [-1, 4, 99])
def test_a_hypothesis_that_the_belief_lacks_is_refused(hypothesis: int) -> None:
    with pytest.raises(ValueError, match=f"hypotheses 0 to 3, got hypothesis {hypothesis}"):
        slider_of_hypothesis(block_belief(4), hypothesis, H)
