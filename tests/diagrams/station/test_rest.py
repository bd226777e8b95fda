"""An object is held while it lies still and nothing is near it, and only then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from pydrake.common.cpp_param import List
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import EventStatus

from slipmap.diagrams.execution.arm_motion import FingerKinematics
from slipmap.diagrams.perception.camera import CameraConfig
from slipmap.diagrams.station.arm import HOME, arm_model
from slipmap.diagrams.station.rest import PERIOD, QUIET, RestWatch
from slipmap.diagrams.station.scenario import Scenario
from slipmap.diagrams.station.sliding_object import BODY, GRAVITY, resting_pose
from slipmap.diagrams.station.station import Station
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.physics.balance import balance_margins
from slipmap.models.robots import FINGER_RADIUS

pytestmark = pytest.mark.usefixtures("renderer")


@dataclass
class Watched:
    """A station whose simulator calls `after_step`."""

    station: Station
    simulator: Simulator

    @classmethod
    def of(cls, **hidden) -> Watched:
        scenario = Scenario(camera=CameraConfig(width=160, height_pixels=120))
        scenario.object.name = "book"
        for effect, values in hidden.items():
            for parameter, value in values.items():
                setattr(getattr(scenario.hidden, effect), parameter, value)
        station = Station(scenario)
        simulator = Simulator(station)
        root = simulator.get_mutable_context()
        station.GetInputPort("iiwa.position").FixValue(root, HOME)
        station.GetInputPort("gripper.position").FixValue(root, [0.0])

        def after(context) -> EventStatus:
            station.after_step(root)
            return EventStatus.DidNothing()

        simulator.set_monitor(after)
        return cls(station, simulator)

    @property
    def plant_state(self):
        return self.station.plant.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())

    def advance(self, duration: float) -> None:
        self.simulator.AdvanceTo(self.simulator.get_context().get_time() + duration)

    def held(self) -> bool:
        return bool(self.station.plant.GetBodyByName(BODY).is_locked(self.plant_state))

    def X_WO(self) -> RigidTransform:
        return self.station.GetOutputPort("truth.object_pose").Eval(self.simulator.get_context())

    def put(self, X_WO: RigidTransform) -> None:
        plant = self.station.plant
        plant.SetFreeBodyPose(self.plant_state, plant.GetBodyByName(BODY), X_WO)

    def reach(self, tip: np.ndarray) -> None:
        """Have the finger's end at a place (3,)."""
        q = FingerKinematics(arm_model()).inverse(tip)
        self.station.GetInputPort("iiwa.position").FixValue(self.simulator.get_mutable_context(), q)
        plant = self.station.plant
        plant.SetPositions(self.plant_state, self.station.arm.iiwa, q)
        plant.SetVelocities(self.plant_state, self.station.arm.iiwa, np.zeros(7))


@pytest.fixture(scope="module")
def book() -> Watched:
    watched = Watched.of()
    watched.advance(2 * QUIET)
    return watched


def test_it_is_held_after_a_while_and_stays_where_it_is(book: Watched):
    book.put(resting_pose(0.0, 0.0, 0.0))
    book.advance(2 * QUIET)
    assert book.held()
    place = book.X_WO()
    book.advance(0.5)
    assert book.X_WO().IsExactlyEqualTo(place)
    assert place.IsNearlyEqualTo(resting_pose(0.0, 0.0, 0.0), 2e-5)


def test_contacts_are_looked_for_again_as_soon_as_it_is_free(book: Watched):
    scene_graph = book.station.GetSubsystemByName("scene_graph")

    def touching() -> int:
        context = scene_graph.GetMyContextFromRoot(book.simulator.get_context())
        return len(scene_graph.get_query_output_port().Eval(context).ComputePointPairPenetration())

    for x in (0.01, 0.0):
        book.put(resting_pose(x, 0.0, 0.0))
        book.advance(0.1)
        assert not book.held() and touching() == 4 * len(book.station.true_object.grid)
        book.advance(2 * QUIET)
        assert book.held() and touching() == 0


def test_a_finger_close_beside_it_frees_it(book: Watched):
    book.put(resting_pose(0.0, 0.0, 0.0))
    for gap, height, held in ((0.28, 0.15, True), (0.003, 0.01, False), (0.28, 0.15, True)):
        book.reach(np.array([0.0, _side(book) + FINGER_RADIUS + gap, height]))
        book.advance(2 * QUIET)
        assert book.held() == held


