"""Sensitivities of poses and forces against finite differences, in every contact state and at its kinks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from sliding_objects import (
    FINGER_RADIUS,
    GRAVITY,
    central_differences,
    coast,
    drive,
    finger_push,
    l_shape,
    line,
    parameter_slices,
    parameter_vector,
    random_maps,
    rectangle,
    rollout_at,
    rotation,
    to_object,
    touched_point,
    with_start,
)

from slipmap.models.effects.effect import Effect, Parameter
from slipmap.models.effects.symbols import smooth_step
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.rollout import Maps, Push, Slider

H = 0.01


@dataclass(frozen=True)
class Case:
    grid: CellGrid
    push: Push
    mu_finger: float
    finger: bool = True

    @property
    def maps(self) -> Maps:
        return random_maps(np.random.default_rng(11), len(self.grid), self.mu_finger)

    @property
    def slider(self) -> Slider:
        return Slider(self.grid, FINGER_RADIUS)


START = (0.02, -0.01, 0.3)


def from_the_left(height: float, angle: float, clearance: float, duration: float = 1.0) -> Push:
    """A finger that pushes the rectangle's left side in the object's own direction `angle`, at 5 cm/s."""
    local = np.array([-0.05 - FINGER_RADIUS - clearance, height])
    start = START[:2] + rotation(START[2]) @ local
    return finger_push(line(start, 0.05 * rotation(START[2] + angle)[:, 0], duration, H), H, start_pose=START)


def turning(push: Push) -> Push:
    """The push by a finger that turns by half a turn, faster and faster."""
    return replace(push, tip_angle=np.pi * np.linspace(0.0, 1.0, len(push.tip)) ** 2)


def made_and_lost() -> Push:
    """A finger that approaches the object in an arc, touches it, and leaves it again."""
    time = H * np.arange(101)
    local = np.column_stack([-0.075 + 0.03 * np.sin(np.pi * time), 0.01 + 0.03 * time])
    return finger_push(START[:2] + local @ rotation(START[2]).T, H, start_pose=START)


def caught_in_motion() -> Push:
    tip = line(START[:2] + rotation(START[2]) @ (0.062, 0.008), (-0.02, 0.03), 0.5, H)
    return finger_push(tip, H, start_pose=START, start_twist=np.array([0.4, -0.1, 2.0]))


def into_the_corner() -> Push:
    start = START[:2] + rotation(START[2]) @ (0.007, 0.0062)
    velocity = 0.04 * rotation(START[2] + np.pi + 0.6)[:, 0]
    return finger_push(line(start, velocity, 1.0, H), H, start_pose=START)


def wrench() -> Push:
    force = np.tile([5.0, 3.0, -0.03, 0.02, 0.05], (60, 1))
    force[40:] = 0
    return drive(force, H, start_pose=START, start_twist=(0.05, 0.02, -0.5))


BLOCK = rectangle(6, 4, 0.1 / 6)
COARSE = rectangle(5, 3, 0.02)
CASES = {
    "sliding": Case(BLOCK, from_the_left(0.01, 0.7, 2e-4), 0.1),
    "sticking": Case(BLOCK, from_the_left(0.01, 0.3, 2e-4), 1.0),
    "turning finger": Case(BLOCK, turning(from_the_left(0.01, 0.3, 2e-4)), 0.3),
    "round a corner": Case(BLOCK, from_the_left(0.03, 0.9, 2e-4), 0.3),
    "on a corner": Case(BLOCK, from_the_left(0.037, -0.8, -2e-3), 0.22),
    "made and lost": Case(COARSE, made_and_lost(), 0.3),
    "caught in motion": Case(BLOCK, caught_in_motion(), 0.3),
    "concave corner": Case(l_shape(), into_the_corner(), 0.2),
    "wrench": Case(BLOCK, wrench(), 0.3, finger=False),
    "fast spin": Case(COARSE, coast((0.5, -0.2, 60.0), 0.06, 2 * H, start_pose=START), 0.3, finger=False),
    "coasting": Case(COARSE, coast((0.5, -0.2, 4.0), 0.4, H, start_pose=START), 0.3, finger=False),
}
PARAMETER_STEPS = {"mass": 3e-6, "mu": 1e-4, "mu_finger": 1e-5, "start_pose": 3e-7, "start_twist": 1e-4}


def steps_of(n: int, scale: float = 1.0) -> np.ndarray:
    steps = np.empty(2 * n + 7)
    for name, place in parameter_slices(n).items():
        steps[place] = scale * PARAMETER_STEPS[name]
    return steps


def touching(case: Case) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each step: whether there is a force, its slope to the normal, its point (object frame)."""
    out = case.slider.rollout(case.maps, [case.push])
    poses = with_start(out.poses[0], case.push)
    slopes, places = [], []
    for k, force in enumerate(out.forces[0]):
        pose = 0.5 * (poses[k] + poses[k + 1])
        tip = 0.5 * (case.push.tip[k] + case.push.tip[k + 1])
        contact, normal = touched_point(case.grid, to_object(tip, pose))
        local = rotation(pose[2]).T @ force
        slopes.append(abs(local @ (-normal[1], normal[0])) / max(-local @ normal, 1e-12))
        places.append(contact)
    return np.linalg.norm(out.forces[0], axis=1) > 0, np.array(slopes), np.array(places)


