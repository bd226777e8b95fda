"""Leaning friction, against Bullet, the simulator that it comes from, contact by contact."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from pushed_with_effects import block

from slipmap.models.effects import LIBRARY
from slipmap.models.physics.rollout import Maps, Push, Slider

GRID = block(8, 4)
MASS = np.where(GRID.centers[:, 0] < 0.0, 4.0, 1.0)
LEAN = {effect.name: effect for effect in LIBRARY}["impulse_friction"]


def contacts(speed: tuple[float, float], omega: float, angle: float) -> list[tuple[np.ndarray, ...]]:
    """Arm from the centre of mass, velocity, friction (world) and load of each contact of an object of
    cells, one articulated body with fixed joints, that slides on a table in Bullet."""
    pybullet = pytest.importorskip("pybullet", reason="Bullet comes with the extra `bench`")
    client = pybullet.connect(pybullet.DIRECT)
    try:
        world = {"physicsClientId": client}
        pybullet.setGravity(0, 0, -9.81, **world)
        half = GRID.width / 2
        table = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[1, 1, 1], **world)
        cell = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[half] * 3, **world)
        table = pybullet.createMultiBody(0, table, -1, [0, 0, -1], **world)
        n = len(GRID)
        c, s = np.cos(angle), np.sin(angle)
        turn = pybullet.getQuaternionFromEuler([0, 0, angle])
        body = pybullet.createMultiBody(
            1e-7, -1, -1, [0, 0, half], turn,
            linkMasses=[1.0] * n, linkCollisionShapeIndices=[cell] * n, linkVisualShapeIndices=[-1] * n,
            linkPositions=[[x, y, 0] for x, y in GRID.centers], linkOrientations=[[0, 0, 0, 1]] * n,
            linkInertialFramePositions=[[0, 0, 0]] * n, linkInertialFrameOrientations=[[0, 0, 0, 1]] * n,
            linkParentIndices=[0] * n, linkJointTypes=[pybullet.JOINT_FIXED] * n,
            linkJointAxis=[[0, 0, 1]] * n, **world,
        )  # fmt: skip
        for link in range(n):
            pybullet.changeDynamics(body, link, mass=MASS[link], lateralFriction=0.5, **world)
        pybullet.changeDynamics(table, -1, lateralFriction=1.0, **world)
        pybullet.resetBaseVelocity(body, [*speed, 0], [0, 0, omega], **world)
        for _ in range(3):
            pybullet.stepSimulation(**world)
        (vx, vy, _), (_, _, omega) = pybullet.getBaseVelocity(body, **world)
        origin, _ = pybullet.getBasePositionAndOrientation(body, **world)
        center = MASS @ GRID.centers / MASS.sum()
        center = origin[:2] + np.array([[c, -s], [s, c]]) @ center
        found = []
        for contact in pybullet.getContactPoints(body, table, **world):
            place, load = np.array(contact[5][:2]), contact[9]
            along = contact[10] * np.array(contact[11]) + contact[12] * np.array(contact[13])
            arm = place - origin[:2]
            velocity = np.array([vx - omega * arm[1], vy + omega * arm[0]])
            found.append((place - center, velocity, along[:2], load))
        return found
    finally:
        pybullet.disconnect(client)


def degrees_off(
    share: float, angle: float, arm: np.ndarray, velocity: np.ndarray, friction: np.ndarray
) -> float:
    """Degrees between the law's direction and that of a given friction, for an object turned by an angle."""
    inertia = Slider(GRID, 0.005, effects=[LEAN]).inertia(MASS[None])[0]
    mass, *first, moment = inertia
    c, s = np.cos(angle), np.sin(angle)
    to_world = np.array([[c, -s], [s, c]])
    center = to_world @ first / mass
    rx, ry = to_world.T @ (arm + center)
    cell = SimpleNamespace(
        theta=angle, cos=c, sin=s, rx=rx, ry=ry, com_x=center[0], com_y=center[1], mass=mass, moment=moment
    )
    xx, xy, yy = (float(entry) for entry in LEAN.stretch(cell, SimpleNamespace(share=share)))
    lean = to_world @ np.array([[xx, xy], [xy, yy]]) @ to_world.T @ velocity
    cross, dot = lean[0] * friction[1] - lean[1] * friction[0], lean @ friction
    return float(np.degrees(np.arctan2(cross, dot)))


@pytest.mark.parametrize(
    ("speed", "omega", "angle"), [((0.25, 0.1), 2.0, 0.0), ((0.1, -0.3), -1.5, 0.7), ((0.2, 0.2), 0.5, 2.0)]
)
def test_friction_leans_as_in_bullet(speed: tuple[float, float], omega: float, angle: float) -> None:
    found = [contact for contact in contacts(speed, omega, angle) if contact[3] > 0.1]
    load = np.array([contact[3] for contact in found])
    assert len(load) >= 10
    for _arm, velocity, friction, normal in found:
        assert np.hypot(*friction) == pytest.approx(0.5 * normal, rel=1e-3)
        assert friction @ velocity > 0  # Bullet gives the force on the table
    errors = {
        share: np.array([degrees_off(share, angle, arm, v, friction) for arm, v, friction, _ in found])
        for share in (0.0, 1.0)
    }
    spread = {share: np.sqrt(load @ error**2 / load.sum()) for share, error in errors.items()}
    assert spread[1.0] < 1.5
    assert spread[0.0] > 5 * spread[1.0]


def test_friction_that_leans_is_no_larger() -> None:
    """A single sliding cell, far from the centre of mass of a heavy object, is braked by its own load."""
    maps = Maps(MASS[None], np.zeros((1, len(GRID))), np.array([0.3]), np.array([[1.0]]))
    corner = int(np.argmax(GRID.centers @ [1.0, 0.6]))
    maps.mu[0, corner] = 0.5
    slider = Slider(GRID, 0.005, effects=[LEAN])
    h, steps = 1e-4, 20
    twist = np.array([0.2, 0.1, 0.0])
    push = Push(h, np.full((steps + 1, 2), np.nan), np.zeros(3), twist)
    end = slider.rollout(maps, [push]).end[0, 0]
    impulse = MASS.sum() * (end[3:5] - twist[:2])
    arm = MASS @ GRID.centers / MASS.sum()
    impulse += MASS.sum() * end[5] * np.array([-arm[1], arm[0]])
    load = 0.5 * MASS[corner] * slider.gravity
    assert np.hypot(*impulse) == pytest.approx(load * h * steps, rel=2e-3)
    # And it leans away from the motion.
    assert abs(np.degrees(np.arctan2(-impulse[1], -impulse[0]) - np.arctan2(0.1, 0.2))) > 5
