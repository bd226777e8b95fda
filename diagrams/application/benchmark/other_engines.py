"""The same push in other engines.

MuJoCo: a free body with one box per cell, and a finger on a rail with a velocity actuator. Bullet: a body per
cell, held together by fixed joints, as in the paper.
"""

import statistics
import time
from collections.abc import Callable
from importlib.metadata import version
from types import ModuleType

import numpy as np

from slipmap.diagrams.application.benchmark.scene import (
    DEPTH,
    FINGER_RADIUS,
    GRAVITY,
    MU_FINGER,
    SPEED,
    WIDTH,
    Outcome,
    Scene,
)
from slipmap.models.physics.cell_grid import FloatArray

_SUBSTEPS = 5
"""Steps of an engine per step of ours, so its step is 1 ms. With 5 ms, MuJoCo's contacts are unstable and
Bullet's final angle is off by a degree."""

_HALF_HEIGHT = 2e-3  # m; flat, so that the push shifts no load between cells
_OUTLINE_MASS = 0.02  # kg, taken from the cells; in Bullet
_TABLE, _CELL, _OUTLINE, _FINGER = 1, 2, 4, 8  # Bullet's collision groups

# MuJoCo's contacts lift sliding bodies, and each of a box's four corners is a contact. A low impedance
# (solimp) lets the 4n corners share the weight; friction is damped so weakly that it hardly lifts.
_TABLE_CONTACT = 'condim="3" solref="-40 -12" solreffriction="-40 -2" solimp="0.01 0.01 1"'
_FINGER_CONTACT = 'condim="3" solref="-1e4 -200"'