def test_the_cases_are_what_they_are_called() -> None:
    held, slope, _ = touching(CASES["sliding"])
    assert np.mean(slope[held] > 0.099) > 0.8
    held, slope, _ = touching(CASES["sticking"])
    assert held.mean() > 0.9
    assert np.all(slope[held][5:] < 0.9)
    held, _, place = touching(CASES["round a corner"])
    on_corner = held & (place[:, 1] > 0.1 / 3 - 1e-9)
    assert (held & ~on_corner).sum() > 20
    assert on_corner.sum() > 5
    held, _, place = touching(CASES["on a corner"])
    assert held.sum() > 50
    assert np.all(place[held, 1] > 0.1 / 3 - 1e-9)
    held, _, _ = touching(CASES["made and lost"])
    assert not held[:5].any()
    assert held.sum() > 20
    assert not held[-5:].any()
    held, _, _ = touching(CASES["caught in motion"])
    assert not held[0]
    assert held.any()


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_sensitivities_are_the_central_differences(case: Case) -> None:
    slider, maps, push = case.slider, case.maps, case.push
    n = len(case.grid)
    out = slider.rollout(maps, [push], sensitivities=True)
    numeric = central_differences(slider, push, parameter_vector(maps, push), steps_of(n))
    check_groups("poses", slider.map_columns(maps, out.d_poses)[0], numeric[0], case)
    if case.finger:
        check_groups("forces", slider.map_columns(maps, out.d_forces)[0], numeric[1], case)


@pytest.mark.parametrize("cells", [2, 7, 8, 9, 17])
def test_sensitivities_for_any_number_of_cells(cells: int) -> None:
    grid = rectangle(cells, 1, 0.03)
    tip = line((-0.015 * cells - FINGER_RADIUS - 1e-4, -0.009), (0.03, 0.06), 0.3, H)
    test_sensitivities_are_the_central_differences(Case(grid, finger_push(tip, H), 0.1))


def test_sensitivities_of_a_single_cell() -> None:
    push = drive(np.tile([0.15, 0.05, 0.01, 0.0, 0.001], (30, 1)), H)
    test_sensitivities_are_the_central_differences(Case(rectangle(1, 1, 0.03), push, 0.3, finger=False))


def check_groups(name: str, analytic: np.ndarray, numeric: np.ndarray, case: Case) -> None:
    """Check each group of parameters to a millionth of its largest derivative."""
    for group, place in parameter_slices(len(case.grid)).items():
        if group == "mu_finger" and (not case.finger or case is CASES["sticking"]):
            assert np.all(analytic[..., place] == 0)
            continue
        size = np.abs(numeric[..., place]).max()
        error = np.abs(analytic - numeric)[..., place].max()
        assert size > 1e-6, f"{name} do not depend on {group}"
        assert error <= 1e-6 * size, f"{name} by {group}: {error / size:.1e}"


