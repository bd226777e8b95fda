"""The true world of the campaigns: Drake's MultibodyPlant with a finger on a prescribed path, without arm."""

import numpy as np
from pydrake.geometry import AddContactMaterial, ProximityProperties
from pydrake.multibody import tree
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource, VectorLogSink
from pydrake.trajectories import PiecewisePolynomial

from slipmap.diagrams.application.campaigns.worlds import (
    AT_REST,
    LONGEST_SETTLING,
    PERIOD,
    DirectWorld,
    Motion,
    WorldNoise,
    flat_pose,
)
from slipmap.diagrams.station import sliding_object
from slipmap.diagrams.station.finger_contact import YIELD_AT_RIGID_FINGER, push_with_balls
from slipmap.diagrams.station.hidden_effects import HiddenEffectsConfig, add_hidden_effects
from slipmap.diagrams.station.table import TABLE_FRICTION, add_table
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import FINGER_RADIUS

_TOUCHED_AT = 2.5e-3  # m above the table, where the finger touches
_AWAY = np.array([50.0, 50.0])
_LOOK = 0.02  # s between two checks whether the object rests or is lost
_LEAST_SETTLING = 0.25  # s


class PlantWorld(DirectWorld):
    """The object of the station on the station's table, pushed by a finger that nothing can stop.

    Args:
        hidden: effects that the object's model does not know.

    Raises:
        ValueError: a friction that Drake's combination rule cannot give.
    """

    _step = 1e-3  # s; with 2 ms, taps end 0.4 to 0.6 mm off, single ones of the wrench 24 mm

    def __init__(
        self,
        true_object: TrueObject,
        noise: WorldNoise | None = None,
        *,
        hidden: HiddenEffectsConfig | None = None,
    ) -> None:
        super().__init__(true_object, noise)
        builder = DiagramBuilder()
        plant, _ = AddMultibodyPlant(sliding_object.plant_config(self._step), builder)
        add_table(plant, self.table)
        sliding_object.add_sliding_object(plant, true_object, TABLE_FRICTION)
        self._finger = _add_finger(plant, true_object)
        plant.Finalize()
        if hidden is not None:
            add_hidden_effects(builder, plant, true_object, hidden)
        self._path = builder.AddSystem(TrajectorySource(PiecewisePolynomial(_AWAY[:, None]), 1))
        builder.Connect(self._path.get_output_port(), plant.get_desired_state_input_port(self._finger))
        # All rows are logged in the engine: nothing of a push runs in Python.
        self._states = builder.AddSystem(VectorLogSink(plant.num_multibody_states()))
        builder.Connect(plant.get_state_output_port(), self._states.get_input_port())
        self._contact = builder.AddSystem(VectorLogSink(2))
        builder.Connect(
            plant.get_generalized_contact_forces_output_port(self._finger), self._contact.get_input_port()
        )
        self._plant = plant
        self._body = plant.GetBodyByName(sliding_object.BODY)
        self._simulator = Simulator(builder.Build())
        self._root = self._simulator.get_mutable_context()
        self._context = plant.GetMyMutableContextFromRoot(self._root)

    def _place(self, pose: FloatArray) -> None:
        diagram = self._simulator.get_system()
        self._root.SetTime(0.0)
        diagram.SetDefaultContext(self._root)
        x, y, angle = pose
        sink = sliding_object.sink_of(self.true_object)
        X_WO = sliding_object.resting_pose(x, y, angle, sink=sink)
        self._plant.SetFreeBodyPose(self._context, self._body, X_WO)
        self._take_finger_away()

    def _drive(self, tip: FloatArray) -> Motion:
        h = self._step
        times = h * np.arange(len(tip))
        # The drive reaches at the end of a step what is desired at its beginning.
        path = PiecewisePolynomial.CubicHermite(times - h, tip.T, np.gradient(tip, h, axis=0).T)
        self._path.UpdateTrajectory(path)
        self._root.SetTime(0.0)
        self._plant.SetPositions(self._context, self._finger, tip[0])
        for sink in (self._states, self._contact):
            sink.FindMutableLog(self._root).Clear()
        self._simulator.Initialize()  # logs the first row
        # Drake's contact solver sometimes fails with an object tumbling over the rim: stop there.
        for end in (*times[1 : -1 : round(_LOOK / h)], times[-1]):
            if self._lost():
                break
            self._simulator.AdvanceTo(end)
        stride = round(PERIOD / h)
        joints = [self._plant.GetJointByName(name) for name in ("finger_x", "finger_y")]
        states = np.asarray(self._states.FindLog(self._root).data()).T[::stride]
        # Force on the finger, with the opposite sign.
        forces = _means(-np.asarray(self._contact.FindLog(self._root).data()).T, stride)
        self._take_finger_away()
        lost = 1 + (len(tip) - 1) // stride - len(states)
        return Motion(
            np.vstack([self._poses(states), np.full((lost, 3), np.nan)]),
            np.vstack(
                [states[:, [joint.position_start() for joint in joints]], tip[::stride][len(states) :]]
            ),
            np.vstack([forces, np.zeros((lost, 2))]),
        )

    def _lost(self) -> bool:
        return bool(np.isnan(self._pose()).any())

    def _settle(self) -> None:
        begin = self._root.get_time()
        while self._root.get_time() < begin + LONGEST_SETTLING and not self._lost():
            self._simulator.AdvanceTo(self._root.get_time() + _LOOK)
            velocity = np.abs(self._plant.GetVelocities(self._context, self._body.model_instance())).max()
            if self._root.get_time() > begin + _LEAST_SETTLING and velocity < AT_REST:
                return

    def _pose(self) -> FloatArray:
        return self._poses(self._plant.GetPositionsAndVelocities(self._context)[None])[0]

    def _take_finger_away(self) -> None:
        self._root.SetTime(0.0)
        self._path.UpdateTrajectory(PiecewisePolynomial(_AWAY[:, None]))
        self._plant.SetPositions(self._context, self._finger, _AWAY)
        self._plant.SetVelocities(self._context, self._finger, np.zeros(2))
        self._simulator.Initialize()

    def _poses(self, states: FloatArray) -> FloatArray:
        """(T, 3) poses from rows of the plant's state; NaN where the object is not flat on the table."""
        start = self._body.floating_positions_start()
        return flat_pose(states[:, start + 4 : start + 7], *states[:, start : start + 4].T)


