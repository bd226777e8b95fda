"""The time step against closed forms, exact Coulomb friction on fine point grids, and the energy balance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from coulomb_reference import PointCloud, dynamic_motion, least_power_push
from sliding_objects import (
    FINGER_RADIUS,
    GRAVITY,
    coast,
    drive,
    finger_push,
    gaps_along,
    kinetic_energy,
    line,
    mass_matrix,
    orders_of_convergence,
    random_maps,
    rectangle,
    rotation,
    twists_between,
    with_start,
)

from slipmap.models.objects.footprints import cells_from_polygon
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.rollout import Maps, Push, Slider, Smoothing

SHARP = Smoothing(slip_speed=1e-6, stick_speed=1e-6, penetration=1e-6)


def disc(count: int, radius: float) -> CellGrid:
    angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    return cells_from_polygon(radius * np.column_stack([np.cos(angle), np.sin(angle)]), count=count)


def spin_down_torque(grid: CellGrid, mass: np.ndarray, mu: float, spin: float, duration: float) -> float:
    slider = Slider(grid, FINGER_RADIUS)
    maps = Maps(mass, np.full(len(grid), mu), np.array([0.3]))
    end = slider.rollout(maps, [coast((0, 0, spin), duration, 1e-3)]).end[0, 0]
    return mass_matrix(grid, mass)[2, 2] * (spin - end[5]) / duration


@pytest.mark.parametrize(("count", "tolerance"), [(60, 5.5e-3), (240, 2.5e-3), (960, 1.5e-3)])
def test_a_spinning_disc_slows_at_two_thirds_of_mu_m_g_r(count: int, tolerance: float) -> None:
    radius, mu, total = 0.05, 0.4, 0.8
    grid = disc(count, radius)
    torque = spin_down_torque(grid, np.full(len(grid), total / len(grid)), mu, spin=10.0, duration=0.05)
    assert torque == pytest.approx(2 / 3 * mu * total * GRAVITY * radius, rel=tolerance)


def test_spin_of_60_cells_has_the_torque_of_their_squares() -> None:
    # Without the error of cutting a disc into squares, the cells' own friction is far more accurate.
    grid = disc(60, 0.05)
    n = len(grid)
    torque = spin_down_torque(grid, np.full(n, 1 / n), mu=0.4, spin=10.0, duration=0.05)
    fine = PointCloud.of_cells(grid, np.full(n, 1 / n), np.full(n, 0.4), across=30)
    assert torque == pytest.approx(fine.load @ np.linalg.norm(fine.points, axis=1), rel=5e-4)


def test_a_push_through_the_centre_of_friction_goes_straight() -> None:
    rng = np.random.default_rng(1)
    grid = rectangle(8, 8)
    n = len(grid)
    mass = rng.uniform(0.005, 0.03, n)
    # With one friction coefficient the centre of friction is the centre of mass.
    maps = Maps(mass, np.full(n, 0.4), np.array([0.5]))
    middle = mass @ grid.centers / mass.sum()
    slider = Slider(grid, FINGER_RADIUS)

    def turn(offset: float) -> float:
        start = (-0.04 - FINGER_RADIUS, middle[1] + offset)
        pose = slider.rollout(maps, [finger_push(line(start, (0.05, 0), 1.0, 0.01), 0.01)]).poses[0, -1]
        if offset == 0:
            # Steady motion at the finger's speed, behind it only by the creep of the first touch.
            assert pose == pytest.approx([0.05, 0, 0], abs=2e-5)
        return float(pose[2])

    assert abs(turn(0.0)) < 1e-6
    assert turn(0.003) < -0.05
    assert turn(-0.003) > 0.05


@pytest.mark.parametrize("yaw", [0.0, 2.0])
@pytest.mark.parametrize("heading", [0.0, 1.0])
def test_a_sliding_block_stops_after_v_squared_over_two_mu_g(yaw: float, heading: float) -> None:
    speed, mu, h = 0.7, 0.35, 1e-4
    grid = rectangle(10, 6)
    rng = np.random.default_rng(2)
    maps = Maps(rng.uniform(0.005, 0.03, 60), np.full(60, mu), np.array([0.3]))
    twist = (speed * np.cos(heading), speed * np.sin(heading), 0.0)
    end = Slider(grid, FINGER_RADIUS).rollout(maps, [coast(twist, 0.3, h, start_pose=(1, 2, yaw))]).end[0, 0]
    distance = speed**2 / (2 * mu * GRAVITY)
    assert end[:2] - (1, 2) == pytest.approx(distance * rotation(yaw + heading)[:, 0], abs=1e-3 * distance)
    assert end[2:] == pytest.approx([yaw, 0, 0, 0], abs=1e-6)


@pytest.mark.parametrize("spin", [0.0, 1e-6, 3.0, 19.9, 20.1, 60.0, -200.0])
def test_a_step_moves_the_object_along_the_screw_of_its_new_twist(spin: float) -> None:
    push = coast((0.6, -0.2, spin), 0.06, 0.02, start_pose=(1.0, 2.0, 3.0))
    maps = random_maps(np.random.default_rng(15), 60)
    out = Slider(rectangle(10, 6), FINGER_RADIUS).rollout(maps, [push])
    twists = twists_between(with_start(out.poses[0], push), push.h)
    assert out.end[0, 0, 3:] == pytest.approx(twists[-1], abs=1e-9)


def relative_errors(pose: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Errors of translation and rotation, each relative to the total."""
    shift = np.linalg.norm(pose[:2] - reference[:2]) / np.linalg.norm(reference[:2])
    return np.array([shift, abs(pose[2] / reference[2] - 1)])


