"""The arm: an iiwa 14 with a gripper, mounted beside the table, and the drivers that control it."""

import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake import manipulation
from pydrake.geometry import Capsule, Cylinder, SceneGraph
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.parsing import LoadModelDirectivesFromString, Parser, ProcessModelDirectives
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, FrameIndex, ModelInstanceIndex
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import SharedPointerSystem

from slipmap.diagrams.systems.python_system import PythonSystem
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import (
    ARM_JOINTS,
    FINGER_RADIUS,
    FLANGE_HEIGHT,
    FOLDER,
    GRIPPER_MODEL,
    IIWA_MODEL,
    PIN_RADIUS,
)

ARM_MODELS = {
    "primitives": f"package://slipmap_robots/{IIWA_MODEL.name}",
    "drake_models": "package://drake_models/iiwa_description/urdf/iiwa14_primitive_collision.urdf",
}
"""The arm model of each set. The gripper is slipmap's own in all of them, because its finger pushes."""

HOME = np.array([0.69, -1.06, -1.07, -1.38, 0.0, 1.41, -0.93])
"""(7,) joint angles at which the arm is raised beside its stand, rad. With `default_arm_base`, a camera 1.1 m
above the table's centre sees the whole table within 0.49 m past the arm, and no part of the arm is that
high."""

STIFFNESS = np.full(7, 8000.0)  # (7,) gains of the simulated joint control, 1/s²
STAND_RADIUS = 0.07  # radius of the column that carries the arm, m

IIWA_OUTPUTS = ("position_commanded", "position_measured", "velocity_estimated", "torque_external")
"""Outputs of the arm's joints; the ports of a cell are named `iiwa.` plus one of these."""

_FLOOR = -0.75  # m, lower end of the stand
_SQUEEZE = 0.01  # m beyond closed in the command, so that the gripper closes with its full force

_DIRECTIVES = """
directives:
- add_model: {{name: iiwa, file: "{arm}"}}
- add_model: {{name: gripper, file: "file://{gripper}"}}
- add_weld:
    parent: iiwa::iiwa_link_7
    child: gripper::mount
    X_PC: {{translation: [0, 0, {flange}]}}
- add_collision_filter_group:
    name: arm
    members: [{members}]
    ignored_collision_filter_groups: [arm]
"""


@dataclass(frozen=True, eq=False)
class Arm:
    """The arm in a plant."""

    iiwa: ModelInstanceIndex  # model instance of the arm itself, 7 positions
    gripper: ModelInstanceIndex  # model instance of its hand, 2 positions
    # frame T at the centre of the finger's end, z along the finger and out of the hand
    tip: FrameIndex
    finger_radius: float  # of the round finger formed by the closed gripper, m
    X_WB: RigidTransform  # pose of the arm's base in the world
    models: str  # its set of models


def default_arm_base() -> RigidTransform:
    """Pose X_WB of the base: horizontal, on a stand beyond the table's edge at x = -0.5 m, 0.6 m above it.

    The shoulder is then above the table, at x = -0.34 m.
    """
    return RigidTransform(RollPitchYaw(0.0, np.deg2rad(90.0), 0.0), np.array([-0.70, 0.0, 0.6]))


def add_arm(plant: MultibodyPlant, models: str = "primitives", finger_radius: float = FINGER_RADIUS) -> Arm:
    """Add the arm to a plant that is not yet finalized, with its home posture as default.

    Parts of arm and gripper do not collide with each other, but with everything else.

    Args:
        plant: discrete, with a contact approximation other than `tamsi`, which cannot couple the fingers.
        models: a key of `ARM_MODELS`. Drake downloads the meshes of `drake_models` on first use.
        finger_radius: of the closed gripper's finger, m.

    Raises:
        ValueError: an unknown set of models.
        RuntimeError: the models are not available, or the plant cannot couple the fingers.
    """
    X_WB = default_arm_base()
    iiwa, gripper = _parse(plant, X_WB, models, finger_radius)
    # A single drive moves both fingers; uncoupled, a sideways push would shift both.
    plant.AddCouplerConstraint(
        plant.GetJointByName("left_finger_joint", gripper),
        plant.GetJointByName("right_finger_joint", gripper),
        -1.0,
    )
    for name, angle in zip(ARM_JOINTS, HOME, strict=True):
        plant.GetJointByName(name, iiwa).set_default_positions([angle])
    if plant.geometry_source_is_registered():
        _add_stand(plant, X_WB)
    return Arm(iiwa, gripper, plant.GetFrameByName("tip", gripper).index(), finger_radius, X_WB, models)


