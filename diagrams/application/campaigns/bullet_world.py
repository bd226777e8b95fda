"""A second true world beside Drake's: the object in Bullet, a rigid body with one foot per cell."""

import numpy as np
import shapely
from scipy.spatial.transform import Rotation

from slipmap.diagrams.application.bullet_bodies import (
    FEET,
    FINGER,
    FOOT,
    MARGIN,
    SIDES,
    SINK,
    TABLE,
    BulletScene,
)
from slipmap.diagrams.application.campaigns.worlds import (
    AT_REST,
    LONGEST_SETTLING,
    PERIOD,
    DirectWorld,
    Motion,
    WorldNoise,
    flat_pose,
)
from slipmap.diagrams.station.sliding_object import GRAVITY, spatial_inertia
from slipmap.models.objects.footprints import convex_pieces
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import FINGER_LENGTH, FINGER_RADIUS

_FINGER_HEIGHT = 2e-3  # m, of its end above the table
_THICKNESS = 0.1  # m, of the table top
_FLOOR = -0.72  # m
_AWAY = np.array([20.0, 20.0])
_ITERATIONS = 50
_CONTACTS = 4  # contacts that Bullet keeps between two bodies
_APART = 0.03  # m; Bullet merges contacts closer than 20 mm
Pose = tuple[list[float], list[float]]  # place, and quaternion with the real part last


class BulletWorld(DirectWorld):
    """The object on one round foot per cell, with the cell's friction and stiffness in proportion to weight.

    Finger and table edge touch upright prisms of the object's outline. Friction coefficients are those of the
    true object: Bullet multiplies the two of a pair, and the other is 1.

    Raises:
        ModuleNotFoundError: pybullet is not installed.
    """

    _step = 2e-3

    def __init__(self, true_object: TrueObject, noise: WorldNoise | None = None) -> None:
        super().__init__(true_object, noise)
        self._bullet = BulletScene((0, 0, -GRAVITY), self._step, True, _ITERATIONS)
        self._p = p = self._bullet.p
        self._add_table()
        self._body = self._add_object()
        finger = p.createCollisionShape(p.GEOM_CYLINDER, radius=FINGER_RADIUS, height=FINGER_LENGTH)
        self._bullet.add_finger(finger, _FINGER_HEIGHT + FINGER_LENGTH / 2)

    def _place(self, pose: FloatArray) -> None:
        p = self._p
        turn = p.getQuaternionFromEuler([0, 0, float(pose[2])])
        # Bullet's pose of a body is that of its principal frame.
        X_WI = p.multiplyTransforms([pose[0], pose[1], -SINK], turn, *self._X_OI)
        p.resetBasePositionAndOrientation(self._body, *X_WI)
        p.resetBaseVelocity(self._body, [0, 0, 0], [0, 0, 0])
        self._bullet.put_finger(_AWAY)

    def _drive(self, tip: FloatArray) -> Motion:
        self._bullet.put_finger(tip[0])
        stride = round(PERIOD / self._step)
        poses, tips, forces = [self._pose()], [tip[0]], [np.zeros(2)]
        total, now = np.zeros(2), tip[0]
        for step, wanted in enumerate(tip[1:], start=1):
            self._bullet.drive((wanted - now) / self._step)
            self._p.stepSimulation()
            states = self._bullet.finger_states()
            now = np.array([state[0] for state in states])
            total = total + [state[3] for state in states]
            if step % stride == 0:
                poses.append(self._pose())
                tips.append(now)
                forces.append(total / stride)
                total = np.zeros(2)
        self._bullet.put_finger(_AWAY)
        return Motion(np.array(poses), np.array(tips), np.array(forces))

    def _settle(self) -> None:
        for step in range(1, round(LONGEST_SETTLING / self._step) + 1):
            self._p.stepSimulation()
            if step % 50 == 0:
                fastest = np.abs(self._p.getBaseVelocity(self._body)).max()
                if (step >= 250 and fastest < AT_REST) or np.isnan(self._pose()).any():
                    return

    def _pose(self) -> FloatArray:
        p = self._p
        X_WI = p.getBasePositionAndOrientation(self._body)
        place, turn = p.multiplyTransforms(*X_WI, *self._X_IO)
        x, y, z, w = np.array(turn)
        return flat_pose(np.array(place), w, x, y, z)

    def _add_table(self) -> None:
        p, table = self._p, self.table
        disc = p.createCollisionShape(p.GEOM_CYLINDER, radius=table.radius, height=_THICKNESS)
        top = p.createMultiBody(0, disc, basePosition=[*table.center, -_THICKNESS / 2])
        floor = p.createMultiBody(
            0, p.createCollisionShape(p.GEOM_BOX, halfExtents=[4, 4, 0.1]),
            basePosition=[0, 0, _FLOOR - 0.1]
        )  # fmt: skip
        for body in (top, floor):
            p.changeDynamics(body, -1, lateralFriction=1.0)
            p.setCollisionFilterGroupMask(body, -1, TABLE, FEET | SIDES)

    def _add_object(self) -> int:
        # Feet of equal cells share links, because Bullet's cost per contact grows with the number of links.
        thing = self.true_object
        moments, self._X_OI = self._principal()
        self._X_IO = self._p.invertTransform(*self._X_OI)
        feet = [
            (self._feet(thing.grid.centers[group]), thing.mass[group[0]], thing.mu[group[0]])
            for group in _groups(thing)
        ]
        sides = self._sides()
        place, turn = self._X_IO
        places = [place] * (len(feet) + len(sides))
        return self._bullet.add_object(
            (thing.total_mass, moments), feet, sides, thing.mu_finger, places, turn, FINGER | TABLE
        )

    def _feet(self, centers: FloatArray) -> int:
        """A shape of spheres under cells with centres (k, 2)."""
        p, count = self._p, len(centers)
        return int(
            p.createCollisionShapeArray(
                shapeTypes=[p.GEOM_SPHERE] * count, radii=[FOOT] * count,
                collisionFramePositions=[[x, y, FOOT] for x, y in centers]
            )
        )  # fmt: skip

    def _principal(self) -> tuple[FloatArray, Pose]:
        """(3,) principal moments about the centre of mass, and the pose of its principal frame I."""
        thing = self.true_object
        middle = thing.center_of_mass
        about = spatial_inertia(thing).Shift(middle).CalcRotationalInertia().CopyToFullMatrix3()
        moments, axes = np.linalg.eigh(about)
        axes[:, 0] *= np.linalg.det(axes)
        x, y, z, w = Rotation.from_matrix(axes).as_quat()
        return moments, (middle.tolist(), [x, y, z, w])

    def _sides(self) -> list[int]:
        """Shapes of convex prisms, shrunk by the margin that Bullet adds."""
        return [
            self._bullet.prism(np.asarray(piece.exterior.coords)[:-1], block.height - MARGIN)
            for block in self.true_object.blocks
            for part in shapely.get_parts(block.outline.buffer(-MARGIN, join_style="mitre"))
            for piece in convex_pieces(part)
        ]


def _groups(thing: TrueObject) -> list[list[int]]:
    """Groups of cells of equal mass and friction, few and far enough apart for Bullet's contacts."""
    groups: list[list[int]] = []
    for cell, center in enumerate(thing.grid.centers):
        for group in groups:
            like = thing.mass[cell] == thing.mass[group[0]] and thing.mu[cell] == thing.mu[group[0]]
            away = np.hypot(*(thing.grid.centers[group] - center).T).min() > _APART
            if like and away and len(group) < _CONTACTS:
                group.append(cell)
                break
        else:
            groups.append([cell])
    return groups
