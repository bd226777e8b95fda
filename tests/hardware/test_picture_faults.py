"""Depth pictures that go wrong while an object moves: no fault becomes a wrong pose, each is told by name."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource
from pydrake.systems.sensors import ImageDepth32F

from slipmap.diagrams.perception.camera import CameraConfig
from slipmap.diagrams.perception.cell_perception import OLD, CellPerception
from slipmap.diagrams.systems.python_system import PythonSystem
from slipmap.models.perception.pinhole_camera import View
from tests.hardware.faults import PictureLink
from tests.models.perception.conftest import Scene

RATE = 10.0
CAMERA = CameraConfig(rate=RATE)
PERIOD = 1 / RATE
BOXES = ((-0.1, -0.06, 0.1, 0.0, 0.03), (-0.1, 0.0, -0.03, 0.08, 0.05))
START = np.array([0.0, -0.02, 0.3])
MOVES = 1.7
"""s; until then the object rests."""
FAULT = 2.0
STOPS = 3.0
SPEED = np.array([0.06, -0.03, 0.2])
ENOUGH = np.array([2e-3, 2e-3, np.radians(1.0)])
"""m, m, rad by which a pose may be off."""


class MovingScene(Scene):
    """Seen by the station's camera."""

    def __init__(self) -> None:
        self.view = View(CAMERA.intrinsics, CAMERA.X_WC.GetAsMatrix4())


SCENE = MovingScene()


def pose_at(time: float) -> np.ndarray:
    return START + SPEED * (np.clip(time, MOVES, STOPS) - MOVES)


@lru_cache(maxsize=64)
def exact(pose: tuple[float, ...]) -> np.ndarray:
    return SCENE.depth(BOXES, pose)


@lru_cache(maxsize=64)
def taken(frame: int, noise: bool) -> np.ndarray:
    depth = exact(tuple(pose_at(frame * PERIOD)))
    return SCENE.noisy(depth, np.random.default_rng(frame)) if noise else depth


class Movie(PythonSystem):
    def __init__(self, noise: bool) -> None:
        super().__init__()
        self._noise = noise
        self.DeclareAbstractOutputPort(
            "depth_image", lambda: AbstractValue.Make(ImageDepth32F()), self._calc, {self.time_ticket()}
        )

    def _calc(self, context, output) -> None:
        depth = taken(round(context.get_time() * RATE), self._noise)
        picture = ImageDepth32F(CAMERA.width, CAMERA.height_pixels)
        picture.mutable_data[:, :, 0] = depth
        output.set_value(picture)


class Watched:
    """Movie, link and perception, brought to just before the fault."""

    def __init__(self, *, stamped: bool = True, noise: bool = True) -> None:
        builder = DiagramBuilder()
        movie = builder.AddSystem(Movie(noise))
        self.link = builder.AddSystem(PictureLink(PERIOD))
        self.perception = builder.AddSystem(CellPerception(CAMERA, 40))
        place = builder.AddSystem(ConstantValueSource(Value(CAMERA.X_WC)))
        builder.Connect(movie.get_output_port(), self.link.get_input_port())
        builder.Connect(self.link.GetOutputPort("depth_image"), self.perception.GetInputPort("depth_image"))
        builder.Connect(place.get_output_port(), self.perception.GetInputPort("X_WC"))
        if stamped:
            builder.Connect(self.link.GetOutputPort("age"), self.perception.GetInputPort("image_age"))
        self.late = 0.0 if stamped else PERIOD  # a picture is seen one period after it was taken
        self.diagram = builder.Build()
        self.before = self.diagram.CreateDefaultContext()
        Simulator(self.diagram, self.before).AdvanceTo(FAULT - PERIOD / 4)
        self.seen = self.read(self.before, "seen_object")
        assert self.seen is not None

    def read(self, context, port):
        return self.perception.GetOutputPort(port).Eval(self.perception.GetMyContextFromRoot(context))

    def looks(self, fault, band=(0, 1), last=8):
        """What perception says after each of the pictures from the fault on."""
        context = self.before.Clone()
        self.link.spoil(context, fault, FAULT, band)
        simulator = Simulator(self.diagram, context)
        said = []
        for k in range(last):
            simulator.AdvanceTo(FAULT + (k + 0.75) * PERIOD)
            said.append(self.read(context, "object_pose"))
        return said

    def off(self, observed):
        """By how much a valid pose is off the truth when its picture was taken."""
        pose = pose_at(observed.time - self.late)
        c, s = np.cos(pose[2] - START[2]), np.sin(pose[2] - START[2])
        place = np.array([[c, -s], [s, c]]) @ (self.seen.first_pose[:2] - START[:2]) + pose[:2]
        return observed.pose - [*place, pose[2] - START[2] + self.seen.first_pose[2]]

    def right(self, said):
        return all((np.abs(self.off(observed)) < ENOUGH).all() for observed in said if observed.valid)