@pytest.mark.parametrize("name", ["sliding", "caught in motion", "coasting"])
def test_reduced_columns_of_the_inertia(name: str) -> None:
    """Mass added at constant friction load changes only m, s_x, s_y and J."""
    case = CASES[name]
    slider, maps, push = case.slider, case.maps, case.push
    n = len(case.grid)
    steps = steps_of(n)[:n]
    at = parameter_vector(maps, push)

    def shifted(k: int) -> np.ndarray:
        parameters = np.tile(at, (n, 1))
        parameters[:, :n] += k * np.diag(steps)
        parameters[:, n : 2 * n] *= at[:n] / parameters[:, :n]
        return rollout_at(slider, push, parameters).poses

    numeric = np.moveaxis(8 * (shifted(1) - shifted(-1)) - (shifted(2) - shifted(-2)), 0, -1) / (12 * steps)
    reduced = slider.rollout(maps, [push], sensitivities=True).d_poses[0]
    assert reduced.shape[-1] == slider.columns
    x, y = case.grid.centers.T
    second = x**2 + y**2 + case.grid.width**2 / 6
    by_inertia = np.linalg.lstsq(np.column_stack([np.ones(n), x, y, second]), numeric.reshape(-1, n).T)[0]
    for column in range(4):
        expected = by_inertia[column].reshape(numeric.shape[:2])
        error = np.abs(reduced[..., n + column] - expected).max()
        assert error <= 1e-5 * np.abs(expected).max()
    # And the loads: through friction only, which acts through f_i = mu_i m_i g.
    by_mu = slider.map_columns(maps, reduced[None])[0, ..., n : 2 * n]
    assert by_mu == pytest.approx(reduced[..., :n] * maps.mass[0] * GRAVITY)


@pytest.mark.parametrize("seed", [33, 54])
def test_sensitivities_of_an_object_that_holds_against_a_small_force(seed: int) -> None:
    """Creep below the slip speed, where friction is a stiff drag."""
    rng = np.random.default_rng(seed)
    grid = BLOCK
    n = len(grid)
    maps = random_maps(rng, n)
    load = float((maps.mass * maps.mu).sum()) * GRAVITY
    wave = np.sin(np.arange(30) * rng.uniform(0.01, 0.6))
    force = np.outer(wave, [0.5 * load, 0.15 * load, 0, 0, 0])
    force[:, 2:4] = rng.uniform(-0.02, 0.02, 2)
    push = drive(force, 10 ** rng.uniform(-3, -1.5))
    slider = Slider(grid, FINGER_RADIUS)
    out = slider.rollout(maps, [push], sensitivities=True)
    at = parameter_vector(maps, push)
    numeric, _ = central_differences(slider, push, at, np.where(at > 0, 3e-4 * at, 1e-6))
    place = slice(0, 2 * n)
    error = np.abs(slider.map_columns(maps, out.d_poses)[0] - numeric)[..., place].max(axis=(0, 1))
    assert np.all(error <= 1e-5 * np.abs(numeric[..., place]).max(axis=(0, 1)))


