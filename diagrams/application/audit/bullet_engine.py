"""Bullet under audit: a rigid body with one foot per cell."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import pybullet as p

from slipmap.diagrams.application.audit.engines import AWAY, EngineScene
from slipmap.diagrams.application.bullet_bodies import body_of_links, finger_on_rails, set_foot
from slipmap.models.physics.cell_grid import FloatArray

_FOOT = 2e-3  # m, radius
_HEIGHT = 2e-3  # m, of the object's centre of mass and of the finger's centre above the table
_SINK = 2e-4  # m; penetration of every foot under the weight of its cell
_MARGIN = 1e-3  # m; by which Bullet inflates convex hulls
_CLEARANCE = 4e-4  # m, between the table and the sides that the finger touches
_SIDE = 0.02  # m, height of the sides
_MOTOR = [1e4, 1e4]  # N; nothing in the scene can stop it
_TABLE, _FEET, _SIDES, _FINGER = 1, 2, 4, 8  # collision groups


class BulletEngine:
    """Bullet's multibody solver.

    The stiffness of each foot is proportional to the weight of its cell, so that it carries that weight.
    """

    dt: ClassVar[float] = 2e-3
    cone: ClassVar[bool] = True  # friction as a cone; otherwise along two axes independently
    iterations: ClassVar[int] = 50

    def __init__(self, scene: EngineScene, gravity: FloatArray) -> None:
        self._where = {"physicsClientId": p.connect(p.DIRECT)}
        p.setGravity(*gravity, **self._where)
        p.setTimeStep(self.dt, **self._where)
        p.setPhysicsEngineParameter(
            enableConeFriction=int(self.cone), numSolverIterations=self.iterations, **self._where
        )
        plane = p.createMultiBody(0, p.createCollisionShape(p.GEOM_PLANE, **self._where), **self._where)
        p.changeDynamics(plane, -1, lateralFriction=1.0, **self._where)
        p.setCollisionFilterGroupMask(plane, -1, _TABLE, _FEET, **self._where)
        self._center = np.array([*scene.center_of_mass, _HEIGHT])
        self._object = self._add_object(scene)
        self._finger = self._add_finger(scene)

    def __del__(self) -> None:
        p.disconnect(**self._where)

    def reset(self, pose: FloatArray, velocity: FloatArray, tip: FloatArray) -> None:
        """See `Engine`."""
        turn = p.getQuaternionFromEuler([0, 0, float(pose[2])])
        place, turn = p.multiplyTransforms([*pose[:2], -_SINK], turn, self._center.tolist(), [0, 0, 0, 1])
        p.resetBasePositionAndOrientation(self._object, place, turn, **self._where)
        vx, vy, omega = velocity
        x, y = np.array(place)[:2] - pose[:2]
        p.resetBaseVelocity(self._object, [vx - omega * y, vy + omega * x, 0], [0, 0, omega], **self._where)
        self._move_finger(tip)

    def step(
        self, tip: FloatArray, tip_velocity: FloatArray, next_tip: FloatArray, next_velocity: FloatArray
    ) -> FloatArray:
        """See `Engine`."""
        speed = (next_tip - tip) / self.dt
        self._move_finger(tip, speed)
        p.setJointMotorControlArray(
            self._finger, [0, 1], p.VELOCITY_CONTROL, targetVelocities=speed.tolist(), forces=_MOTOR,
            **self._where,
        )  # fmt: skip
        p.stepSimulation(**self._where)
        # The finger is so light that its drive force is the contact force.
        return np.array([state[3] for state in p.getJointStates(self._finger, [0, 1], **self._where)])

    def pose(self) -> FloatArray:
        """See `Engine`."""
        place, turn = p.getBasePositionAndOrientation(self._object, **self._where)
        place, turn = p.multiplyTransforms(place, turn, (-self._center).tolist(), [0, 0, 0, 1])
        return np.array([*place[:2], 2 * np.arctan2(turn[2], turn[3])])

    def _move_finger(self, place: FloatArray, speed: FloatArray = AWAY * 0) -> None:
        for joint in (0, 1):
            p.resetJointState(self._finger, joint, float(place[joint]), float(speed[joint]), **self._where)

    def _add_object(self, scene: EngineScene) -> int:
        """A body with all the mass; feet, and prisms that the finger touches, are massless links."""
        where, centers = self._where, scene.grid.centers
        shapes = [p.createCollisionShape(p.GEOM_SPHERE, radius=_FOOT, **where) for _ in centers]
        for piece in scene.pieces:
            middle = piece.mean(axis=0)
            inward = np.sign(middle - piece) * _MARGIN  # of corners of rectangles
            ends = (_CLEARANCE + _MARGIN, _SIDE)
            corners = [[*corner, z] for z in ends for corner in piece + inward]
            shapes.append(p.createCollisionShape(p.GEOM_MESH, vertices=corners, **where))
        n, count = len(centers), len(shapes)
        feet = np.column_stack([centers, np.full(n, _FOOT)])
        places = (np.vstack([feet, np.zeros((count - n, 3))]) - self._center).tolist()
        body = body_of_links(p, where, float(scene.mass.sum()), shapes, places)
        away = centers - scene.center_of_mass
        own = scene.grid.width**2 / 12
        inertia = [scene.mass @ (away[:, 1] ** 2 + own), scene.mass @ (away[:, 0] ** 2 + own)]
        p.changeDynamics(
            body, -1, linearDamping=0, angularDamping=0,
            localInertiaDiagonal=[*inertia, scene.moment_of_inertia], **where,
        )  # fmt: skip
        for link, (mass, mu) in enumerate(zip(scene.mass, scene.mu, strict=True)):
            set_foot(p, where, body, link, mass, mu, _SINK)
            p.setCollisionFilterGroupMask(body, link, _FEET, _TABLE, **where)
        for link in range(n, count):
            # Prisms near the finger count only once they touch it.
            p.changeDynamics(
                body, link, lateralFriction=scene.mu_finger, contactProcessingThreshold=0.0, **where
            )
            p.setCollisionFilterGroupMask(body, link, _SIDES, _FINGER, **where)
        return body

    def _add_finger(self, scene: EngineScene) -> int:
        shape = p.createCollisionShape(p.GEOM_SPHERE, radius=scene.finger_radius, **self._where)
        return finger_on_rails(p, self._where, shape, _HEIGHT, _FINGER, _SIDES)