def run_mujoco(scene: Scene, repeats: int) -> Outcome:
    """Simulate the push with the first of the maps.

    Raises:
        ModuleNotFoundError: MuJoCo is not installed.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_string(_mujoco_description(scene))
    steps = _SUBSTEPS * (len(scene.push.tip) - 1)

    def simulate() -> tuple[float, np.ndarray]:
        data = mujoco.MjData(model)
        data.ctrl[0] = data.joint("rail").qvel[0] = SPEED
        start = time.process_time()
        for _ in range(steps):
            mujoco.mj_step(model, data)
        seconds = time.process_time() - start
        x, y, _, cos, _, _, sin = data.joint("free").qpos
        return seconds, np.array([x, y, 2 * np.arctan2(sin, cos)])

    seconds, pose = _median_of_runs(simulate, repeats)
    return Outcome(seconds, pose, f"MuJoCo {version('mujoco')}: one body, one box per cell, step 1 ms")


def run_bullet(scene: Scene, repeats: int) -> Outcome:
    """Simulate the push with the first of the maps.

    Raises:
        ModuleNotFoundError: pybullet is not installed.
    """
    import pybullet

    def simulate() -> tuple[float, np.ndarray]:
        client = pybullet.connect(pybullet.DIRECT)
        try:
            outline = _bullet_scene(pybullet, scene, client)
            start = time.process_time()
            for _ in range(_SUBSTEPS * (len(scene.push.tip) - 1)):
                pybullet.stepSimulation(physicsClientId=client)
            seconds = time.process_time() - start
            position, turn = pybullet.getBasePositionAndOrientation(outline, physicsClientId=client)
        finally:
            pybullet.disconnect(client)
        return seconds, np.array([position[0], position[1], 2 * np.arctan2(turn[2], turn[3])])

    seconds, pose = _median_of_runs(simulate, repeats)
    return Outcome(seconds, pose, f"Bullet {version('pybullet')}: one body per cell, fixed joints, step 1 ms")


def _median_of_runs(run: Callable[[], tuple[float, FloatArray]], repeats: int) -> tuple[float, FloatArray]:
    """Median duration of some runs, s, and the final pose of the last one."""
    runs = [run() for _ in range(repeats)]
    return statistics.median(seconds for seconds, _ in runs), runs[-1][1]


def _mujoco_description(scene: Scene) -> str:
    """The scene in MuJoCo's own format.

    A cell's box has side w/√3: with contacts at its corners, it resists a spin like a square of side w. A
    massless box of the object's outline touches only the finger.
    """
    half = scene.slider.grid.width / np.sqrt(12)
    cells, pairs = [], []
    rows = zip(scene.slider.grid.centers, scene.maps.mass[0], scene.maps.mu[0], strict=True)
    for i, ((x, y), mass, mu) in enumerate(rows):
        cells.append(
            f'<geom name="{i}" type="box" pos="{x} {y} 0" size="{half} {half} {_HALF_HEIGHT}" mass="{mass}"/>'
        )
        pairs.append(f'<pair geom1="table" geom2="{i}" friction="{mu} {mu} 0 0 0" {_TABLE_CONTACT}/>')
    x, y = scene.push.tip[0]
    return f"""
    <mujoco>
      <option timestep="{scene.push.h / _SUBSTEPS}" cone="elliptic" impratio="1000" gravity="0 0 {-GRAVITY}"
        integrator="implicitfast"/>
      <default><geom contype="0" conaffinity="0"/></default>
      <worldbody>
        <geom name="table" type="plane" size="1 1 1"/>
        <body pos="0 0 {_HALF_HEIGHT}">
          <freejoint name="free"/>
          {"".join(cells)}
          <geom name="outline" type="box" size="{WIDTH / 2} {DEPTH / 2} {_HALF_HEIGHT}" mass="0"/>
        </body>
        <body pos="{x} {y} {_HALF_HEIGHT}">
          <joint name="rail" type="slide" axis="0 1 0"/>
          <geom name="finger" type="cylinder" size="{FINGER_RADIUS} 0.02" mass="1"/>
        </body>
      </worldbody>
      <contact>
        {"".join(pairs)}
        <pair geom1="finger" geom2="outline" friction="{MU_FINGER} {MU_FINGER} 0 0 0" {_FINGER_CONTACT}/>
      </contact>
      <actuator><velocity joint="rail" kv="1e6"/></actuator>
    </mujoco>"""


def _bullet_scene(p: ModuleType, scene: Scene, client: int) -> int:
    """Build the scene in a client; returns the body of the outline, to which the cells are joined.

    A cell's box has side w/√3: with contacts at its corners, it resists a spin like a square of side w. The
    outline touches only the finger, the cells only the table. Bullet multiplies friction coefficients.
    """
    where = {"physicsClientId": client}
    p.setGravity(0, 0, -GRAVITY, **where)
    p.setPhysicsEngineParameter(enableConeFriction=1, **where)
    p.setTimeStep(scene.push.h / _SUBSTEPS, **where)
    grid = scene.slider.grid
    mass = scene.maps.mass[0] * (1 - _OUTLINE_MASS / scene.maps.mass[0].sum())

    table = p.createMultiBody(0, _box(p, (1, 1, 0.5), where), basePosition=[0, 0, -0.5], **where)
    _set(p, table, -1, 1.0, _TABLE, _CELL, where)
    shape = _box(p, (WIDTH / 2, DEPTH / 2, _HALF_HEIGHT), where)
    outline = p.createMultiBody(_OUTLINE_MASS, shape, basePosition=[0, 0, _HALF_HEIGHT], **where)
    _set(p, outline, -1, MU_FINGER, _OUTLINE, _FINGER, where)
    half = grid.width / np.sqrt(12)
    shape = _box(p, (half, half, _HALF_HEIGHT), where)
    for (x, y), m, mu in zip(grid.centers, mass, scene.maps.mu[0], strict=True):
        cell = p.createMultiBody(m, shape, basePosition=[x, y, _HALF_HEIGHT], **where)
        _set(p, cell, -1, mu, _CELL, _TABLE, where)
        p.createConstraint(outline, -1, cell, -1, p.JOINT_FIXED, [0, 0, 0], [x, y, 0], [0, 0, 0], **where)

    x, y = scene.push.tip[0]
    shape = p.createCollisionShape(p.GEOM_CYLINDER, radius=FINGER_RADIUS, height=0.04, **where)
    finger = p.createMultiBody(
        0, -1, basePosition=[x, y, _HALF_HEIGHT], linkMasses=[1], linkCollisionShapeIndices=[shape],
        linkVisualShapeIndices=[-1], linkPositions=[[0, 0, 0]], linkOrientations=[[0, 0, 0, 1]],
        linkInertialFramePositions=[[0, 0, 0]], linkInertialFrameOrientations=[[0, 0, 0, 1]],
        linkParentIndices=[0], linkJointTypes=[p.JOINT_PRISMATIC], linkJointAxis=[[0, 1, 0]], **where,
    )  # fmt: skip
    _set(p, finger, 0, 1.0, _FINGER, _OUTLINE, where)
    p.resetJointState(finger, 0, 0, SPEED, **where)
    p.setJointMotorControl2(finger, 0, p.VELOCITY_CONTROL, targetVelocity=SPEED, force=1e5, **where)
    return outline


def _box(p: ModuleType, half_sides: tuple[float, float, float], where: dict[str, int]) -> int:
    return p.createCollisionShape(p.GEOM_BOX, halfExtents=half_sides, **where)


def _set(
    p: ModuleType, body: int, link: int, friction: float, group: int, mask: int, where: dict[str, int]
) -> None:
    """Set the friction of a link, no air damping, and what it can touch."""
    p.changeDynamics(body, link, lateralFriction=friction, **where)
    if link == -1:
        # Set in the same call, or on the finger's link, damping would reset the friction.
        p.changeDynamics(body, link, linearDamping=0, angularDamping=0, **where)
    p.setCollisionFilterGroupMask(body, link, group, mask, **where)