class TestKinks:
    """On the border of two contact states, derivatives are those of the state of the solution."""

    @staticmethod
    def one_sided(slider: Slider, push: Push, at: np.ndarray, column: int, step: float) -> np.ndarray:
        """(S, 3) difference quotient towards the sign of `step`, exact to second order."""
        shifts = np.zeros((3, len(at)))
        shifts[:, column] = 0, step, 2 * step
        here, near, far = rollout_at(slider, push, at + shifts).poses
        return (4 * near - far - 3 * here) / (2 * step)

    @staticmethod
    def touch(clearance: float) -> tuple[Slider, Maps, Push]:
        """One step that leaves `clearance` between finger and object; all numbers are exact in binary."""
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 2.0**-5
        grid = CellGrid(corners / 2, 2.0**-5, corners)
        radius = 2.0**-7
        end = -(2.0**-5) - radius - clearance
        push = Push(2.0**-6, np.array([[end - 2.0**-10, 0.0], [end, 0.0]]), np.zeros(3))
        return Slider(grid, radius), Maps(np.full(4, 0.0625), np.full(4, 0.5), np.array([0.25])), push

    def derivatives_at_touch(self, clearance: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """d x / d(start x, start v_x): analytic, with more contact, and with less."""
        slider, maps, push = self.touch(clearance)
        at = parameter_vector(maps, push)
        place = parameter_slices(4)
        columns = place["start_pose"].start, place["start_twist"].start
        out = slider.rollout(maps, [push], sensitivities=True)
        analytic = slider.map_columns(maps, out.d_poses)[0, 0, 0, list(columns)]
        nearer, away = (
            np.array(
                [
                    self.one_sided(slider, push, at, c, sign * s)[0, 0]
                    for c, s in zip(columns, (1e-9, 1e-7), strict=True)
                ]
            )
            for sign in (-1, 1)
        )
        return analytic, nearer, away

    def test_just_before_and_just_after_the_instant_of_contact(self) -> None:
        _, nearer, away = self.derivatives_at_touch(0.0)
        assert np.all(np.abs(nearer / away - 1) > 0.01)
        assert self.derivatives_at_touch(2.0**-50)[0] == pytest.approx(away, rel=1e-5)
        assert self.derivatives_at_touch(-(2.0**-50))[0] == pytest.approx(nearer, rel=1e-5)

    def test_the_very_instant_of_contact(self) -> None:
        analytic, nearer, away = self.derivatives_at_touch(0.0)
        errors = [np.abs(analytic / side - 1).max() for side in (nearer, away)]
        assert min(errors) < 1e-5

    def test_border_of_sticking_and_sliding(self) -> None:
        slider, push = Slider(BLOCK, FINGER_RADIUS), from_the_left(0.01, 0.6, -1e-6, duration=2 * H)
        n = len(BLOCK)
        column = parameter_slices(n)["mu_finger"].start

        def by_friction(mu_finger: float) -> tuple[np.ndarray, np.ndarray]:
            maps = random_maps(np.random.default_rng(11), n, mu_finger)
            out = slider.rollout(maps, [push], sensitivities=True)
            return slider.map_columns(maps, out.d_poses)[0, :, :, column], parameter_vector(maps, push)

        slides, sticks = 0.0, 2.0
        assert np.any(by_friction(slides)[0][0] != 0)
        while True:
            middle = 0.5 * (slides + sticks)
            if middle in (slides, sticks):
                break
            if np.all(by_friction(middle)[0][0] == 0):
                sticks = middle
            else:
                slides = middle
        # Neighbouring numbers: nothing lies between them.
        assert np.nextafter(slides, 2.0) == sticks
        at = by_friction(sticks)[1]
        jump = np.abs(self.one_sided(slider, push, at, column, -1e-5)[0]).max()
        assert jump > 1e-5
        for mu_finger, step in ((slides, -1e-5), (sticks, 1e-5)):
            analytic, at = by_friction(mu_finger)
            numeric = self.one_sided(slider, push, at, column, step)[0]
            assert analytic[0] == pytest.approx(numeric, abs=1e-5 * jump)


class Gust(Effect):
    """Pulls only after three seconds."""

    name = "gust"
    sentence = "Wind."
    parameters = (Parameter("size", "N", "of the force", -5.0, 5.0, 0.2, 0.0),)

    def force(self, body: Any, p: Any) -> Any:
        return p.size * smooth_step(body.time - 3.0, 0.01), 0, 0


@pytest.mark.parametrize("effect", [None, "table_tilt", "load_transfer", "skate", Gust()], ids=str)
def test_rest_is_skipped_without_a_trace(effect: Effect | str | None) -> None:
    away = np.tile([-0.2, 0.0], (100, 1))
    pushed = from_the_left(0.01, 0.7, 2e-4)
    push = finger_push(np.vstack([away, pushed.tip, away, pushed.tip[-20:], away]), H, start_pose=START)
    # Applied forces, though zero, are reason enough to solve each step.
    solved = replace(push, wrench=np.zeros((len(push.tip) - 1, 5)))
    slider = Slider(BLOCK, FINGER_RADIUS, effects=[] if effect is None else [effect])
    maps = CASES["sliding"].maps
    skipping, thorough = (slider.rollout(maps, [one], sensitivities=True) for one in (push, solved))
    for name in ("poses", "forces", "end", "d_poses", "d_forces"):
        own, wanted = getattr(skipping, name), getattr(thorough, name)
        np.testing.assert_allclose(own, wanted, rtol=0, atol=1e-13 * max(1.0, np.abs(wanted).max()))
    fewer = thorough.evaluations - skipping.evaluations
    assert fewer.item() > 150 if effect != "table_tilt" else fewer.item() == 0