@pytest.fixture(scope="module")
def watched():
    return Watched()


def reasons(said):
    return {observed.reason for observed in said if not observed.valid}


def test_without_a_fault_each_picture_has_its_pose_and_the_time_at_which_it_was_taken(watched):
    said = watched.looks(None, last=6)
    assert all(observed.valid for observed in said)
    assert watched.right(said)
    assert np.diff([observed.time for observed in said]) == pytest.approx(PERIOD)
    assert said[0].time == pytest.approx(FAULT - PERIOD)


@pytest.mark.parametrize("stamped", [True, False])
@pytest.mark.parametrize("fault", ["drop", "freeze"])
def test_pictures_that_stop_or_repeat_themselves_are_no_new_poses_and_too_old_after_three(fault, stamped):
    """The object moves on unseen. Without stamps the picture's own noise shows that it is the same one."""
    watched = cached(stamped)
    said = watched.looks(fault)
    assert watched.right(said)
    assert reasons(said) == {"old picture"}
    valid = [observed for observed in said if observed.valid]
    assert 1 < len(valid) <= OLD + 2
    assert len({observed.time for observed in valid}) <= 2  # not recorded as new
    assert not any(observed.valid for observed in said[OLD + 2 :])


@pytest.mark.parametrize(
    ("fault", "band"),
    [
        ("zeros", (0.0, 1.0)),
        ("rubbish", (0.0, 1.0)),
        ("nans", (0.3, 0.55)),
        ("rubbish", (0.3, 0.55)),
        ("nans", (0.45, 0.53)),
        ("rubbish", (0.45, 0.53)),
    ],
)
def test_a_band_without_readings_is_a_corrupt_picture_or_does_no_harm(watched, fault, band):
    """The last band is less than a tenth of the picture, over the object."""
    said = watched.looks(fault, band, last=6)
    assert watched.right(said)
    assert reasons(said[1:]) <= {"corrupt picture"}
    if band != (0.45, 0.53):
        assert not any(observed.valid for observed in said[1:])


@pytest.mark.parametrize("band", [(0.5, 1.0), (0.0, 0.45), (0.48, 0.52)])
def test_torn_pictures_of_a_moving_object_have_no_pose(watched, band):
    """The halves are 7 mm apart. The first has rows of the picture before; those after it have not."""
    said = watched.looks("torn", band, last=4)
    assert watched.right(said)
    assert reasons(said[1:]) == {"torn picture"}
    assert not any(observed.valid for observed in said[1:])


def test_before_the_first_picture_there_is_none(watched):
    assert reasons(watched.looks("empty", last=3)[1:]) == {"no picture"}


def test_after_a_torn_picture_poses_go_on_once_the_object_rests(watched):
    """One torn picture, and again good ones; the object stops a second later."""
    context = watched.before.Clone()
    simulator = Simulator(watched.diagram, context)
    said = []
    for k in range(14):
        watched.link.spoil(context, None if k else "torn", band=(0.4, 0.9))
        simulator.AdvanceTo(FAULT + (k + 0.75) * PERIOD)
        said.append(watched.read(context, "object_pose"))
    stops = round((STOPS - FAULT) / PERIOD)
    assert reasons(said[1 : stops + 1]) == {"torn picture"}
    assert all(observed.valid for observed in said[stops + 3 :])
    assert watched.right(said)


def test_a_camera_without_noise_may_repeat_itself():
    """In a simulation without noise a scene at rest has the same picture again and again."""
    noiseless = Watched(stamped=False, noise=False)
    said = noiseless.looks("freeze", last=6)
    assert all(observed.valid for observed in said)
    times = [observed.time for observed in said]
    assert all(later > earlier for earlier, later in pairwise(times))


@lru_cache(maxsize=2)
def cached(stamped: bool) -> Watched:
    return Watched(stamped=stamped)
