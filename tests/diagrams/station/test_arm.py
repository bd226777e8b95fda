"""The arm in the plant: kinematics, weights, how it stands and what its drivers do."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from slipmap.diagrams.station.arm import HOME, add_arm, add_arm_drivers, arm_model, default_arm_base
from slipmap.models.robots import FINGER_RADIUS, GRIPPER_OPENING, POSITION_LIMITS, TORQUE_LIMITS

HAND_TO_TIP = 0.2


def turn(axis, angle):
    """Rotation about a coordinate axis."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = {0: (1, 2), 1: (2, 0), 2: (0, 1)}[axis]
    matrix = np.eye(4)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def shift(height):
    matrix = np.eye(4)
    matrix[2, 3] = height
    return matrix


def forward_kinematics(q):
    """Denavit-Hartenberg: the R820 has d1, d3, d5, d7 = 360, 420, 400, 126 mm and joints at right angles.

    The finger is 100 mm further on, points along -y of the flange and ends 158 mm beside its axis.
    """
    d = [0.36, 0.0, 0.42, 0.0, 0.4, 0.0, 0.126 + 0.1]
    alpha = np.array([-1, 1, 1, -1, -1, 1, 0]) * np.pi / 2
    pose = np.eye(4)
    for k in range(7):
        pose = pose @ turn(2, q[k]) @ shift(d[k]) @ turn(0, alpha[k])
    return pose @ turn(0, np.pi / 2) @ shift(0.158)


@pytest.fixture(scope="module")
def upright():
    return arm_model(RigidTransform())


@pytest.mark.parametrize("seed", range(5))
def test_kinematics_are_the_published_ones(upright, seed):
    q = np.random.default_rng(seed).uniform(-1, 1, 7) * POSITION_LIMITS
    context = upright.CreateDefaultContext()
    upright.SetPositions(context, q)
    X_BT = upright.GetFrameByName("tip").CalcPoseInWorld(context).GetAsMatrix4()
    np.testing.assert_allclose(X_BT, forward_kinematics(q), atol=1e-9)


def test_stretched_arm_reaches_as_far_as_the_data_sheet_says(upright):
    """820 mm from the shoulder to the wrist is what R820 means."""
    context = upright.CreateDefaultContext()
    upright.SetPositions(context, np.zeros(7))
    wrist = upright.EvalBodyPoseInWorld(context, upright.GetBodyByName("iiwa_link_6")).translation()
    np.testing.assert_allclose(wrist, [0, 0, 0.36 + 0.82], atol=1e-12)


class Station:
    """Arm and drivers alone."""

    def __init__(self):
        builder = DiagramBuilder()
        self.plant = builder.AddNamedSystem("plant", MultibodyPlant(0.002))
        self.arm = add_arm(self.plant)
        self.plant.Finalize()
        add_arm_drivers(builder, self.plant, self.arm)
        self.diagram = builder.Build()

    def simulator(self, position=HOME, opening=0.0):
        simulator = Simulator(self.diagram)
        self.command(simulator, position, opening)
        return simulator

    def command(self, simulator, position, opening, force_limit=40.0):
        context = simulator.get_mutable_context()
        self.diagram.GetInputPort("iiwa.position").FixValue(context, position)
        self.diagram.GetInputPort("gripper.position").FixValue(context, [opening])
        self.diagram.GetInputPort("gripper.force_limit").FixValue(context, [force_limit])

    def read(self, simulator, port):
        return self.diagram.GetOutputPort(port).Eval(simulator.get_context())

    def plant_context(self, simulator):
        return self.plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())


@pytest.fixture(scope="module")
def station():
    return Station()


def test_arm_holds_still_under_gravity(station):
    simulator = station.simulator()
    np.testing.assert_array_equal(station.read(simulator, "iiwa.position_measured"), HOME)
    simulator.AdvanceTo(0.5)
    np.testing.assert_allclose(station.read(simulator, "iiwa.position_measured"), HOME, atol=1e-7)
    np.testing.assert_allclose(station.read(simulator, "iiwa.velocity_estimated"), 0, atol=1e-6)
    np.testing.assert_allclose(station.read(simulator, "iiwa.torque_external"), 0, atol=1e-9)


@pytest.mark.parametrize("joint", ["left_finger_joint", "right_finger_joint"])
def test_the_closed_gripper_does_not_give_way(station, joint):
    """30 N spread the pins: as much as a heavy box gives at first touch."""
    simulator = station.simulator()
    force = np.zeros(station.plant.num_velocities())
    force[station.plant.GetJointByName(joint).velocity_start()] = -30.0 if joint.startswith("left") else 30.0
    simulator.AdvanceTo(0.2)
    station.plant.get_applied_generalized_force_input_port().FixValue(station.plant_context(simulator), force)
    simulator.AdvanceTo(0.4)
    assert abs(station.read(simulator, "gripper.state_measured")[0]) < 1e-4


