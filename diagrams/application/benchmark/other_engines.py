"""The same push in other engines, and in plain numpy.

MuJoCo: a free body with one box per cell, and a finger on a rail with a velocity actuator. Bullet: a body per
cell, held together by fixed joints, as in the paper. Plain numpy: the convex step, written from its formula,
as a check of the compiled step and of its speed; the two share only the definition of the model.
"""

import statistics
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import version

import numpy as np
import shapely
from scipy.optimize import brentq

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
from slipmap.diagrams.application.bullet_bodies import BulletClient
from slipmap.models.geometry import turn
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import Maps, Push, Slider

_Derivatives = tuple[FloatArray, FloatArray]
_Function = Callable[[FloatArray], _Derivatives]

_SUBSTEPS = 5
"""Steps of an engine per step of ours, so its step is 1 ms. With 5 ms, MuJoCo's contacts are unstable and
Bullet's final angle is off by a degree."""

_HALF_HEIGHT = 2e-3  # m; flat, so that the push shifts no load between cells
_TOLERANCE, _MAX_ITERATIONS = 1e-9, 100  # m/s, of a Newton step of plain numpy; convergence is quadratic
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

    def simulate() -> tuple[float, np.ndarray]:
        bullet = BulletClient()
        outline, step = _bullet_scene(bullet, scene), bullet.stepSimulation
        start = time.process_time()
        for _ in range(_SUBSTEPS * (len(scene.push.tip) - 1)):
            step()
        seconds = time.process_time() - start
        position, turn = bullet.getBasePositionAndOrientation(outline)
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


def _bullet_scene(p: BulletClient, scene: Scene) -> int:
    """Build the scene; returns the body of the outline, to which the cells are joined.

    A cell's box has side w/√3: with contacts at its corners, it resists a spin like a square of side w. The
    outline touches only the finger, the cells only the table. Bullet multiplies friction coefficients.
    """
    p.setGravity(0, 0, -GRAVITY)
    p.setPhysicsEngineParameter(enableConeFriction=1)
    p.setTimeStep(scene.push.h / _SUBSTEPS)
    grid = scene.slider.grid
    mass = scene.maps.mass[0] * (1 - _OUTLINE_MASS / scene.maps.mass[0].sum())

    shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=(1, 1, 0.5))
    table = p.createMultiBody(0, shape, basePosition=[0, 0, -0.5])
    _set(p, table, -1, 1.0, _TABLE, _CELL)
    shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=(WIDTH / 2, DEPTH / 2, _HALF_HEIGHT))
    outline = p.createMultiBody(_OUTLINE_MASS, shape, basePosition=[0, 0, _HALF_HEIGHT])
    _set(p, outline, -1, MU_FINGER, _OUTLINE, _FINGER)
    half = grid.width / np.sqrt(12)
    shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=(half, half, _HALF_HEIGHT))
    for (x, y), m, mu in zip(grid.centers, mass, scene.maps.mu[0], strict=True):
        cell = p.createMultiBody(m, shape, basePosition=[x, y, _HALF_HEIGHT])
        _set(p, cell, -1, mu, _CELL, _TABLE)
        p.createConstraint(outline, -1, cell, -1, p.JOINT_FIXED, [0, 0, 0], [x, y, 0], [0, 0, 0])

    x, y = scene.push.tip[0]
    shape = p.createCollisionShape(p.GEOM_CYLINDER, radius=FINGER_RADIUS, height=0.04)
    finger = p.createMultiBody(
        0, -1, basePosition=[x, y, _HALF_HEIGHT], linkMasses=[1], linkCollisionShapeIndices=[shape],
        linkVisualShapeIndices=[-1], linkPositions=[[0, 0, 0]], linkOrientations=[[0, 0, 0, 1]],
        linkInertialFramePositions=[[0, 0, 0]], linkInertialFrameOrientations=[[0, 0, 0, 1]],
        linkParentIndices=[0], linkJointTypes=[p.JOINT_PRISMATIC], linkJointAxis=[[0, 1, 0]]
    )  # fmt: skip
    _set(p, finger, 0, 1.0, _FINGER, _OUTLINE)
    p.resetJointState(finger, 0, 0, SPEED)
    p.setJointMotorControl2(finger, 0, p.VELOCITY_CONTROL, targetVelocity=SPEED, force=1e5)
    return outline