@pytest.mark.parametrize(("speed", "away"), [(0.05, 0.03), (0.3, 0.03), (1.0, 0.065), (1.0, 0.07)])
def test_a_push_of_one_that_was_held_ends_as_that_of_one_that_was_not(speed: float, away: float):
    ends = []
    for held in (True, False):
        book = Watched.of()
        if not held:
            book.simulator.clear_monitor()
        start = np.array([0.0, _side(book) + FINGER_RADIUS + away, 0.01])
        book.reach(start)
        book.advance(2 * QUIET)
        assert book.held() == held
        motion = FingerKinematics(arm_model())
        went, now = 0.0, 0.0
        while went < away + 0.015:
            now = min(now + 10.0 * 0.005, speed)
            went += 0.005 * now
            q = motion.inverse(start - [0.0, went, 0.0])
            book.station.GetInputPort("iiwa.position").FixValue(book.simulator.get_mutable_context(), q)
            book.advance(0.005)
        book.advance(0.02)
        assert not book.held()
        ends.append(book.X_WO())
    assert ends[0].translation()[1] < -0.005  # pushed
    assert ends[0].IsNearlyEqualTo(ends[1], 1e-6)


def test_it_must_lie_still_for_a_while_without_being_touched_but_may_have_something_near(book: Watched):
    plant, arm = book.station.plant, book.station.arm
    watch = RestWatch(plant, book.station.GetSubsystemByName("scene_graph"), [arm.iiwa, arm.gripper])
    simulator = Simulator(watch)
    context = simulator.get_mutable_context()
    velocities = plant.GetOutputPort("body_spatial_velocities").Eval(plant.CreateDefaultContext())
    watch.GetInputPort("body_spatial_velocities").FixValue(context, Value[List[SpatialVelocity]](velocities))
    place = plant.CreateDefaultContext()
    plant.SetFreeBodyPose(place, plant.GetBodyByName(BODY), resting_pose(0.0, 0.0, 0.0))

    def after(duration: float, *, height: float, force: float = 0.0) -> bool:
        tip = np.array([0.0, _side(book) + FINGER_RADIUS + 0.002, height])
        plant.SetPositions(place, arm.iiwa, FingerKinematics(arm_model()).inverse(tip))
        poses = plant.GetOutputPort("body_poses").Eval(place)
        watch.GetInputPort("body_poses").FixValue(context, Value[List[RigidTransform]](poses))
        watch.GetInputPort("contact_forces").FixValue(context, np.full(7, force))
        simulator.AdvanceTo(context.get_time() + duration)
        return watch.at_rest(context)

    assert not after(2 * QUIET, height=0.01, force=0.1)
    assert not after(QUIET / 2, height=0.2)  # not touched for too short a time
    assert after(QUIET, height=0.2)
    assert not after(2 * QUIET, height=0.01)
    assert after(2.5 * PERIOD, height=0.2)  # near, but never touched


def _side(book: Watched) -> float:
    """y of the book's side while it lies at the origin, m."""
    grid = book.station.true_object.grid
    return float(grid.centers[:, 1].max() + grid.width / 2)


def test_one_that_was_put_elsewhere_by_hand_falls_from_there(book: Watched):
    book.put(RigidTransform(RollPitchYaw(0.0, 0.0, 0.5), np.array([0.05, 0.0, 0.04])))
    book.advance(3 * QUIET)
    assert book.X_WO().translation()[2] == pytest.approx(0.0, abs=1e-3)
    assert book.held()


def test_one_that_was_turned_by_hand_where_it_is_falls_back(book: Watched):
    book.put(resting_pose(0.0, 0.0, 0.0))
    book.advance(2 * QUIET)
    assert book.held()
    book.put(RigidTransform(RollPitchYaw(0.5, 0.0, 0.0), book.X_WO().translation()))
    book.advance(0.05)
    assert not book.held()


def test_one_that_begins_to_tip_over_the_edge_falls():
    """Its centre of mass 4 mm beyond the edge; it takes a while to be seen moving."""
    watched = Watched.of()
    thing = benchmark_object("book")
    table = Scenario().table.make()
    center = thing.center_of_mass[None, :2]
    near, far = 0.0, 0.8
    for _ in range(40):
        x = (near + far) / 2
        margin = balance_margins(thing.grid, center, [[x, 0.0, 0.0]], table)[0, 0]
        near, far = (x, far) if margin > -4e-3 else (near, x)
    watched.put(resting_pose(near, 0.0, 0.0))
    watched.advance(1.5)
    assert watched.X_WO().translation()[2] < -0.1


def test_one_on_a_slope_steeper_than_friction_slides_and_on_a_flatter_one_is_held():
    book = benchmark_object("book")
    friction = float((book.mass * book.mu).sum() / book.total_mass)
    for slope, slides in ((np.arctan(0.5 * friction), False), (np.arctan(1.2 * friction), True)):
        watched = Watched.of(table_tilt={"down_x": float(slope)})
        watched.advance(0.6)
        went = watched.X_WO().translation()[0]
        assert watched.held() != slides
        acceleration = GRAVITY * (np.sin(slope) - friction * np.cos(slope))
        if slides:
            assert went == pytest.approx(acceleration * 0.6**2 / 2, rel=0.1)
        else:
            assert abs(went) < 1e-4