def lone_arm(
    models: str = "primitives", finger_radius: float = FINGER_RADIUS
) -> tuple[MultibodyPlant, SceneGraph, Arm]:
    """The arm alone in a finalized plant with a scene graph, to inspect its shapes; see `add_arm`."""
    plant, scene_graph = MultibodyPlant(1e-3), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    arm = add_arm(plant, models=models, finger_radius=finger_radius)
    plant.Finalize()
    return plant, scene_graph, arm


def arm_model(
    X_WB: RigidTransform | None = None, models: str = "primitives", gravity: FloatArray | None = None
) -> MultibodyPlant:
    """The arm as its controller models it: a finalized plant with 7 positions and the closed gripper as load.

    Like the plant of `add_arm`, it has a frame `tip`. Its discrete time step has no meaning. Gravity (3,) is
    that of the world, m/s²; Drake's default if None.

    Raises:
        ValueError, RuntimeError: as for `add_arm`.
    """
    complete = MultibodyPlant(1e-3)
    _, gripper = _parse(complete, RigidTransform(), models)
    complete.Finalize()
    context = complete.CreateDefaultContext()
    hand = complete.GetFrameByName("hand", gripper)
    load = complete.CalcSpatialInertia(context, hand, complete.GetBodyIndices(gripper))
    X_HT = complete.GetFrameByName("tip", gripper).CalcPose(context, hand)
    X_MH = hand.CalcPose(context, complete.GetFrameByName("mount", gripper))

    plant = MultibodyPlant(1e-3)
    if gravity is not None:
        plant.mutable_gravity_field().set_gravity_vector(gravity)
    (iiwa,) = _parser(plant).AddModelsFromUrl(_arm_url(models))
    plant.WeldFrames(
        plant.world_frame(),
        plant.GetFrameByName("iiwa_link_0", iiwa),
        default_arm_base() if X_WB is None else X_WB,
    )
    body = plant.AddRigidBody("gripper", iiwa, load)
    flange = RigidTransform([0.0, 0.0, FLANGE_HEIGHT])
    plant.WeldFrames(plant.GetFrameByName("iiwa_link_7", iiwa), body.body_frame(), flange @ X_MH)
    plant.AddFrame(FixedOffsetFrame("tip", body.body_frame(), X_HT))
    plant.Finalize()
    return plant


def add_arm_drivers(builder: DiagramBuilder, plant: MultibodyPlant, arm: Arm) -> None:
    """Add drivers of the arm's joints and the gripper's opening to a finalized plant, and export their ports.

    The arm's driver is Drake's `SimIiwaDriver` with stiffer joints than the default, at which 15 N deflect
    the finger by more than a millimetre; the real controller removes such an error by integral action.

    `iiwa.*` are (7,) in rad, rad/s, N m; torque_external is that of the contact forces on arm and gripper,
    smoothed over 10 ms. `gripper.position` (1,) is the opening from 0 to `GRIPPER_OPENING`, m; at 0 the
    gripper closes with the full force that `gripper.force_limit` allows. `gripper.force_limit` (1,) is the
    largest force of a finger, N, 40 if not connected; `gripper.state_measured` (2,) is the opening and its
    rate, m and m/s.
    """
    gravity = plant.gravity_field().gravity_vector()
    model = SharedPointerSystem.AddToBuilder(builder, arm_model(arm.X_WB, arm.models, gravity))
    config = manipulation.IiwaDriver(control_mode="position_only", desired_kp_gains=STIFFNESS)
    iiwa = manipulation.SimIiwaDriver.AddToBuilder(builder, plant, arm.iiwa, config, model)
    builder.ExportInput(iiwa.GetInputPort("position"), "iiwa.position")
    for name in IIWA_OUTPUTS:
        builder.ExportOutput(iiwa.GetOutputPort(name), f"iiwa.{name}")

    # Commands every 0.05 s; gains in N/m and N s/m.
    controller = manipulation.SchunkWsgPositionController(0.05, 8000.0, 100.0)
    hand = builder.AddNamedSystem("gripper_control", controller)
    squeeze = builder.AddNamedSystem("gripper_squeeze", _Squeeze())
    opening = builder.AddNamedSystem("gripper_state", manipulation.MakeMultibodyStateToWsgStateSystem())
    state = plant.get_state_output_port(arm.gripper)
    builder.Connect(state, hand.GetInputPort("state"))
    builder.Connect(state, opening.get_input_port())
    builder.Connect(hand.GetOutputPort("generalized_force"), plant.get_actuation_input_port(arm.gripper))
    builder.Connect(squeeze.get_output_port(), hand.GetInputPort("desired_position"))
    builder.ExportInput(squeeze.get_input_port(), "gripper.position")
    builder.ExportInput(hand.GetInputPort("force_limit"), "gripper.force_limit")
    builder.ExportOutput(opening.get_output_port(), "gripper.state_measured")


