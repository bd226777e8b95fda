"""Gravity and the finger's radius are those of the scenario, in the plant and in what is recorded."""

import numpy as np
import pytest
from pydrake.geometry import Cylinder, Role
from pydrake.systems.analysis import Simulator

from slipmap.diagrams.loops.exploration_loop import recorded_dataset
from slipmap.diagrams.loops.pregrasp_loop import PregraspOptions, pregrasp_loop
from slipmap.diagrams.station.arm import lone_arm
from slipmap.diagrams.station.scenario import Scenario, ScenarioError
from slipmap.diagrams.station.sliding_object import sink_of
from slipmap.diagrams.station.station import Station
from slipmap.models.measurements import Trial
from slipmap.models.measurements.trial import Channel


@pytest.mark.parametrize("radius", [0.002, 0.008, 0.02])
def test_the_end_of_the_finger_has_the_radius_that_is_wanted(radius):
    plant, scene_graph, arm = lone_arm(finger_radius=radius)
    assert arm.finger_radius == radius
    inspector = scene_graph.model_inspector()
    finger = plant.GetFrameByName("left_finger", arm.gripper).body()
    shapes = [
        inspector.GetShape(shape)
        for shape in inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(finger.index()), Role.kProximity)
    ]
    radii = sorted(shape.radius() for shape in shapes if isinstance(shape, Cylinder))
    assert radii == pytest.approx([*4 * [radius - 0.5e-3], radius])
    # An upright side is touched at one height; along a long one the point of contact would jump and rock it.
    (length,) = (
        shape.length() for shape in shapes if isinstance(shape, Cylinder) and shape.radius() == radius
    )
    assert length <= 1e-3


def test_what_is_recorded_says_them():
    scenario = Scenario()
    scenario.gravity, scenario.execution.finger_radius = 1.62, 0.005
    scenario.execution.tip_height = 0.007
    grid = scenario.object.make().grid
    poses = Channel(np.array([0.0, 1.0]), np.array([[0, 0, 0], [0.1, 0, 0.2]]))
    trial = Trial("push.json", "fit", poses, Channel(np.array([0.0, 1.0]), np.zeros((2, 2))), None)
    dataset = recorded_dataset([trial], grid, scenario)
    assert (dataset.gravity, dataset.finger_radius, dataset.finger_height) == (1.62, 0.005, 0.007)
    with pytest.raises(ScenarioError, match="grasps are planned for pins"):
        pregrasp_loop(scenario, PregraspOptions())


def test_on_the_moon_an_object_rests_as_high_and_the_arm_stays_at_home(renderer):
    scenario = Scenario()
    scenario.gravity = 1.62
    station = Station(scenario)
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    station.GetInputPort("iiwa.position").FixValue(
        context, station.GetOutputPort("iiwa.position_measured").Eval(context)
    )
    station.GetInputPort("gripper.position").FixValue(context, [0.0])
    begin = station.GetOutputPort("iiwa.position_measured").Eval(context)
    simulator.AdvanceTo(0.2)
    X_WO = station.GetOutputPort("truth.object_pose").Eval(context)
    sink = sink_of(station.true_object)
    assert X_WO.translation()[2] == pytest.approx(-sink, abs=0.2 * sink)
    assert np.abs(station.GetOutputPort("iiwa.position_measured").Eval(context) - begin).max() < 1e-4