# From a face at 12 mm from the middle, straight and at 30 degrees: sticks with mu = 1, slips with mu = 0.1.
FINGER_START = np.array([-0.05 - FINGER_RADIUS, 0.012])
FINGER_MOVE = 0.04 * np.array([np.cos(0.5), np.sin(0.5)])


def slow_push(slider: Slider, maps: Maps) -> np.ndarray:
    """Pose after a finger moves 40 mm at 4 mm/s."""
    tip = line(FINGER_START, FINGER_MOVE / 10, 10, 5e-3)
    return slider.rollout(maps, [finger_push(tip, 5e-3)]).poses[0, -1]


def without_step_error(run: Callable[[float], np.ndarray], h: float) -> np.ndarray:
    """Richardson's extrapolation of a first-order result to a vanishing step."""
    return 2 * run(h / 2) - run(h)


def coasting(slider: Slider, maps: Maps) -> np.ndarray:
    def run(h: float) -> np.ndarray:
        return slider.rollout(maps, [coast((0.3, 0.2, 4.0), 0.3, h)]).end[0, 0, :3]

    return without_step_error(run, 1e-4)


FORCE = np.array([8.0, 6.0])
FORCE_POINT = (-0.03, 0.02)


def forced(slider: Slider, maps: Maps, force: np.ndarray = FORCE, couple: float = 0.0) -> np.ndarray:
    """Pose after 0.1 s of a constant force (world, N) on a point and a couple (N m)."""

    def run(h: float) -> np.ndarray:
        wrench = np.tile([*force, *FORCE_POINT, couple], (round(0.1 / h), 1))
        return slider.rollout(maps, [drive(wrench, h, start_twist=(0, 0, 0.01))]).end[0, 0, :3]

    return without_step_error(run, 1e-4)