def _set(p: BulletClient, body: int, link: int, friction: float, group: int, mask: int) -> None:
    """Set the friction of a link, no air damping, and what it can touch."""
    p.changeDynamics(body, link, lateralFriction=friction)
    if link == -1:
        # Set in the same call, or on the finger's link, damping would reset the friction.
        p.changeDynamics(body, link, linearDamping=0, angularDamping=0)
    p.setCollisionFilterGroupMask(body, link, group, mask)


def plain_rollout(slider: Slider, maps: Maps, push: Push) -> FloatArray:
    """(N + 1, 3) poses under the first of the maps, including the start.

    Raises:
        ValueError: the finger's centre enters the object.
        ArithmeticError: a step was not solved.
    """
    n, h = len(slider.grid), push.h
    mass, load = maps.mass[0], maps.mass[0] * maps.mu[0] * slider.gravity
    r, w = slider.grid.centers, slider.grid.width
    J = np.zeros((n, 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1.0
    J[:, 0, 2], J[:, 1, 2] = -r[:, 1], r[:, 0]
    M = np.einsum("i,ixa,ixb->ab", mass, J, J) + np.diag([0, 0, mass.sum() * w**2 / 6])
    K = np.einsum("ixa,ixb->iab", J, J) + np.diag([0, 0, w**2 / 12])
    smoothing, total = slider.smoothing, load.sum()
    # Springs 1/R along the normal and the tangent.
    springs = np.array([h * h * total / smoothing.penetration, h * total / smoothing.stick_speed])

    q, v = push.start_pose.copy(), push.start_twist.copy()
    poses = [q]
    for tip0, tip1 in zip(push.tip[:-1], push.tip[1:], strict=True):
        contact = _contact(slider, _moved(q, v, h / 2), tip0, tip1, v, h)
        free = _free_momentum(M, v, h)
        smooth = partial(_smooth_derivatives, M, free, K, h * load, smoothing.slip_speed)
        touch = partial(_contact_derivatives, *contact, springs, maps.mu_finger[0]) if contact else None
        v = _minimum(partial(_derivatives, smooth, touch), v)
        q = _moved(q, v, h)
        poses.append(q)
    return np.array(poses)


def _derivatives(smooth: _Function, touch: _Function | None, u: FloatArray) -> _Derivatives:
    """Gradient and Hessian of the whole function at the twist u."""
    gradient, hessian = smooth(u)
    if touch is None:
        return gradient, hessian
    slope, curvature = touch(u)
    return gradient + slope, hessian + curvature


def _smooth_derivatives(
    M: FloatArray, free: FloatArray, K: FloatArray, impulse: FloatArray, eps: float, u: FloatArray
) -> _Derivatives:
    """Gradient and Hessian of inertia, with momentum `free` of v*, and friction, with h f_i in `impulse`."""
    Ku = K @ u
    phi = np.sqrt(Ku @ u + eps**2)
    a = impulse / phi
    return M @ u - free + a @ Ku, M + np.tensordot(a, K, 1) - (Ku.T * (a / phi**2)) @ Ku


def _moved(q: FloatArray, v: FloatArray, duration: float) -> FloatArray:
    """Pose after a motion with constant twist in the object frame, the exponential of a planar screw."""
    angle = duration * v[2]
    straight = np.sinc(angle / (2 * np.pi))  # numpy's sinc has a π in it
    way = duration * straight * turn(q[2] + angle / 2) @ v[:2]
    return np.array([*(q[:2] + way), q[2] + angle])


def _free_momentum(M: FloatArray, v: FloatArray, h: float) -> FloatArray:
    """M v* without forces: in the rotated frame, the centre of mass keeps its velocity and the spin."""
    centre = np.array([M[1, 2], -M[0, 2]]) / M[0, 0]
    lever = np.array([-centre[1], centre[0]])
    velocity = turn(-h * v[2]) @ (v[:2] + v[2] * lever)
    return M @ np.array([*(velocity - v[2] * lever), v[2]])


def _contact(
    slider: Slider, q: FloatArray, tip0: FloatArray, tip1: FloatArray, v: FloatArray, h: float
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Contact rows C (2, 3), offsets b (2,) and factors (2,): C u - b times the factors are the speeds of the
    normal and the tangential spring.

    None where the finger is out of reach.
    """
    to_object = turn(-q[2])
    tip = to_object @ ((tip0 + tip1) / 2 - q[:2])
    finger = to_object @ ((tip1 - tip0) / h)
    ring = slider.grid.polygon.exterior
    point = np.array(ring.interpolate(ring.project(shapely.Point(tip))).coords[0])
    away = tip - point
    normal = away / np.linalg.norm(away)
    if slider.grid.polygon.contains(shapely.Point(tip)):
        raise ValueError("the finger's centre is inside the object")
    gap = np.linalg.norm(away) - slider.finger_radius
    if gap > 2e-3 + 4 * h * (np.linalg.norm(finger) + np.linalg.norm(v[:2])):
        return None
    tangent = np.array([-normal[1], normal[0]])
    lever = np.array([-point[1], point[0]])
    C = np.array([[*normal, normal @ lever], [*-tangent, -tangent @ lever]])
    # The gap is known at the middle of the step; finger and object have closed or opened it until then.
    gap += 0.5 * h * (C[0] @ v - normal @ finger)
    depth = max(-gap, 0.0)
    share = depth**2 / (depth**2 + (slider.smoothing.penetration / 2) ** 2)
    stiffening = 1.0 + share * slider.smoothing.relaxation / h
    b = np.array([normal @ finger + gap / (h * stiffening), -tangent @ finger])
    return C, b, np.array([stiffening, 1.0])


def _contact_derivatives(
    C: FloatArray, b: FloatArray, factors: FloatArray, springs: FloatArray, mu: float, u: FloatArray
) -> _Derivatives:
    """Gradient and Hessian of ½ γᵀ R γ, where γ is the projection of the springs' impulses y on the cone."""
    springs = factors * springs
    y_n, y_t = springs * (C @ u - b)
    ratio = springs[0] / springs[1]
    if abs(y_t) <= mu * y_n:
        projection = np.eye(2)
    elif y_n + mu * ratio * abs(y_t) <= 0:
        projection = np.zeros((2, 2))
    else:
        # Onto the cone's surface: along the ray (1, ±mu), in the metric R.
        ray = np.array([1.0, np.copysign(mu, y_t)])
        projection = np.outer(ray, ray / springs) / (ray @ (ray / springs))
    gamma = projection @ (y_n, y_t)
    return C.T @ gamma, C.T @ (projection * springs) @ C


def _minimum(function: _Function, v: FloatArray) -> FloatArray:
    """Minimum by Newton's method, with an exact line search wherever the full step overshoots.

    Raises:
        ArithmeticError: no convergence.
    """
    for _ in range(_MAX_ITERATIONS):
        gradient, hessian = function(v)
        d = np.asarray(np.linalg.solve(hessian, -gradient), dtype=np.float64)
        if np.abs(d).max() < _TOLERANCE:
            return v + d
        along = partial(_slope, function, v, d)
        overshoots = along(1.0) > -0.5 * gradient @ d
        v = v + d * (brentq(along, 0.0, 1.0, rtol=1e-3) if overshoots else 1.0)
    raise ArithmeticError("plain numpy: a step was not solved")


def _slope(function: _Function, v: FloatArray, d: FloatArray, t: float) -> float:
    """Derivative along d at v + t d."""
    return float(function(v + t * d)[0] @ d)
