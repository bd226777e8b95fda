"""Candidate pushes: where they touch, that nothing is touched before, and how the finger moves."""

from __future__ import annotations

import numpy as np
import pytest

from slipmap.models.objects import cells_from_polygon, contour_cells
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.planners.exploration import DESCENT, Candidate, NoReachablePush, candidate_pushes
from tests.models.physics.sliding_objects import signed_distances

RADIUS = 0.006


def rectangle() -> CellGrid:
    return cells_from_polygon(np.array([[-3, -2], [3, -2], [3, 2], [-3, 2]]) * 0.01, width=0.01)


def fork(slot: float = 0.01) -> CellGrid:
    """Two prongs with a slot between them; a finger of 6 mm radius does not fit into one of 10 mm."""
    a = slot / 0.02
    corners = [(-2.5, -4), (2.5, -4), (2.5, 4), (a, 4), (a, -1), (-a, -1), (-a, 4), (-2.5, 4)]
    return cells_from_polygon(np.array(corners) * 0.01, width=0.01)


def frame(opening: float = 0.05) -> CellGrid:
    """A square of 8 cm with a square opening around its middle."""
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    return cells_from_polygon(0.08 * square, [opening * square], width=0.01)


def finger_places(candidate: Candidate, count: int = 200) -> np.ndarray:
    """Centres of the finger on its way to first touch, the last one there."""
    back = np.linspace(candidate.approach, 0.0, count)
    return candidate.touch - back[:, None] * candidate.direction


@pytest.mark.parametrize("grid", [rectangle(), fork(), frame()], ids=["rectangle", "fork", "frame"])
def test_finger_touches_first_at_the_contact_point(grid):
    for candidate in candidate_pushes(grid, RADIUS, np.random.default_rng(1), 60):
        gaps = signed_distances(grid, finger_places(candidate)) - RADIUS
        assert gaps[-1] == pytest.approx(0.0, abs=1e-9)
        assert (gaps[:-1] > 0.0).all()
        assert np.linalg.norm(candidate.touch - candidate.contact) == pytest.approx(RADIUS)


def test_finger_does_not_go_where_it_does_not_fit():
    grid = fork()
    points = np.array(
        [candidate.contact for candidate in candidate_pushes(grid, RADIUS, np.random.default_rng(2), 80)]
    )
    in_slot = (np.abs(points[:, 0]) < 0.0051) & (points[:, 1] < 0.0399)
    assert not in_slot[points[:, 1] > -0.0399].any()
    wide = candidate_pushes(fork(slot=0.03), RADIUS, np.random.default_rng(2), 80)
    assert any(abs(c.contact[0]) < 0.0151 and abs(c.contact[1]) < 0.039 for c in wide)


@pytest.mark.parametrize(("opening", "inside"), [(0.05, True), (0.025, False)])
def test_the_finger_pushes_from_inside_openings_in_which_it_can_come_down(opening, inside):
    grid = frame(opening)
    pushes = candidate_pushes(grid, RADIUS, np.random.default_rng(2), 80)
    begins = np.array([finger_places(candidate)[0] for candidate in pushes])
    assert (np.abs(begins).max(axis=1) < 0.025).any() == inside
    assert signed_distances(grid, begins).min() > RADIUS + DESCENT - 1e-8
    outwards = [c for c in pushes if c.contact @ c.direction > 0.0]
    assert bool(outwards) == inside and all(np.abs(c.contact).max() < 0.0251 for c in outwards)


def test_the_finger_comes_down_with_room_around_it():
    """Beside a prong that is seen a little off it must not come down on it."""
    grid = fork(slot=0.024)
    pushes = candidate_pushes(grid, 0.006, np.random.default_rng(3), 200, approach=0.015)
    begins = np.array([finger_places(candidate)[0] for candidate in pushes])
    assert signed_distances(grid, begins).min() > 0.006 + DESCENT - 1e-8
    touches = np.array([finger_places(candidate)[-1] for candidate in pushes])
    assert signed_distances(grid, touches).max() < 0.006 + 1e-8


def test_directions_fill_the_cone_about_the_inward_normal():
    grid = rectangle()
    angles = []
    for candidate in candidate_pushes(grid, RADIUS, np.random.default_rng(3), 400, cone=0.5):
        x, y = candidate.contact
        inward = np.array([-np.sign(x), 0.0]) if abs(abs(x) - 0.03) < 1e-9 else np.array([0.0, -np.sign(y)])
        angles.append(np.arctan2(inward[0] * candidate.direction[1] - inward[1] * candidate.direction[0],
                                 inward @ candidate.direction))  # fmt: skip
    assert np.abs(angles).max() <= 0.5
    assert np.histogram(angles, bins=4, range=(-0.5, 0.5))[0].min() > 60


def test_every_contour_cell_has_its_turn_before_one_comes_again():
    grid = rectangle()
    cells, _, _ = contour_cells(grid)
    drawn = [
        candidate.cell
        for candidate in candidate_pushes(grid, RADIUS, np.random.default_rng(4), 2 * len(cells))
    ]
    assert sorted(drawn[: len(cells)]) == sorted(drawn[len(cells) :]) == sorted(cells)
    assert drawn[: len(cells)] != drawn[len(cells) :]


