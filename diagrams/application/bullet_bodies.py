"""Bodies in Bullet for worlds with a finger: an object whose feet are links, and the finger itself."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

import numpy as np

LEVEL = (0.0, 0.0, 0.0, 1.0)  # the identity quaternion
_LINK_MASS = 1e-6  # kg
_FINGER_MASS = 1e-2  # kg; so light that its drive force is the contact force


def body_of_links(
    p: ModuleType,
    where: dict[str, int],
    mass: float,
    shapes: Sequence[int],
    places: Sequence[Sequence[float]],
    turn: Sequence[float] = LEVEL,
) -> int:
    """A body with all the mass (kg), to which almost massless links with these shapes are fixed.

    Args:
        p, where: pybullet, and the client.
        places: of each link's frame in the body's principal one, m.
        turn: quaternion of all links' frames in it, real part last.
    """
    count, here = len(shapes), [0.0, 0.0, 0.0]
    return int(
        p.createMultiBody(
            mass, -1, -1, here, LEVEL, linkMasses=[_LINK_MASS] * count, linkCollisionShapeIndices=shapes,
            linkVisualShapeIndices=[-1] * count, linkPositions=places, linkOrientations=[turn] * count,
            linkInertialFramePositions=[here] * count, linkInertialFrameOrientations=[LEVEL] * count,
            linkParentIndices=[0] * count, linkJointTypes=[p.JOINT_FIXED] * count,
            linkJointAxis=[[0, 0, 1]] * count, **where,
        )
    )  # fmt: skip


def set_foot(
    p: ModuleType, where: dict[str, int], body: int, link: int, mass: float, mu: float, sink: float
) -> None:
    """Let a link carry the weight of a mass (kg) where it has sunk in by `sink` (m), with friction `mu`."""
    stiffness = mass * 9.81 / sink
    p.changeDynamics(
        body, link, lateralFriction=mu, contactStiffness=stiffness,
        contactDamping=2 * np.sqrt(stiffness * mass), **where,
    )  # fmt: skip


def finger_on_rails(
    p: ModuleType, where: dict[str, int], shape: int, height: float, group: int, mask: int
) -> int:
    """A finger with a shape and its frame at a height (m), on joints 0 along x and 1 along y.

    Args:
        group, mask: collision group of the finger, and of what it touches.
    """
    here = [[0.0, 0.0, 0.0]] * 2
    finger = p.createMultiBody(
        0, -1, basePosition=[0, 0, height], linkMasses=[_FINGER_MASS] * 2,
        linkCollisionShapeIndices=[-1, shape], linkVisualShapeIndices=[-1, -1], linkPositions=here,
        linkOrientations=[LEVEL] * 2, linkInertialFramePositions=here,
        linkInertialFrameOrientations=[LEVEL] * 2, linkParentIndices=[0, 1],
        linkJointTypes=[p.JOINT_PRISMATIC] * 2, linkJointAxis=np.eye(3)[:2].tolist(), **where,
    )  # fmt: skip
    p.changeDynamics(finger, 1, lateralFriction=1.0, **where)
    for link in (-1, 0, 1):
        p.setCollisionFilterGroupMask(finger, link, group if link == 1 else 0, mask, **where)
    return int(finger)