def _add_finger(plant: MultibodyPlant, true_object: TrueObject) -> tree.ModelInstanceIndex:
    """Add an upright round finger on two prismatic joints with a drive too stiff to yield."""
    instance = plant.AddModelInstance("finger")
    inertia = tree.SpatialInertia.SolidSphereWithMass(1.0, 0.02)
    carriage = plant.AddRigidBody("carriage", instance, inertia)
    finger = plant.AddRigidBody("finger", instance, inertia)
    for name, parent, child, axis in (
        ("finger_x", plant.world_frame(), carriage.body_frame(), [1.0, 0.0, 0.0]),
        ("finger_y", carriage.body_frame(), finger.body_frame(), [0.0, 1.0, 0.0]),
    ):
        joint = plant.AddJoint(tree.PrismaticJoint(name, parent, child, np.array(axis)))
        plant.AddJointActuator(name, joint).set_controller_gains(tree.PdControllerGains(p=1e7, d=1e5))
    contact = ProximityProperties()
    friction = CoulombFriction(sliding_object.FINGER_FRICTION, sliding_object.FINGER_FRICTION)
    AddContactMaterial(dissipation=20.0, point_stiffness=1e8, friction=friction, properties=contact)
    balls = [(finger, np.array([0.0, 0.0, _TOUCHED_AT]))]
    push_with_balls(plant, true_object, balls, FINGER_RADIUS, contact, wall_yield=YIELD_AT_RIGID_FINGER)
    return instance


def _means(values: FloatArray, stride: int) -> FloatArray:
    """(T, 2) means over successive blocks of `stride` rows, after the first row itself."""
    count = (len(values) - 1) // stride
    means = values[1 : 1 + count * stride].reshape(count, stride, -1).mean(axis=1)
    return np.vstack([values[:1], means])
