"""Bodies in Bullet for worlds with a finger: an object whose feet are links, and the finger itself."""

from __future__ import annotations

import os
import weakref
from collections.abc import Sequence
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slipmap.models.physics.cell_grid import FloatArray

FOOT = 2e-3  # m, radius
SINK = 2e-4  # m; penetration of every foot under the weight of its cell
CLEARANCE = 4e-4  # m, between the table and the sides that the finger touches
MARGIN = 1e-3  # m; by which Bullet inflates convex hulls
TABLE, FEET, SIDES, FINGER = 1, 2, 4, 8  # collision groups
LEVEL = (0.0, 0.0, 0.0, 1.0)  # the identity quaternion
_LINK_MASS = 1e-6  # kg
_FINGER_MASS = 1e-2  # kg; so light that its drive force is the contact force
_MOTOR = [1e4, 1e4]  # N; nothing in the scene can stop it


def import_bullet() -> ModuleType:
    """The module pybullet, without the line that it writes to standard error when it is first imported.

    Raises:
        ModuleNotFoundError: it is not installed.
    """
    kept = os.dup(2)
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        import pybullet
    finally:
        os.dup2(kept, 2)
        os.close(kept)
    return pybullet


class BulletClient:
    """A simulation of pybullet, with the functions of the module for itself alone, and the constants.

    Unlike the client in `pybullet_utils`, it writes no line to standard output.

    Raises:
        ModuleNotFoundError: pybullet is not installed.
    """

    def __init__(self) -> None:
        self._module = import_bullet()
        self._client = self._module.connect(self._module.DIRECT)
        weakref.finalize(self, self._module.disconnect, self._client)

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._module, name)
        return partial(found, physicsClientId=self._client) if callable(found) else found


class BulletScene:
    """A simulation of an object on feet and a finger.

    Args:
        gravity: (3,) m/s².
        dt: time step, s.
        cone: whether friction is limited by a cone; otherwise along two axes independently.
        iterations: of the solver.

    Raises:
        ModuleNotFoundError: pybullet is not installed.
    """

    def __init__(self, gravity: ArrayLike, dt: float, cone: bool, iterations: int) -> None:
        self.p = BulletClient()
        self.p.setGravity(*np.asarray(gravity))
        self.p.setTimeStep(dt)
        self.p.setPhysicsEngineParameter(enableConeFriction=int(cone), numSolverIterations=iterations)

    def prism(self, ring: FloatArray, top: float) -> int:
        """A shape with a convex base (k, 2) just above the table and a top at a height (m)."""
        corners = [[*corner, z] for z in (CLEARANCE + MARGIN, top) for corner in ring]
        return int(self.p.createCollisionShape(self.p.GEOM_MESH, vertices=corners))

    def add_object(
        self,
        inertia: tuple[float, FloatArray],
        feet: Sequence[tuple[int, float, float]],
        sides: Sequence[int],
        mu_finger: float,
        places: Sequence[Sequence[float]],
        turn: Sequence[float] = LEVEL,
        stops: int = FINGER,
    ) -> int:
        """A body with all the mass, to which almost massless links are fixed: feet, and sides for the finger.

        The stiffness of each foot is proportional to its load, so that it carries that load.

        Args:
            inertia: mass (kg) and (3,) principal moments (kg m²) of the body.
            feet: shape of each, the mass (kg) that it carries, and its friction coefficient.
            sides: their shapes.
            mu_finger: friction coefficient of the sides.
            places: of the frames of feet and sides in the body's principal one, m.
            turn: quaternion of all these frames in it, real part last.
            stops: collision groups of what the sides touch.
        """
        p, (mass, moments) = self.p, inertia
        shapes = [shape for shape, _, _ in feet] + list(sides)
        count, here = len(shapes), [0.0, 0.0, 0.0]
        body = p.createMultiBody(
            mass, -1, -1, here, LEVEL, linkMasses=[_LINK_MASS] * count, linkCollisionShapeIndices=shapes,
            linkVisualShapeIndices=[-1] * count, linkPositions=places, linkOrientations=[turn] * count,
            linkInertialFramePositions=[here] * count, linkInertialFrameOrientations=[LEVEL] * count,
            linkParentIndices=[0] * count, linkJointTypes=[p.JOINT_FIXED] * count,
            linkJointAxis=[[0, 0, 1]] * count
        )  # fmt: skip
        p.changeDynamics(body, -1, linearDamping=0, angularDamping=0, localInertiaDiagonal=moments.tolist())
        for link, (_, load, mu) in enumerate(feet):
            stiffness = load * 9.81 / SINK
            damping = 2 * np.sqrt(stiffness * load)
            p.changeDynamics(
                body, link, lateralFriction=mu, contactStiffness=stiffness, contactDamping=damping
            )
            p.setCollisionFilterGroupMask(body, link, FEET, TABLE)
        for link in range(len(feet), count):
            # The sides hang just above the table: only real contacts count.
            p.changeDynamics(body, link, lateralFriction=mu_finger, contactProcessingThreshold=0.0)
            p.setCollisionFilterGroupMask(body, link, SIDES, stops)
        return int(body)

    def add_finger(self, shape: int, height: float) -> None:
        """Add a finger with a shape and its frame at a height (m), on rails along x and y."""
        p, here = self.p, [[0.0, 0.0, 0.0]] * 2
        finger = p.createMultiBody(
            0, -1, basePosition=[0, 0, height], linkMasses=[_FINGER_MASS] * 2,
            linkCollisionShapeIndices=[-1, shape], linkVisualShapeIndices=[-1, -1], linkPositions=here,
            linkOrientations=[LEVEL] * 2, linkInertialFramePositions=here,
            linkInertialFrameOrientations=[LEVEL] * 2, linkParentIndices=[0, 1],
            linkJointTypes=[p.JOINT_PRISMATIC] * 2, linkJointAxis=np.eye(3)[:2].tolist()
        )  # fmt: skip
        p.changeDynamics(finger, 1, lateralFriction=1.0)
        for link in (-1, 0, 1):
            p.setCollisionFilterGroupMask(finger, link, FINGER if link == 1 else 0, SIDES)
        self._finger = int(finger)

    def put_finger(self, place: FloatArray, speed: FloatArray | None = None) -> None:
        """Place the finger at (2,) m, at rest or with a velocity (2,) m/s."""
        for joint in (0, 1):
            moving = 0.0 if speed is None else float(speed[joint])
            self.p.resetJointState(self._finger, joint, float(place[joint]), moving)

    def finger_states(self) -> list[Sequence[Any]]:
        """What pybullet tells about the finger's two joints; the force of their motors is that of contact."""
        return list(self.p.getJointStates(self._finger, [0, 1]))

    def drive(self, speed: FloatArray) -> None:
        """Let its motors drive the finger at a velocity (2,) m/s in the next time step."""
        self.p.setJointMotorControlArray(
            self._finger, [0, 1], self.p.VELOCITY_CONTROL, targetVelocities=speed.tolist(), forces=_MOTOR
        )  # fmt: skip