class _Squeeze(PythonSystem):
    """Makes a gripper close with its full force.

    With a command of exactly 0, its control would yield by 3.5 mm when a push loads a pin.
    """

    def __init__(self) -> None:
        super().__init__()
        opening = self.DeclareVectorInputPort("opening", 1)
        self.declare_vector_output("desired", 1, self._desired, {opening.ticket()})

    def _desired(self, context: Context) -> list[float]:
        (opening,) = self.get_input_port().Eval(context)
        return [opening if opening > 0.0 else -_SQUEEZE]


def _arm_url(models: str) -> str:
    if models not in ARM_MODELS:
        raise ValueError(f"arm: unknown set of models {models!r}; choose one of {', '.join(ARM_MODELS)}")
    return ARM_MODELS[models]


def _parser(plant: MultibodyPlant) -> Parser:
    parser = Parser(plant)
    parser.package_map().Add("slipmap_robots", FOLDER)
    return parser


@contextmanager
def _gripper_with(finger_radius: float) -> Iterator[Path]:
    """The gripper's model file, or one with another radius of the finger's collar and of the slightly thinner
    rest."""
    if finger_radius == FINGER_RADIUS:
        yield GRIPPER_MODEL
        return
    text = GRIPPER_MODEL.read_text(encoding="utf-8")
    radii = {FINGER_RADIUS: finger_radius, PIN_RADIUS: finger_radius - (FINGER_RADIUS - PIN_RADIUS)}
    given = "|".join(f"{radius:g}" for radius in radii)
    text = re.sub(f'radius="({given})"', lambda found: f'radius="{radii[float(found[1])]:.6g}"', text)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / GRIPPER_MODEL.name
        file.write_text(text, encoding="utf-8")
        yield file


def _parse(
    plant: MultibodyPlant, X_WB: RigidTransform, models: str, finger_radius: float = FINGER_RADIUS
) -> tuple[ModelInstanceIndex, ModelInstanceIndex]:
    members = [f"iiwa::iiwa_link_{i}" for i in range(8)]
    members += [f"gripper::{part}" for part in ("hand", "left_finger", "right_finger")]
    arm = _arm_url(models)
    try:
        with _gripper_with(finger_radius) as gripper_file:
            directives = _DIRECTIVES.format(
                arm=arm, gripper=gripper_file, flange=FLANGE_HEIGHT, members=", ".join(members)
            )
            ProcessModelDirectives(LoadModelDirectivesFromString(directives), _parser(plant))
    except RuntimeError as error:
        if models == "primitives":
            raise
        raise RuntimeError(
            f"arm: Drake could not load its models; use `primitives`, or connect to the internet: {error}"
        ) from error
    iiwa, gripper = (plant.GetModelInstanceByName(name) for name in ("iiwa", "gripper"))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("iiwa_link_0", iiwa), X_WB)
    return iiwa, gripper


def stand_head(X_WB: RigidTransform) -> FloatArray:
    """(3,) upper end of the stand's column in the world, m, behind a base at X_WB."""
    return np.asarray(X_WB @ np.array([0.0, 0.0, -0.14]))


def _add_stand(plant: MultibodyPlant, X_WB: RigidTransform) -> None:
    """Add a column from the floor to the back of the base, without collision geometry."""
    back = X_WB @ np.array([0.0, 0.0, -0.02])
    head = stand_head(X_WB)
    foot = np.array([head[0], head[1], _FLOOR])
    dark, grey = np.array([0.16, 0.17, 0.19, 1.0]), np.array([0.55, 0.57, 0.6, 1.0])
    base, up = X_WB.rotation(), RotationMatrix()
    shapes = (
        ("plate", Cylinder(0.15, 0.02), base, X_WB @ np.array([0.0, 0.0, -0.01]), dark),
        ("neck", Capsule(STAND_RADIUS, 0.12), base, (back + head) / 2, grey),
        ("column", Cylinder(STAND_RADIUS, head[2] - _FLOOR), up, (head + foot) / 2, grey),
        ("foot", Cylinder(0.22, 0.03), up, foot + np.array([0.0, 0.0, 0.015]), dark),
    )
    for name, shape, turn, middle, colour in shapes:
        X_WG = RigidTransform(turn, middle)
        plant.RegisterVisualGeometry(plant.world_body(), X_WG, shape, f"arm_stand_{name}", colour)
