"""Independent answers to compare the model with: exact Coulomb friction over a fine grid of points.

Two formulations, neither of them the convex time step under test: Newton's equations under friction and an
applied force, integrated by an adaptive Runge-Kutta method; and for a slow finger the principle of least
power: of all twists that the finger allows the one that dissipates least.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import minimize, minimize_scalar
from sliding_objects import GRAVITY, rotation, to_object, touched_point

from slipmap.models.physics.cell_grid import CellGrid

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class PointCloud:
    """An object of small pieces: points (k, 2) in the object frame, masses (kg) and friction loads (N)."""

    points: FloatArray
    mass: FloatArray
    load: FloatArray

    @classmethod
    def of_cells(cls, grid: CellGrid, mass: ArrayLike, mu: ArrayLike, across: int) -> PointCloud:
        """Each cell cut into across² points, with the cell's own mass and friction."""
        offset = ((np.arange(across) + 0.5) / across - 0.5) * grid.width
        inside = np.stack(np.meshgrid(offset, offset), axis=-1).reshape(-1, 2)
        points = (grid.centers[:, None] + inside).reshape(-1, 2)
        mass = np.repeat(np.asarray(mass) / across**2, across**2)
        return cls(points, mass, mass * GRAVITY * np.repeat(np.asarray(mu), across**2))

    @classmethod
    def of_rectangle(
        cls,
        size: ArrayLike,
        density: Callable[[FloatArray], FloatArray],
        mu: Callable[[FloatArray], FloatArray],
        across: int = 200,
    ) -> PointCloud:
        """A rectangle about the origin with density (kg/m²) and friction given at points (k, 2)."""
        size = np.asarray(size)
        axes = [((np.arange(across) + 0.5) / across - 0.5) * length for length in size]
        points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        mass = density(points) * size.prod() / across**2
        return cls(points, mass, mass * GRAVITY * mu(points))


def dynamic_motion(
    cloud: PointCloud,
    twist: ArrayLike,
    duration: float,
    force: ArrayLike = (0.0, 0.0),
    point: ArrayLike = (0.0, 0.0),
    couple: float = 0.0,
) -> FloatArray:
    """Pose after sliding from zero under a constant world force on an object-frame point and a couple.

    A freely sliding object is followed until it has all but stopped.
    """
    total = cloud.mass.sum()
    middle = cloud.mass @ cloud.points / total
    arms = cloud.points - middle
    inertia = cloud.mass @ (arms**2).sum(axis=1)
    force = np.asarray(force, dtype=float)
    lever = np.asarray(point) - middle

    def rate(_: float, state: FloatArray) -> FloatArray:
        turn = rotation(state[2])
        arm = arms @ turn.T
        velocity = state[3:5] + state[5] * np.column_stack([-arm[:, 1], arm[:, 0]])
        friction = -velocity * (cloud.load / np.linalg.norm(velocity, axis=1))[:, None]
        moment = np.sum(arm[:, 0] * friction[:, 1] - arm[:, 1] * friction[:, 0])
        x, y = turn @ lever
        moment += x * force[1] - y * force[0] + couple
        return np.concatenate([state[3:], (friction.sum(axis=0) + force) / total, [moment / inertia]])

    radius = np.sqrt(inertia / total)

    def nearly_at_rest(_: float, state: FloatArray) -> float:
        return float(np.hypot(np.hypot(state[3], state[4]), radius * state[5])) - 2e-4

    nearly_at_rest.terminal = True  # type: ignore[attr-defined]
    v_x, v_y, omega = np.asarray(twist, dtype=float)
    start = [*middle, 0.0, v_x - omega * middle[1], v_y + omega * middle[0], omega]
    events = None if np.any(force) or couple else nearly_at_rest
    end = solve_ivp(rate, (0.0, duration), start, rtol=1e-7, atol=1e-10, events=events).y[:3, -1]
    return np.array([*(end[:2] - rotation(end[2]) @ middle), end[2]])


def least_power_push(
    grid: CellGrid,
    cloud: PointCloud,
    tip: FloatArray,
    velocity: FloatArray,
    duration: float,
    radius: float,
    mu_finger: float,
) -> FloatArray:
    """Pose after a slow finger has moved straight on from `tip` (world), always in touch."""

    def rate(time: float, pose: FloatArray) -> FloatArray:
        turn = rotation(pose[2])
        contact, normal = touched_point(grid, to_object(tip + time * velocity, pose))
        twist = _least_power_twist(cloud, contact, normal, turn.T @ velocity, mu_finger)
        return np.array([*(turn @ twist[:2]), twist[2]])

    return solve_ivp(rate, (0.0, duration), np.zeros(3), rtol=1e-5, atol=1e-8).y[:, -1]


def _least_power_twist(
    cloud: PointCloud, contact: FloatArray, normal: FloatArray, finger: FloatArray, mu_finger: float
) -> FloatArray:
    arms = cloud.points - contact
    size = np.sqrt((arms**2).sum(axis=1).mean())

    def velocities(at_contact: FloatArray, omega: float) -> FloatArray:
        return at_contact + omega * np.column_stack([-arms[:, 1], arms[:, 0]])

    def power(at_contact: FloatArray, omega: float) -> float:
        return float(cloud.load @ np.linalg.norm(velocities(at_contact, omega), axis=1))

    def gradient(at_contact: FloatArray, omega: float) -> FloatArray:
        u = velocities(at_contact, omega)
        s = u * (cloud.load / np.linalg.norm(u, axis=1))[:, None]
        return np.array([*s.sum(axis=0), np.sum(arms[:, 0] * s[:, 1] - arms[:, 1] * s[:, 0])])

    speed = np.linalg.norm(finger)
    # The finger sticks: the contact moves with it, and only the rotation is free.
    turn = minimize_scalar(
        lambda w: power(finger, w * speed / size), bracket=(-0.5, 0.5), options={"xtol": 1e-9}
    ).x
    omega = turn * speed / size
    force = gradient(finger, omega)[:2]
    tangent = np.array([-normal[1], normal[0]])
    along = float(force @ tangent)
    if abs(along) <= mu_finger * float(-force @ normal):
        at_contact = finger
    else:
        # The finger slips: the force is on the edge of the cone; power is least for a given motion along it.
        edge = -normal + np.sign(along) * mu_finger * tangent
        across = np.array([-edge[1], edge[0]])

        def twist_of(z: FloatArray) -> tuple[FloatArray, float]:
            return edge / (edge @ edge) + z[0] * across, z[1] / size

        def value(z: FloatArray) -> tuple[float, FloatArray]:
            at, w = twist_of(z)
            slope = gradient(at, w)
            return power(at, w), np.array([slope[:2] @ across, slope[2] / size])

        accuracy = {"gtol": 1e-7 * cloud.load.sum()}
        found = minimize(value, np.zeros(2), jac=True, method="BFGS", options=accuracy)
        at_contact, omega = twist_of(found.x)
        scale = float(finger @ normal) / float(at_contact @ normal)
        at_contact, omega = at_contact * scale, omega * scale
    return np.array([at_contact[0] + omega * contact[1], at_contact[1] - omega * contact[0], omega])
