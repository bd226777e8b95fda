"""Hidden effects in Drake's world do what the effects of the library of the same name do in the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, astuple, fields, replace

import numpy as np
import pytest
from pushed_object import FINGER_HEIGHT, FINGER_RADIUS, TestBed
from pydrake.common.value import AbstractValue
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, State
from pydrake.systems.sensors import ImageDepth32F

from slipmap.diagrams.station.hidden_effects import (
    HiddenEffects,
    HiddenEffectsConfig,
    LatePictures,
    SensorLatency,
    TableFrictionField,
    TableTilt,
    Tether,
    ViscousFriction,
    add_hidden_effects,
    tilted_gravity,
)
from slipmap.diagrams.station.placement import check_rest
from slipmap.diagrams.station.scenario import Scenario
from slipmap.diagrams.station.sliding_object import add_sliding_object, spatial_inertia
from slipmap.diagrams.systems.python_system import PythonSystem
from slipmap.models.effects import LIBRARY
from slipmap.models.effects.registry import effects_named
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.planners.exploration import candidate_pushes

SHOWN = {
    "table_tilt": TableTilt(0.06, -0.05),
    "tether": Tether(6.0, 0.1, 0.3, 0.1, 0.05, 0.02),
    "viscous_friction": ViscousFriction(400.0),
    "table_friction_field": TableFrictionField(1.5, -1.0, 0.6, -0.05, 0.1, 0.1),
}


@pytest.fixture(scope="module")
def box() -> TrueObject:
    return benchmark_object("box")


def _with(name: str, effect: object) -> HiddenEffectsConfig:
    return HiddenEffectsConfig(**{name: effect})


def _system(thing: TrueObject, config: HiddenEffectsConfig, step: float = 1e-3) -> HiddenEffects:
    plant, scene_graph = MultibodyPlant(step), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    add_sliding_object(plant, thing, 0.6)
    plant.Finalize()
    return HiddenEffects(plant, thing, config)


@pytest.mark.parametrize("name", SHOWN)
def test_pushed_object_follows_the_model_with_the_effect(name: str) -> None:
    thing, effect = benchmark_object("hammer"), SHOWN[name]
    candidate = candidate_pushes(thing.grid, FINGER_RADIUS, np.random.default_rng(3), 1)[0]
    push = replace(candidate, length=0.06, speed=0.06).push([-0.05, 0.02, 0.3], h=2.5e-3, rest=0.05)
    # Forces at the heights of the finger's end and of the centre of mass also shift load.
    heights = [FINGER_HEIGHT, thing.mass @ thing.height / 2 / thing.total_mass]

    def modelled(*names: str, values: Sequence[float]) -> FloatArray:
        maps = Maps(thing.mass, thing.mu, thing.maps.mu_finger, np.array([values]))
        slider = Slider(thing.grid, FINGER_RADIUS, effects=effects_named(names))
        return slider.rollout(maps, [push]).poses_of(0)[0]

    expected = modelled(name, "load_transfer", values=[*astuple(effect), *heights])
    without = modelled("load_transfer", values=heights)

    bed = TestBed(thing, finger=True, hidden=_with(name, effect))
    bed.start(push.start_pose, push.tip[0])
    off = bed.follow(push.tip, push.h)[1:] - expected
    # Largest motion of a point 10 cm from the object's middle.
    reach = np.array([1.0, 1.0, 0.1])
    size = np.abs((without - expected) * reach).max(axis=0).sum()
    assert size > 5e-3
    assert np.abs(off * reach).max(axis=0).sum() < 0.06 * size


def test_parameters_are_those_of_the_library() -> None:
    library = {effect.name: effect for effect in LIBRARY}
    for hidden in fields(HiddenEffectsConfig):
        named = [parameter.name for parameter in library[hidden.name].parameters]
        assert [item.name for item in fields(hidden.type)] == named


def test_nothing_hidden_is_no_force(box: TrueObject) -> None:
    assert HiddenEffectsConfig().is_null
    assert add_hidden_effects(None, None, box, HiddenEffectsConfig()) is None
    for name, effect in SHOWN.items():
        assert not _with(name, effect).is_null
    force, torque = _system(box, HiddenEffectsConfig()).wrench(
        RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [0.1, 0.2, 0.0]), SpatialVelocity([1, 2, 3], [4, 5, 6])
    )
    np.testing.assert_array_equal([force, torque], 0.0)


def test_tilt_turns_gravity_and_keeps_its_size() -> None:
    gravity = tilted_gravity(TableTilt(0.1, -0.2))
    assert np.linalg.norm(gravity) == pytest.approx(9.81)
    assert np.arctan2(gravity[0], -gravity[2]) == pytest.approx(0.1)
    assert np.arctan2(gravity[1], -gravity[2]) == pytest.approx(-0.2)
    np.testing.assert_allclose(tilted_gravity(TableTilt()), [0, 0, -9.81])


def test_tilt_acts_at_the_center_of_mass(box: TrueObject) -> None:
    system = _system(box, _with("table_tilt", TableTilt(0.1, 0.0)))
    X_WO = RigidTransform(RollPitchYaw(0, 0, 1.1), [0.2, 0.1, 0.0])
    force, torque = system.wrench(X_WO, SpatialVelocity.Zero())
    assert force[0] == pytest.approx(box.total_mass * 9.81 * np.sin(0.1))
    np.testing.assert_allclose(torque, np.cross(X_WO.rotation() @ box.center_of_mass, force), atol=1e-12)


def test_object_on_a_steep_table_slides_down(box: TrueObject) -> None:
    slope = 0.45
    even = replace(box, mu=np.full(len(box.grid), 0.3), mass=np.full(len(box.grid), 0.03))
    bed = TestBed(even, hidden=_with("table_tilt", TableTilt(down_y=slope)))
    bed.start(np.zeros(3))
    bed.advance(0.4)
    acceleration = 9.81 * (np.sin(slope) - 0.3 * np.cos(slope))
    assert bed.pose[1] == pytest.approx(acceleration * 0.4**2 / 2, rel=0.03)


def test_tether_pulls_beyond_its_slack_at_its_point(box: TrueObject) -> None:
    system = _system(box, _with("tether", Tether(50.0, 0.5, 0.0, 0.2, 0.1, 0.0)))
    X_WO = RigidTransform(RollPitchYaw(0, 0, np.pi / 2), [0.0, 0.0, 0.0])
    force, torque = system.wrench(X_WO, SpatialVelocity.Zero())
    way = np.array([0.5, -0.1, 0.0])
    length = np.linalg.norm(way)
    np.testing.assert_allclose(force, 50.0 * (length - 0.2) * way / length)
    np.testing.assert_allclose(torque, np.cross([0.0, 0.1, 0.0], force), atol=1e-12)
    slack, _ = system.wrench(RigidTransform([0.25, 0.0, 0.0]), SpatialVelocity.Zero())
    np.testing.assert_array_equal(slack, 0.0)


@pytest.mark.parametrize("down_y", [0.0, -0.12])
def test_object_that_a_tether_moves_by_itself_is_refused(box: TrueObject, down_y: float) -> None:
    scenario = Scenario()
    scenario.object.pose = [0.1, -0.05, 40.0]
    scenario.hidden.table_tilt.down_y = down_y
    scenario.hidden.tether = Tether(1.0, 0.3, 0.4, 0.05, 0.09, 0.03)

    def told(stiffness: float) -> str:
        scenario.hidden.tether.stiffness = stiffness
        try:
            check_rest(scenario, box)
        except ValueError as refused:
            return str(refused)
        return ""

    low, high = 0.1, 100.0
    while high - low > 0.01:
        middle = (low + high) / 2
        low, high = (low, middle) if told(middle) else (middle, high)
    assert "hidden.tether: object box does not stay" in told(high)
    x, y, degrees = scenario.object.pose
    moved = []
    for share in (0.97, 1.03):
        scenario.hidden.tether.stiffness = share * low
        bed = TestBed(box, hidden=scenario.hidden)
        bed.start(np.array([x, y, np.radians(degrees)]))
        before = bed.pose
        bed.advance(0.3)
        moved.append(np.abs(bed.pose - before).max())
    assert moved[0] < 1e-3 and moved[1] > 4e-3, moved


def test_drag_is_the_integral_over_the_base(box: TrueObject) -> None:
    system = _system(box, _with("viscous_friction", ViscousFriction(200.0)))
    velocity = SpatialVelocity([0, 0, 2.0], [0.3, -0.1, 0.0])
    force, torque = system.wrench(RigidTransform(), velocity)
    half = box.grid.width / 2
    total, moment = np.zeros(3), np.zeros(3)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    for x, y in box.grid.centers:
        for a, p in zip(nodes, weights, strict=True):
            for b, q in zip(nodes, weights, strict=True):
                place = np.array([x + half * a, y + half * b, 0.0])
                f = -200.0 * p * q * half**2 * (np.array([0.3, -0.1, 0]) + np.cross([0, 0, 2.0], place))
                total, moment = total + f, moment + np.cross(place, f)
    np.testing.assert_allclose(force, total)
    np.testing.assert_allclose(torque, moment, atol=1e-12)


def test_no_drag_above_the_table(box: TrueObject) -> None:
    both = HiddenEffectsConfig(
        viscous_friction=SHOWN["viscous_friction"],  # type: ignore[arg-type]
        table_friction_field=SHOWN["table_friction_field"],  # type: ignore[arg-type]
    )
    moving = SpatialVelocity([0, 0, 2.0], [0.3, -0.1, 0.0])
    force, torque = _system(box, both).wrench(RigidTransform([0.0, 0.0, 0.05]), moving)
    np.testing.assert_array_equal([force, torque], 0.0)


def test_patch_makes_up_for_the_missing_friction(box: TrueObject) -> None:
    system = _system(
        box, _with("table_friction_field", TableFrictionField(patch=np.log(3.0), patch_radius=1.0))
    )
    force, _ = system.wrench(RigidTransform(), SpatialVelocity([0, 0, 0], [0.0, -0.5, 0.0]))
    friction = float(box.mass @ box.mu) * 9.81
    assert force[1] == pytest.approx(2.0 * friction, rel=2e-3)
    slippery = _with("table_friction_field", TableFrictionField(patch=np.log(0.5), patch_radius=1.0))
    force, _ = _system(box, slippery).wrench(RigidTransform(), SpatialVelocity([0, 0, 0], [0.5, 0, 0]))
    assert force[0] == pytest.approx(0.5 * friction, rel=2e-3)
    outside, _ = system.wrench(RigidTransform([1.5, 0, 0]), SpatialVelocity([0, 0, 0], [0.5, 0, 0]))
    np.testing.assert_array_equal(outside, 0.0)


@pytest.mark.parametrize("factor", [0.5, 2.0, 5.0])
def test_slow_pushes_feel_all_of_a_patchs_friction(box: TrueObject, factor: float) -> None:
    field = TableFrictionField(patch=np.log(factor), patch_radius=1.0)
    system = _system(box, _with("table_friction_field", field), step=2.5e-3)
    force, _ = system.wrench(RigidTransform(), SpatialVelocity([0, 0, 0], [0.0, -0.04, 0.0]))
    friction = float(box.mass @ box.mu) * 9.81
    assert force[1] + friction == pytest.approx(factor * friction, rel=0.02)


def test_a_slow_push_turns_an_object_alike_whatever_the_uniform_friction(box: TrueObject) -> None:
    sticky = _with("table_friction_field", TableFrictionField(patch=1.5, patch_radius=5.0))
    low = box.grid.polygon.bounds[1] - 0.01
    tip = np.column_stack([np.zeros(151), low + np.arange(151) * 4e-4])
    turned = []
    for hidden in (None, sticky):
        bed = TestBed(box, finger=True, hidden=hidden)
        bed.start(np.zeros(3), tip[0])
        turned.append(bed.follow(tip, 0.01)[-1, 2])
    assert turned[0] > np.radians(10.0)
    assert turned[1] == pytest.approx(turned[0], abs=np.radians(1.2))


def test_friction_of_a_patch_never_drives_an_object_back(box: TrueObject) -> None:
    field = TableFrictionField(patch=1.5, patch_x=0.03, patch_radius=0.05)
    system = _system(box, _with("table_friction_field", field), step=2.5e-3)
    inertia = spatial_inertia(box)
    matrix = inertia.CopyToFullMatrix6()[np.ix_([2, 3, 4], [2, 3, 4])]
    rng = np.random.default_rng(0)
    for size in (1e-5, 1e-3, 1e-2, 0.1):
        motion = size * rng.standard_normal(3) * [10.0, 1.0, 1.0]
        force, torque = system.wrench(
            RigidTransform(), SpatialVelocity([0, 0, motion[0]], [motion[1], motion[2], 0])
        )
        after = motion + 2.5e-3 * np.linalg.solve(matrix, [torque[2], force[0], force[1]])
        assert after @ matrix @ after < motion @ matrix @ motion
        assert after @ [torque[2], force[0], force[1]] < 1e-9  # it still brakes at the end of the step


def test_friction_field_too_strong_for_the_time_step_is_refused_with_what_would_do(box: TrueObject) -> None:
    def built(step: float, **field: float) -> HiddenEffects:
        effect = TableFrictionField(patch_radius=1.0)
        return _system(box, _with("table_friction_field", replace(effect, **field)), step)

    with pytest.raises(ValueError, match=r"2\.2e\+04 times .* 0\.04 m/s; at most 5\.\d+ times, or a smaller"):
        built(2.5e-3, patch=10.0)
    with pytest.raises(ValueError, match="too strong"):
        built(2.5e-3, patch=800.0)
    with pytest.raises(ValueError, match="too strong"):
        built(5e-3, gradient_x=-8.0)
    built(2.5e-3, gradient_x=-8.0)
    built(2.5e-3, patch=-700.0)
    built(5e-3, patch=1.0)
    built(1e-3, patch=2.2)


def test_friction_factor_by_place() -> None:
    field = TableFrictionField(2.0, 0.0, np.log(2.0), 0.1, 0.0, 0.05)
    np.testing.assert_allclose(field.factor(np.array([[0.1, 0.0], [0.2, 0.0], [-0.6, 0.0]])), [2.0, 1.2, 0.0])


@pytest.mark.parametrize(
    ("name", "effect", "message"),
    [
        ("table_tilt", TableTilt(down_x=float("nan")), r"TableTilt\.down_x"),
        ("table_tilt", TableTilt(down_x=3.0), "at most 0.5"),
        ("tether", Tether(stiffness=-1.0), r"Tether\.stiffness must be finite and not negative"),
        ("tether", Tether(stiffness=1e8), r"Tether\.stiffness: too stiff"),
        ("viscous_friction", ViscousFriction(1e6), r"ViscousFriction\.drag_per_area: too large"),
        ("table_friction_field", TableFrictionField(patch_radius=-0.1), "patch_radius"),
    ],
)
def test_wrong_parameters_are_refused_by_name(
    box: TrueObject, name: str, effect: object, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        _system(box, _with(name, effect))


def test_configuration_goes_through_yaml() -> None:
    config = HiddenEffectsConfig(**SHOWN)  # type: ignore[arg-type]
    again = yaml_load_typed(schema=HiddenEffectsConfig, data=yaml_dump_typed(config))
    assert asdict(again) == asdict(config)


class _Clock(PythonSystem):
    """Pictures of one pixel that shows the time."""

    def __init__(self) -> None:
        super().__init__()

        def show(context: Context, output: AbstractValue) -> None:
            output.set_value(ImageDepth32F(1, 1, context.get_time()))

        self.DeclareAbstractOutputPort("image", lambda: AbstractValue.Make(ImageDepth32F()), show)


class _Viewer(PythonSystem):
    """Looks at pictures once a period and notes the age of each, s."""

    def __init__(self, period: float) -> None:
        super().__init__()
        self.ages: list[float] = []
        self.DeclareAbstractInputPort("image", AbstractValue.Make(ImageDepth32F()))
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._look)

    def _look(self, context: Context, state: State) -> None:
        picture = self.EvalAbstractInput(context, 0).get_value()
        if picture.width():
            self.ages.append(context.get_time() - picture.data[0, 0, 0])


@pytest.mark.parametrize(
    ("latency", "rate"),
    [(0.08, 10), (0.1, 10), (0.13, 10), (0.29, 10), (0.05, 30), (0.1, 30), (0.2, 25), (0.2, 15), (0.25, 12)],
)
def test_late_pictures_show_what_was_a_while_ago(latency: float, rate: float) -> None:
    builder, period = DiagramBuilder(), 1.0 / rate
    late = builder.AddSystem(LatePictures(latency, period))
    viewer = builder.AddSystem(_Viewer(period))
    builder.Connect(builder.AddSystem(_Clock()).get_output_port(), late.get_input_port())
    builder.Connect(late.get_output_port(), viewer.get_input_port())
    simulator = Simulator(builder.Build())
    context = late.GetMyContextFromRoot(simulator.get_context())
    simulator.Initialize()
    assert late.get_output_port().Eval(context).width() == 0  # nothing was taken so long ago
    simulator.AdvanceTo(2.0)
    assert len(viewer.ages) > (2.0 - latency) * rate - 2.0
    assert viewer.ages == pytest.approx([latency] * len(viewer.ages), abs=1e-6)


def test_a_station_with_late_pictures_moves_nothing() -> None:
    config = HiddenEffectsConfig(sensor_latency=SensorLatency(0.08))
    assert not config.is_null and not config.is_forceful
    with pytest.raises(ValueError, match=r"at most 0.3 s, got 0.5"):
        HiddenEffectsConfig(sensor_latency=SensorLatency(0.5)).check()