class TestAgainstExactCoulombFriction:
    """60 cells with any maps move as 6,000 points do whose friction knows no smoothing."""

    grid = rectangle(10, 6)
    maps = random_maps(np.random.default_rng(3), 60)
    slider = Slider(grid, FINGER_RADIUS)
    cloud = PointCloud.of_cells(grid, maps.mass[0], maps.mu[0], across=10)

    def test_coasting_with_spin(self) -> None:
        reference = dynamic_motion(self.cloud, (0.3, 0.2, 4.0), 1.0)
        assert np.all(relative_errors(coasting(self.slider, self.maps), reference) < 1e-3)

    def test_force_on_a_point(self) -> None:
        reference = dynamic_motion(self.cloud, (0, 0, 0.01), 0.1, FORCE, FORCE_POINT)
        assert np.all(relative_errors(forced(self.slider, self.maps), reference) < 2e-3)

    def test_couple(self) -> None:
        reference = dynamic_motion(self.cloud, (0, 0, 0.01), 0.1, couple=0.35)
        pose = forced(self.slider, self.maps, force=np.zeros(2), couple=0.35)
        assert reference[2] > 0.5
        assert pose[2] == pytest.approx(reference[2], rel=1e-3)
        # It turns nearly on the spot: the remaining translation is compared with the path of its rim.
        assert pose[:2] == pytest.approx(reference[:2], abs=1e-3 * 0.05 * reference[2])

    @pytest.mark.parametrize("mu_finger", [0.1, 1.0])
    def test_slow_finger(self, mu_finger: float) -> None:
        reference = least_power_push(
            self.grid, self.cloud, FINGER_START, FINGER_MOVE, 1.0, FINGER_RADIUS, mu_finger
        )
        assert abs(reference[2]) > 0.3
        maps = Maps(self.maps.mass, self.maps.mu, np.array([mu_finger]))
        assert np.all(relative_errors(slow_push(self.slider, maps), reference) < 1e-3)


class TestCellsShrink:
    """A rectangle of smooth density and friction: 0.5 % with 60 cells, far better with each halving."""

    @staticmethod
    def density(points: np.ndarray) -> np.ndarray:
        return 300 * (1 + 4 * points[:, 0] + 6 * points[:, 1])

    @staticmethod
    def mu(points: np.ndarray) -> np.ndarray:
        return 0.4 * (1 - 5 * points[:, 0] + 80 * points[:, 1] ** 2)

    def errors(self, run, reference: np.ndarray, mu_finger: float = 0.3) -> np.ndarray:  # type: ignore[no-untyped-def]
        """(3,) larger relative error of translation and rotation with 15, 60 and 240 cells."""
        result = []
        for grid in (rectangle(5, 3, 0.02), rectangle(10, 6, 0.01), rectangle(20, 12, 0.005)):
            mass = self.density(grid.centers) * grid.width**2
            maps = Maps(mass, self.mu(grid.centers), np.array([mu_finger]))
            pose = run(Slider(grid, FINGER_RADIUS, smoothing=SHARP), maps)
            result.append(relative_errors(pose, reference).max())
        return np.array(result)

    def cloud(self, across: int) -> PointCloud:
        return PointCloud.of_rectangle((0.1, 0.06), self.density, self.mu, across)

    def check(self, errors: np.ndarray) -> None:
        assert errors[1] < 5e-3
        assert errors[2] < errors[1] / 2.5 < errors[0] / 5

    def test_coasting_with_spin(self) -> None:
        reference = dynamic_motion(self.cloud(200), (0.3, 0.2, 4.0), 1.0)
        self.check(self.errors(coasting, reference))

    def test_force_on_a_point(self) -> None:
        reference = dynamic_motion(self.cloud(200), (0, 0, 0.01), 0.1, FORCE, FORCE_POINT)
        self.check(self.errors(forced, reference))

    @pytest.mark.parametrize("mu_finger", [0.1, 1.0])
    def test_slow_finger(self, mu_finger: float) -> None:
        reference = least_power_push(
            rectangle(10, 6), self.cloud(100), FINGER_START, FINGER_MOVE, 1.0, FINGER_RADIUS, mu_finger
        )
        self.check(self.errors(slow_push, reference, mu_finger))