def test_without_its_drivers_the_arm_falls(station):
    """The test above would pass for an arm without weight."""
    plant = MultibodyPlant(0.002)
    arm = add_arm(plant)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    for instance, n in ((arm.iiwa, 7), (arm.gripper, 2)):
        plant.get_actuation_input_port(instance).FixValue(context, np.zeros(n))
    simulator = Simulator(plant, context)
    simulator.AdvanceTo(0.3)
    assert np.abs(plant.GetPositions(context, arm.iiwa) - HOME).max() > 0.05


def test_controller_knows_the_weight_of_arm_and_gripper(station):
    model = arm_model()
    controlled, simulated = model.CreateDefaultContext(), station.plant.CreateDefaultContext()
    model.SetPositions(controlled, HOME)
    assert model.CalcTotalMass(controlled) == pytest.approx(station.plant.CalcTotalMass(simulated))
    gravity = station.plant.CalcGravityGeneralizedForces(simulated)
    joints = [station.plant.GetJointByName(f"iiwa_joint_{i}").velocity_start() for i in range(1, 8)]
    expected = model.CalcGravityGeneralizedForces(controlled)
    assert np.abs(expected).max() > 20.0
    assert np.all(np.abs(expected) < TORQUE_LIMITS)
    np.testing.assert_allclose(gravity[joints], expected, atol=1e-9)


def test_tip_is_the_same_in_plant_and_model(station):
    model = arm_model()
    context, plant_context = model.CreateDefaultContext(), station.plant.CreateDefaultContext()
    model.SetPositions(context, HOME)
    X_WT = model.GetFrameByName("tip").CalcPoseInWorld(context)
    np.testing.assert_allclose(
        station.plant.get_frame(station.arm.tip).CalcPoseInWorld(plant_context).GetAsMatrix4(),
        X_WT.GetAsMatrix4(),
        atol=1e-12,
    )


def test_joints_go_where_they_are_told(station):
    simulator = station.simulator()
    goal = HOME + 0.02 * np.array([1, -1, 1, -1, 1, -1, 1])
    station.command(simulator, goal, 0.0)
    simulator.AdvanceTo(0.5)
    np.testing.assert_allclose(station.read(simulator, "iiwa.position_measured"), goal, atol=1e-5)
    np.testing.assert_array_equal(station.read(simulator, "iiwa.position_commanded"), goal)


def test_gripper_opens_and_closes_with_both_fingers_alike(station):
    simulator = station.simulator(opening=GRIPPER_OPENING)
    simulator.AdvanceTo(1.0)
    opening, rate = station.read(simulator, "gripper.state_measured")
    assert opening == pytest.approx(GRIPPER_OPENING, abs=1e-4)
    assert rate == pytest.approx(0, abs=1e-4)
    left, right = station.plant.GetPositions(station.plant_context(simulator), station.arm.gripper)
    assert left == pytest.approx(-right, abs=1e-6)
    station.command(simulator, HOME, 0.0)
    simulator.AdvanceTo(2.0)
    assert station.read(simulator, "gripper.state_measured")[0] == pytest.approx(0, abs=1e-4)


def test_a_force_of_15_newton_moves_the_tip_by_less_than_half_a_millimetre(station):
    from pydrake.multibody.math import SpatialForce
    from pydrake.multibody.plant import ExternallyAppliedSpatialForce

    simulator = station.simulator()
    context = station.plant_context(simulator)
    before = station.plant.get_frame(station.arm.tip).CalcPoseInWorld(context).translation()
    hand = station.plant.GetBodyByName("hand")
    for direction in np.eye(3):
        force = ExternallyAppliedSpatialForce()
        force.body_index = hand.index()
        force.p_BoBq_B = np.array([0.0, 0.0, HAND_TO_TIP])
        force.F_Bq_W = SpatialForce(np.zeros(3), 15.0 * direction)
        station.plant.get_applied_spatial_force_input_port().FixValue(context, [force])
        simulator.AdvanceTo(simulator.get_context().get_time() + 0.3)
        moved = np.linalg.norm(
            station.plant.get_frame(station.arm.tip).CalcPoseInWorld(context).translation() - before
        )
        assert 1e-6 < moved < 0.5e-3


def test_stand_is_beyond_the_table():
    base = default_arm_base()
    assert np.hypot(*base.translation()[:2]) > 0.5
    np.testing.assert_allclose(
        base.rotation().matrix(), RollPitchYaw(0, np.pi / 2, 0).ToRotationMatrix().matrix(), atol=1e-12
    )


def test_arm_says_what_it_is(station):
    assert station.arm.finger_radius == FINGER_RADIUS
    assert station.plant.num_positions(station.arm.iiwa) == 7
    assert station.plant.num_positions(station.arm.gripper) == 2


def test_unknown_models_are_named():
    with pytest.raises(ValueError, match=r"'meshes'; choose one of primitives, drake_models"):
        add_arm(MultibodyPlant(0.002), models="meshes")