def test_a_seed_gives_the_same_pushes_and_another_seed_others():
    first, again, other = (
        [
            (c.cell, *c.direction, c.length, c.speed)
            for c in candidate_pushes(rectangle(), RADIUS, np.random.default_rng(s), 9)
        ]
        for s in (5, 5, 6)
    )
    assert first == again
    assert first != other


@pytest.mark.parametrize("count", [1, 7, 23])
def test_there_are_as_many_pushes_as_asked_for(count):
    assert len(candidate_pushes(rectangle(), RADIUS, np.random.default_rng(10), count)) == count


def test_lengths_and_speeds_lie_in_their_ranges():
    pushes = candidate_pushes(
        rectangle(), RADIUS, np.random.default_rng(7), 200, length=(0.02, 0.03), speed=(0.1, 0.2)
    )
    lengths, speeds = np.array([(c.length, c.speed) for c in pushes]).T
    assert 0.02 <= lengths.min() < 0.021 and 0.029 < lengths.max() <= 0.03
    assert 0.1 <= speeds.min() < 0.105 and 0.195 < speeds.max() <= 0.2


@pytest.mark.parametrize("speed", [0.05, 0.6])
def test_finger_starts_and_stops_at_rest_and_goes_its_way(speed):
    """At 0.6 m/s the way is too short for the full ramps, at 0.05 m/s it is not."""
    pose = np.array([0.2, -0.1, 0.7])
    candidate = candidate_pushes(
        rectangle(), RADIUS, np.random.default_rng(8), 1, length=(0.04, 0.04), speed=(speed, speed)
    )[0]
    push = candidate.push(pose, h=1e-3, ramp=0.1, rest=0.2)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    turned = np.array([[c, -s], [s, c]])
    begin = turned @ (candidate.touch - candidate.approach * candidate.direction) + pose[:2]
    end = turned @ (candidate.touch + candidate.length * candidate.direction) + pose[:2]
    steps = np.hypot(*np.diff(push.tip, axis=0).T) / push.h
    np.testing.assert_allclose(push.tip[:200], np.tile(begin, (200, 1)), atol=1e-12)
    np.testing.assert_allclose(push.tip[-200:], np.tile(end, (200, 1)), atol=1e-12)
    assert steps.max() <= speed * (1 + 1e-9)
    assert steps.max() == pytest.approx(speed, rel=0.02)
    assert np.abs(np.diff(steps)).max() <= 1.01 * speed * push.h / min(0.1, 0.05 / speed)
    np.testing.assert_array_equal(push.start_pose, pose)


def test_object_rests_until_the_finger_arrives_and_moves_then():
    grid = fork()
    slider = Slider(grid, RADIUS)
    maps = Maps(np.full(len(grid), 0.01), np.full(len(grid), 0.3), np.array([0.3]))
    for candidate in candidate_pushes(grid, RADIUS, np.random.default_rng(9), 6):
        push = candidate.push([0.0, 0.0, 0.3])
        poses = slider.rollout(maps, [push]).poses[0]
        way = np.hypot(*(push.tip[1:] - push.tip[0]).T)
        before = way < candidate.approach - 1e-4
        assert np.abs(poses[before] - push.start_pose).max() < 1e-9
        assert np.abs(poses[-1] - push.start_pose).max() > 0.005


def test_a_finger_that_fits_nowhere_is_refused():
    """One cell in the waist of a star: its only contact point lies between the star's long tips."""
    angle = np.arange(8) * np.pi / 4
    star = np.column_stack([np.cos(angle), np.sin(angle)]) * np.where(np.arange(8) % 2, 0.01, 0.06)[:, None]
    with pytest.raises(NoReachablePush, match=r"radius 0\.5 m reaches none of 1 contour cells"):
        candidate_pushes(cells_from_polygon(star, count=1), 0.5, np.random.default_rng(0), 3)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"count": 0}, "count"),
        ({"count": 1.5}, "count must be a whole number"),
        ({"finger_radius": -1.0}, "finger_radius"),
        ({"finger_radius": 8.0}, r"finger_radius is 8 m; no finger is that thick, divide by 1000\?"),
        ({"approach": np.nan}, "approach"),
        ({"length": (0.2, 0.1)}, "length"),
        ({"speed": (0.0, 0.1)}, "speed"),
        ({"cone": np.pi}, "cone"),
    ],
)
def test_numbers_out_of_range_are_named(change, named):
    arguments = {"finger_radius": RADIUS, "count": 1} | change
    with pytest.raises(ValueError, match=named):
        candidate_pushes(rectangle(), rng=np.random.default_rng(0), **arguments)


@pytest.mark.parametrize("pose", [[np.nan, 0.0, 0.0], [0.0, 0.0]])
def test_a_candidate_is_pushed_at_a_pose_only(pose):
    (candidate,) = candidate_pushes(rectangle(), RADIUS, np.random.default_rng(0), 1)
    with pytest.raises(ValueError, match=r"push: pose must be (finite|of shape \(3,\)), got"):
        candidate.push(pose)


def test_a_seed_is_not_a_generator():
    with pytest.raises(TypeError, match=r"rng must be a Generator, such as np\.random\.default_rng"):
        candidate_pushes(rectangle(), RADIUS, 0, 1)
