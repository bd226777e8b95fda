"""Objects, pushes and geometry for the physics tests, independent of the code under test."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import shapely
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.rollout import Maps, Push, Rollouts, Slider

FloatArray = NDArray[np.float64]

GRAVITY = 9.81
FINGER_RADIUS = 0.005


def rectangle(columns: int, rows: int, width: float = 0.01) -> CellGrid:
    """A rectangle that its cells tile exactly, centred on the object frame's origin."""
    x = (np.arange(columns) - (columns - 1) / 2) * width
    y = (np.arange(rows) - (rows - 1) / 2) * width
    centers = np.array([(a, b) for b in y for a in x])
    half = np.array([columns, rows]) * width / 2
    return CellGrid(centers, width, np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half)


def star(draw: st.DrawFn, most_corners: int, least_radius: float) -> tuple[FloatArray, FloatArray]:
    """A place (2,) near the object frame's origin, and corners (k, 2) around it, convex or not."""
    k = draw(st.integers(3, most_corners))
    angles = (np.arange(k) + draw(st.lists(st.floats(-0.3, 0.3), min_size=k, max_size=k))) * 2 * np.pi / k
    radii = draw(st.lists(st.floats(least_radius, 0.1), min_size=k, max_size=k))
    middle = np.array(draw(st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))))
    return middle, middle + np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])


def l_shape(width: float = 0.01) -> CellGrid:
    """An L of 40 cells, arms two cells wide; its concave corner is at (0, 0), open to +x and +y."""
    cells = [(i, j) for i in range(-2, 8) for j in range(-2, 10) if i < 0 or j < 0]
    corners = [(-2, -2), (8, -2), (8, 0), (0, 0), (0, 10), (-2, 10)]
    return CellGrid((np.array(cells) + 0.5) * width, width, np.array(corners, dtype=float) * width)


def random_maps(rng: np.random.Generator, n: int, mu_finger: float = 0.3) -> Maps:
    return Maps(rng.uniform(0.005, 0.03, n), rng.uniform(0.2, 0.6, n), np.array([mu_finger]))


def finger_push(tip: FloatArray, h: float, *, start_pose: ArrayLike = (0, 0, 0), **more: ArrayLike) -> Push:
    """A push along `tip`, with the contact force of every step."""
    middles = h * (np.arange(len(tip) - 1) + 0.5)
    return Push(h, tip, np.asarray(start_pose, dtype=float), force_times=middles, **more)


def line(start: ArrayLike, velocity: ArrayLike, duration: float, h: float) -> FloatArray:
    """Finger centres of a straight path at constant velocity."""
    steps = round(duration / h)
    return np.asarray(start) + np.outer(h * np.arange(steps + 1), np.asarray(velocity))


def coast(twist: ArrayLike, duration: float, h: float, start_pose: ArrayLike = (0, 0, 0)) -> Push:
    """No finger and no force: the object slides on."""
    return drive(np.zeros((round(duration / h), 5)), h, start_pose=start_pose, start_twist=twist)


def drive(
    wrench: FloatArray, h: float, *, start_pose: ArrayLike = (0, 0, 0), start_twist: ArrayLike = (0, 0, 0)
) -> Push:
    """A push by a wrench only."""
    nowhere = np.full((len(wrench) + 1, 2), np.nan)
    start_pose, start_twist = (np.asarray(a, dtype=float) for a in (start_pose, start_twist))
    return Push(h, nowhere, start_pose, start_twist, wrench=wrench)


def rotation(angle: float) -> FloatArray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def to_world(points: ArrayLike, pose: ArrayLike) -> FloatArray:
    return np.asarray(points) @ rotation(np.asarray(pose)[2]).T + np.asarray(pose)[:2]


def to_object(points: ArrayLike, pose: ArrayLike) -> FloatArray:
    return (np.asarray(points) - np.asarray(pose)[:2]) @ rotation(np.asarray(pose)[2])


def twists_between(poses: FloatArray, h: float) -> FloatArray:
    """Constant object-frame twists (k, 3) of the screw motions from each of k + 1 poses to the next."""
    turn = np.diff(poses[:, 2])
    twists = np.empty((len(turn), 3))
    for k, angle in enumerate(turn):
        step = rotation(poses[k, 2]).T @ (poses[k + 1, :2] - poses[k, :2])
        # Logarithm of a planar motion: p = V(angle) v with V = [[sin, cos - 1], [1 - cos, sin]] / angle.
        a = np.sinc(angle / np.pi)
        b = np.sin(angle / 2) * np.sinc(angle / 2 / np.pi)
        twists[k, :2] = np.linalg.solve([[a, -b], [b, a]], step) / h
        twists[k, 2] = angle / h
    return twists