@pytest.mark.parametrize("seed", range(5))
def test_free_sliding_loses_energy_in_every_step_until_it_rests(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = rectangle(10, 6)
    mass, mu = rng.uniform(0, 0.03, 60), rng.uniform(0, 0.6, 60)
    push = coast(rng.normal(0, 1, 3) * [0.3, 0.3, 8], 1.0, 2e-3, start_pose=rng.normal(0, 1, 3))
    out = Slider(grid, FINGER_RADIUS).rollout(Maps(mass, mu, np.array([0.3])), [push])
    twists = np.vstack([push.start_twist, twists_between(with_start(out.poses[0], push), push.h)])
    energy = kinetic_energy(grid, mass, twists)
    resting = energy < 1e-10
    assert np.all(np.diff(energy)[~resting[1:]] < 0)
    assert resting[-1]


@pytest.mark.parametrize("h", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("seed", range(4))
def test_an_object_that_hits_a_resting_finger_gains_no_energy(seed: int, h: float) -> None:
    rng = np.random.default_rng(seed)
    grid = rectangle(10, 6)
    maps = random_maps(rng, 60)
    twist = np.array([rng.uniform(0.3, 1.0), rng.normal(0, 0.2), rng.normal(0, 4)])
    tip = np.tile([0.05 + FINGER_RADIUS + 0.003, rng.uniform(-0.02, 0.02)], (round(0.3 / h) + 1, 1))
    push = finger_push(tip, h, start_twist=twist)
    out = Slider(grid, FINGER_RADIUS).rollout(maps, [push])
    poses = with_start(out.poses[0], push)
    assert np.linalg.norm(out.forces[0], axis=1).max() > 1.0
    kinetic = kinetic_energy(grid, maps.mass[0], np.vstack([twist, twists_between(poses, h)]))
    # The contact is a spring; what it holds counts too.
    stiffness = (maps.mass * maps.mu).sum() * GRAVITY / Smoothing().penetration
    depth = np.minimum(gaps_along(grid, poses, tip, FINGER_RADIUS), 0.0)
    energy = kinetic + 0.5 * stiffness * depth**2
    assert np.all(kinetic <= kinetic[0])
    assert np.all(np.diff(energy) <= 2e-3 * kinetic[0])


class TestStepHalving:
    """Errors fall in proportion to the step or faster."""

    grid = rectangle(10, 6)
    maps = random_maps(np.random.default_rng(4), 60, mu_finger=0.2)
    slider = Slider(grid, FINGER_RADIUS)

    def orders(self, push) -> np.ndarray:  # type: ignore[no-untyped-def]
        def run(refinement: int) -> np.ndarray:
            end = self.slider.rollout(self.maps, [push(0.02 / refinement)]).end[0, 0, :3]
            return end * [1, 1, 0.04]

        return orders_of_convergence(run, [1, 2, 4, 8], 128)

    def test_coasting(self) -> None:
        assert np.all(self.orders(lambda h: coast((0.8, 0.3, 6.0), 0.2, h)) > 0.9)

    def test_force(self) -> None:
        def push(h: float) -> Push:
            return drive(np.tile([6.0, 3.0, -0.03, 0.01, 0.02], (round(0.2 / h), 1)), h)

        assert np.all(self.orders(push) > 0.9)

    @pytest.mark.parametrize("angle", [0.0, 0.6])
    def test_finger(self, angle: float) -> None:
        # The object starts with the finger's velocity; blows have their own test.
        velocity = 0.05 * np.array([np.cos(angle), np.sin(angle)])

        def push(h: float) -> Push:
            return finger_push(line(FINGER_START, velocity, 1.2, h), h, start_twist=[*velocity, 0.0])

        assert np.all(self.orders(push) > 0.9)

    def test_blow(self) -> None:
        """A finger that starts against a resting object moves it equally far at any step length."""
        maps = Maps(self.maps.mass, np.full((1, 60), 0.05), self.maps.mu_finger)

        def pose(h: float) -> np.ndarray:
            push = finger_push(line(FINGER_START, (0.1, 0), 0.2, h), h)
            return self.slider.rollout(maps, [push]).poses[0, -1]

        reference = pose(1e-2)
        for h in (5e-3, 2e-3, 1e-3, 5e-4, 1e-4):
            assert pose(h)[0] == pytest.approx(reference[0], rel=0.01)
