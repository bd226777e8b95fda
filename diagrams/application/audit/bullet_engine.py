"""Bullet under audit: a rigid body with one foot per cell."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from slipmap.diagrams.application.audit.engines import EngineScene
from slipmap.diagrams.application.bullet_bodies import FEET, FOOT, MARGIN, SINK, TABLE, BulletScene
from slipmap.models.physics.cell_grid import FloatArray

_HEIGHT = 2e-3  # m, of the object's centre of mass and of the finger's centre above the table
_SIDE = 0.02  # m, height of the sides


class BulletEngine:
    """Bullet's multibody solver."""

    dt: ClassVar[float] = 2e-3
    cone: ClassVar[bool] = True  # friction as a cone; otherwise along two axes independently
    iterations: ClassVar[int] = 50

    def __init__(self, scene: EngineScene, gravity: FloatArray) -> None:
        self._bullet = BulletScene(gravity, self.dt, self.cone, self.iterations)
        self._p = p = self._bullet.p
        plane = p.createMultiBody(0, p.createCollisionShape(p.GEOM_PLANE))
        p.changeDynamics(plane, -1, lateralFriction=1.0)
        p.setCollisionFilterGroupMask(plane, -1, TABLE, FEET)
        self._center = np.array([*scene.center_of_mass, _HEIGHT])
        self._object = self._add_object(scene)
        shape = p.createCollisionShape(p.GEOM_SPHERE, radius=scene.finger_radius)
        self._bullet.add_finger(shape, _HEIGHT)

    def reset(self, pose: FloatArray, velocity: FloatArray, tip: FloatArray) -> None:
        """See `Engine`."""
        p = self._p
        turn = p.getQuaternionFromEuler([0, 0, float(pose[2])])
        place, turn = p.multiplyTransforms([*pose[:2], -SINK], turn, self._center.tolist(), [0, 0, 0, 1])
        p.resetBasePositionAndOrientation(self._object, place, turn)
        vx, vy, omega = velocity
        x, y = np.array(place)[:2] - pose[:2]
        p.resetBaseVelocity(self._object, [vx - omega * y, vy + omega * x, 0], [0, 0, omega])
        self._bullet.put_finger(tip)

    def step(
        self, tip: FloatArray, tip_velocity: FloatArray, next_tip: FloatArray, next_velocity: FloatArray
    ) -> FloatArray:
        """See `Engine`."""
        speed = (next_tip - tip) / self.dt
        self._bullet.put_finger(tip, speed)
        self._bullet.drive(speed)
        self._p.stepSimulation()
        return np.array([state[3] for state in self._bullet.finger_states()])

    def pose(self) -> FloatArray:
        """See `Engine`."""
        p = self._p
        place, turn = p.getBasePositionAndOrientation(self._object)
        place, turn = p.multiplyTransforms(place, turn, (-self._center).tolist(), [0, 0, 0, 1])
        return np.array([*place[:2], 2 * np.arctan2(turn[2], turn[3])])

    def _add_object(self, scene: EngineScene) -> int:
        p, centers = self._p, scene.grid.centers
        feet = [
            (p.createCollisionShape(p.GEOM_SPHERE, radius=FOOT), mass, mu)
            for mass, mu in zip(scene.mass, scene.mu, strict=True)
        ]
        sides = [
            self._bullet.prism(piece + np.sign(piece.mean(axis=0) - piece) * MARGIN, _SIDE)  # rectangles
            for piece in scene.pieces
        ]
        places = np.vstack([np.insert(centers, 2, FOOT, axis=1), np.zeros((len(sides), 3))]) - self._center
        x, y = (centers - scene.center_of_mass).T
        own = scene.grid.width**2 / 12
        moments = np.array([scene.mass @ (y**2 + own), scene.mass @ (x**2 + own), scene.moment_of_inertia])
        inertia = float(scene.mass.sum()), moments
        return self._bullet.add_object(inertia, feet, sides, scene.mu_finger, places.tolist())