def mass_matrix(grid: CellGrid, mass: FloatArray) -> FloatArray:
    """(3, 3) inertia at the object frame's origin, each cell a solid square."""
    total = np.zeros((3, 3))
    for (x, y), m in zip(grid.centers, mass, strict=True):
        jacobian = np.array([[1.0, 0.0, -y], [0.0, 1.0, x]])
        total += m * jacobian.T @ jacobian
        total[2, 2] += m * grid.width**2 / 6
    return total


def kinetic_energy(grid: CellGrid, mass: FloatArray, twists: FloatArray) -> FloatArray:
    return 0.5 * np.einsum("ki,ij,kj->k", twists, mass_matrix(grid, mass), twists)


def signed_distances(grid: CellGrid, points: FloatArray) -> FloatArray:
    """Distances of object-frame points from the outline, negative inside the object."""
    polygon = shapely.Polygon(grid.exterior, grid.holes)
    places = shapely.points(points)
    distance = shapely.distance(polygon.boundary, places)
    return np.where(shapely.contains(polygon, places), -distance, distance)


def gaps_along(grid: CellGrid, poses: FloatArray, tip: FloatArray, radius: float) -> FloatArray:
    """(k,) gaps between the finger and the object in k poses; `tip` is (k, 2), world."""
    local = np.array([to_object(t, q) for t, q in zip(tip, poses, strict=True)])
    return signed_distances(grid, local) - radius


def touched_point(grid: CellGrid, point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The outline's point nearest to an outside point, and the unit normal from it to that point."""
    boundary = shapely.Polygon(grid.exterior, grid.holes).boundary
    nearest = boundary.interpolate(boundary.project(shapely.Point(point)))
    contact = np.array(nearest.coords[0])
    return contact, (point - contact) / np.linalg.norm(point - contact)


def with_start(poses: FloatArray, push: Push) -> FloatArray:
    """Poses at the ends of all steps, after the start pose."""
    return np.vstack([push.start_pose, poses])


PARAMETERS = ("mass", "mu", "mu_finger", "start_pose", "start_twist")


def parameter_slices(n: int) -> dict[str, slice]:
    """Columns of `Slider.map_columns` by kind."""
    ends = np.cumsum([0, n, n, 1, 3, 3])
    return {name: slice(a, b) for name, a, b in zip(PARAMETERS, ends[:-1], ends[1:], strict=True)}


def parameter_vector(maps: Maps, push: Push) -> FloatArray:
    """(2n + 7,) parameters of one model and one push."""
    return np.concatenate([maps.mass[0], maps.mu[0], maps.mu_finger, push.start_pose, push.start_twist])


def rollout_at(slider: Slider, push: Push, parameters: FloatArray) -> Rollouts:
    """Rollouts of one push for P parameter vectors (P, 2n + 7) at once."""
    at = parameter_slices(len(slider.grid))
    mass, mu, mu_finger, start_pose, start_twist = (parameters[:, at[name]] for name in PARAMETERS)
    return slider.rollout(
        Maps(mass, mu, mu_finger[:, 0]),
        [push],
        start_poses=start_pose[:, None],
        start_twists=start_twist[:, None],
    )


def central_differences(
    slider: Slider, push: Push, at: FloatArray, steps: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of poses (S, 3, P) and forces (T, 2, P) in all parameters, by a five-point formula."""
    shifts = np.diag(steps)
    out = rollout_at(slider, push, np.vstack([at + k * shifts for k in (-2, -1, 1, 2)]))

    def derivative(values: FloatArray) -> FloatArray:
        far_below, below, above, far_above = values.reshape(4, len(at), *values.shape[1:])
        return np.moveaxis((8 * (above - below) - (far_above - far_below)) / 12, 0, -1) / steps

    return derivative(out.poses), derivative(out.forces)


def orders_of_convergence(
    run: Callable[[int], FloatArray], refinements: list[int], finest: int
) -> FloatArray:
    """Observed orders between successive refinements, against the finest."""
    reference = run(finest)
    errors = np.array([np.linalg.norm(run(k) - reference) for k in refinements])
    return np.log(errors[:-1] / errors[1:]) / np.log(np.array(refinements[1:]) / np.array(refinements[:-1]))
