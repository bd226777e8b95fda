from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from slipmap.models.perception import edge_kernels
from slipmap.models.perception.first_look import _angle_shown, _standing_object, first_look
from slipmap.models.perception.object_mask import HeightPicture
from slipmap.models.perception.pinhole_camera import pixel_size
from slipmap.models.perception.pose_tracking import load_kernels, track

ELL = ((-0.1, -0.06, 0.1, 0.0, 0.03), (-0.1, 0.0, -0.03, 0.08, 0.09))
WRENCH = ((-0.12, -0.008, 0.12, 0.008, 0.008), (0.09, -0.02, 0.13, 0.02, 0.008))
TWO_LEVELS = ((-0.1, -0.05, 0.0, 0.05, 0.03), (0.0, -0.05, 0.1, 0.05, 0.04))
HAMMER = ((-0.16, -0.014, 0.1, 0.014, 0.025), (0.1, -0.05, 0.14, 0.05, 0.03))
BLOCK = ((-0.1, -0.05, 0.1, 0.05, 0.04),)


def pose_of_frame(seen, first, pose):
    """True pose of the seen object's frame when the boxes' frame has moved from one pose to another."""
    turn = pose[2] - first[2]
    c, s = np.cos(turn), np.sin(turn)
    arm = seen.first_pose[:2] - first[:2]
    return np.array([*(np.array([[c, -s], [s, c]]) @ arm + pose[:2]), turn + seen.first_pose[2]])


def errors(scene, seen, boxes, first, pose, start, seed):
    rng = np.random.default_rng(seed)
    truth = pose_of_frame(seen, np.array(first), np.array(pose))
    observed = track(scene.noisy(scene.depth(boxes, pose), rng), scene.view, seen, truth + start)
    assert observed.valid, observed.reason
    error = observed.pose - truth
    error[2] = (error[2] + np.pi) % (2 * np.pi) - np.pi
    return error, observed


@pytest.mark.parametrize("boxes", [ELL, WRENCH], ids=["tall", "8 mm"])
def test_poses_all_over_the_table_within_a_millimetre_and_half_a_degree(scene, look, boxes):
    first = (0.01, -0.02, 0.3)
    seen = look(boxes, first)
    rng = np.random.default_rng(5)
    found, misfit = [], []
    for k in range(20):
        radius, direction = 0.3 * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi)
        pose = (radius * np.cos(direction), radius * np.sin(direction), rng.uniform(-np.pi, np.pi))
        start = rng.uniform(-1, 1, 3) * [0.01, 0.01, 0.08]
        error, observed = errors(scene, seen, boxes, first, pose, start, k)
        found.append([np.hypot(*error[:2]), abs(error[2])])
        misfit.append(error @ np.linalg.solve(observed.covariance, error))
    position, angle = np.percentile(found, 95, axis=0)
    assert position < 1e-3
    assert angle < np.deg2rad(0.5)
    assert np.mean(misfit) < 6  # 3 if the covariance were exact


def test_height_errors_count_less_on_steep_walls(scene, look):
    """As inside a bowl: there, edges that scatter by half a pixel change heights by millimetres."""
    level = look(BLOCK, (0.0, 0.0, 0.0))
    steep = replace(level, inner_slopes=np.full_like(level.inner_slopes, 2.0))
    higher = scene.depth(((*BLOCK[0][:4], BLOCK[0][4] + 3e-3),), (0.0, 0.0, 0.0))
    picture = HeightPicture(level.table.heights(scene.view.checked_depth(higher), scene.view))
    pose, pixel = level.first_pose[None], pixel_size(scene.view)
    flat, walls = (
        edge_kernels.mean_misfits(picture, scene.view.lens, seen.shape, pose, pixel, 1)[0, 0]
        for seen in (level, steep)
    )
    assert flat > 0.15 and walls < 0.5 * flat


def test_a_turn_of_90_degrees_between_two_looks_is_found(scene, look):
    first = (0.0, 0.0, 0.3)
    seen = look(ELL, first)
    error, _ = errors(scene, seen, ELL, first, (0.12, 0.1, 1.0), np.array([-0.1, 0.08, np.pi / 2]), 1)
    assert np.hypot(*error[:2]) < 1.5e-3
    assert abs(error[2]) < np.deg2rad(0.7)


def test_heights_tell_the_ends_of_a_symmetric_outline_apart(scene, look):
    first = (0.0, 0.0, 0.0)
    seen = look(TWO_LEVELS, first)
    error, _ = errors(scene, seen, TWO_LEVELS, first, (0.05, 0.02, 0.5), np.array([0.0, 0.0, np.pi - 0.2]), 1)
    assert abs(error[2]) < np.deg2rad(0.7)


def test_of_two_poses_that_look_alike_the_nearer_is_taken(scene, look):
    first = (0.0, 0.0, 0.0)
    seen = look(BLOCK, first)
    image = scene.depth(BLOCK, (0.05, 0.02, 0.5))
    for theta in (0.9, 0.9 - np.pi, 0.9 + 4 * np.pi):
        observed = track(image, scene.view, seen, np.array([0.0, 0.1, theta]))
        assert observed.valid
        assert observed.pose[2] == pytest.approx(theta - 0.4, abs=0.01)


def test_a_bar_under_the_arm_is_not_found_the_other_way_round(scene, look):
    """It turned by less than a quarter turn since it was last seen; fits from afar need not settle."""
    bar, first = ((-0.18, -0.035, 0.18, 0.035, 0.07),), (0.0, 0.0, 0.2)
    seen = look(bar, first)
    rng = np.random.default_rng(8)
    rows, columns = np.indices((480, 640))
    found = 0
    for _ in range(40):
        pose = (*rng.uniform(-0.15, 0.15, 2), rng.uniform(-np.pi, np.pi))
        along = rng.choice([-1, 1]) * rng.uniform(0.06, 0.12)
        u, v = scene.view.project(
            np.array([pose[0] + along * np.cos(pose[2]), pose[1] + along * np.sin(pose[2]), 0.03])
        )[0]
        arm = np.hypot(columns - u, rows - v) < rng.uniform(30, 45)
        image = scene.noisy(scene.depth(bar, pose), rng)
        image[arm] = 0.6
        truth = pose_of_frame(seen, np.array(first), np.array(pose))
        previous = truth + np.array([0.08, -0.05, rng.uniform(0.5, 1.3)])
        observed = track(image, scene.view, seen, previous, arm)
        if observed.valid:
            found += 1
            assert np.abs(observed.pose - truth).max() < 0.1
    assert found >= 20


def test_an_arm_over_part_of_the_object_does_not_move_it(scene, look):
    first = (0.0, 0.0, 0.3)
    seen = look(ELL, first)
    depth = scene.depth(ELL, (0.05, 0.0, 0.3))
    depth[:, 305:325] = 0.5
    arm = np.zeros(depth.shape, bool)
    arm[:, 300:330] = True
    truth = pose_of_frame(seen, np.array(first), np.array([0.05, 0.0, 0.3]))
    observed = track(depth, scene.view, seen, truth + np.array([0.004, -0.004, 0.03]), arm)
    assert observed.valid
    assert np.hypot(*(observed.pose - truth)[:2]) < 1e-3
    unmasked = track(depth, scene.view, seen, truth)
    assert not unmasked.valid or np.hypot(*(unmasked.pose - truth)[:2]) < 1e-3


LAST = np.array([0.0, 0.3, 2.0])
"""A pose that tells nothing of where the hammer is now."""


def off_under_the_arm(scene, look, draw, count, seed):
    """(k,) errors of position, m, of the hammers of `count` that are found under the arm.

    `draw(rng)` gives the boxes' pose, where on their long axis the arm is, m, the arm's radius, pixels, and
    the previous pose: relative to the true one where it is a tuple.
    """
    first = (0.0, 0.0, 0.2)
    seen = look(HAMMER, first)
    rng = np.random.default_rng(seed)
    rows, columns = np.indices((480, 640))
    off = []
    for _ in range(count):
        pose, along, radius, previous = draw(rng)
        at = [pose[0] + along * np.cos(pose[2]), pose[1] + along * np.sin(pose[2]), 0.03]
        u, v = scene.view.project(np.array(at))[0]
        arm = np.hypot(columns - u, rows - v) < radius
        image = scene.noisy(scene.depth(HAMMER, pose), rng)
        image[arm] = 0.6
        truth = pose_of_frame(seen, np.array(first), np.array(pose))
        start = truth + previous if isinstance(previous, tuple) else previous
        observed = track(image, scene.view, seen, start, arm)
        if observed.valid:
            off.append(np.hypot(*(observed.pose - truth)[:2]))
    return np.array(off)


def test_a_handle_is_not_taken_for_itself_farther_along(scene, look):
    """An object that a tap has carried on by some centimetres, its head under the arm."""

    def draw(rng):
        pose = (*rng.uniform(-0.15, 0.15, 2), rng.uniform(-np.pi, np.pi))
        far = rng.choice([-1, 1]) * rng.uniform(0.02, 0.05)
        return pose, 0.11, rng.uniform(30, 45), (far * np.cos(pose[2]), far * np.sin(pose[2]), 0.0)

    off = off_under_the_arm(scene, look, draw, 40, seed=11)
    assert len(off) >= 30
    assert np.max(off) < 3e-3


def test_a_bar_that_moved_along_itself_leaves_no_end_uncovered(scene, look):
    """The arm hides one end; a pose farther under it would explain all but the other end."""
    bar, first = ((-0.07, -0.012, 0.07, 0.012, 0.06),), np.array([-0.1, 0.0, 0.8])
    seen, along = look(bar, tuple(first)), np.array([np.cos(0.8), np.sin(0.8)])
    rng = np.random.default_rng(3)
    depth = -scene.view.p_WC[2] / scene.rays[..., 2]
    from_bar = ((scene.view.p_WC + depth[..., None] * scene.rays)[..., :2] - first[:2]) @ along
    for far in (-0.04, -0.03, -0.02, 0.02, 0.03, 0.04, 0.05):
        beyond = (from_bar - far) * -np.sign(far)
        for hidden in (0.005, 0.015, 0.03):
            arm = (beyond > 0.074 - hidden) & (beyond < 0.16)
            image = scene.noisy(scene.depth(bar, (*(first[:2] + far * along), 0.8)), rng)
            image[arm] = 0.9
            observed = track(image, scene.view, seen, seen.first_pose, arm)
            assert not observed.valid or np.hypot(*(observed.pose - seen.first_pose)[:2] - far * along) < 3e-3


def test_an_object_that_went_far_is_found_where_its_end_is_beyond_the_picture(scene, look):
    def draw(rng):
        return (rng.uniform(-0.15, 0.15), -0.42, rng.uniform(-1.8, -1.3)), 0.0, 0, LAST

    off = off_under_the_arm(scene, look, draw, 20, seed=5)
    assert len(off) == 20
    assert np.max(off) < 2e-3


def test_an_object_that_went_far_is_found_where_the_arm_hides_much_of_it(scene, look):
    """So much that the middle of what is seen is not where the object is."""

    def draw(rng):
        pose = (*rng.uniform(-0.2, 0.2, 2), rng.uniform(-np.pi, np.pi))
        return pose, rng.uniform(-0.16, 0.14), rng.uniform(30, 40), LAST

    off = off_under_the_arm(scene, look, draw, 30, seed=7)
    assert len(off) >= 12  # 4 if it is looked for around the middle of what is seen alone
    assert np.max(off) < 2e-3


def test_nothing_is_compiled_once_the_kernels_are_loaded(scene, look):
    load_kernels()
    seen = look(BLOCK, (0.0, 0.0, 0.0))
    assert track(scene.depth(BLOCK, (0.01, 0.0, 0.1)), scene.view, seen, seen.first_pose).valid
    for name in ("lines_across", "edges_expected", "edges_found", "heights_off", "mean_misfits"):
        assert len(getattr(edge_kernels, name).signatures) == 1, name


def test_what_cannot_be_seen_is_said(scene, look):
    seen = look(ELL, (0.0, 0.0, 0.3))
    last = seen.first_pose
    arm = np.zeros((480, 640), bool)
    arm[120:360, 200:440] = True
    hidden = track(scene.depth(ELL, (0.0, 0.0, 0.3)), scene.view, seen, last, arm, time=2.0)
    assert (hidden.valid, hidden.reason, hidden.time) == (False, "occluded", 2.0)
    assert np.all(np.isnan(hidden.pose))
    gone = track(scene.depth((), (0, 0, 0)), scene.view, seen, last)
    assert (gone.valid, gone.reason) == (False, "left the table")
    other = track(scene.depth(((-0.03, -0.03, 0.03, 0.03, 0.05),), (0.1, 0.1, 0.0)), scene.view, seen, last)
    assert (other.valid, other.reason) == (False, "no object")
    assert "it left the table" in gone.why and "does not fit the outline" in other.why


def test_a_previous_pose_that_is_not_a_number_is_refused(scene, look):
    seen = look(ELL, (0.0, 0.0, 0.3))
    with pytest.raises(ValueError, match="previous pose"):
        track(scene.depth(ELL, (0, 0, 0)), scene.view, seen, np.full(3, np.nan))


def strips(radius, lobe=0.0, count=0):
    """About what a polar curve encloses, 40 mm high."""
    angles = np.linspace(0, 2 * np.pi, 400)
    r = radius + lobe * np.cos(count * angles)
    x, y = r * np.cos(angles), r * np.sin(angles)
    edges = np.linspace(-radius - lobe, radius + lobe, 81)
    inside = [np.abs(y[(x >= low) & (x <= high)]) for low, high in pairwise(edges)]
    return tuple(
        (low, -half.max(), high, half.max(), 0.04)
        for (low, high), half in zip(pairwise(edges), inside, strict=True)
        if len(half)
    )


@pytest.mark.parametrize("radius", [0.03, 0.09])
def test_the_angle_of_a_round_object_is_held(scene, look, radius):
    can = strips(radius)
    seen = look(can, (0.0, 0.0, 0.3))
    assert not seen.angle_seen and seen.first_pose[2] == 0.0
    last = seen.first_pose
    for k, pose in enumerate([(0.02, 0.01, 0.9), (0.04, -0.02, 1.7), (0.2, 0.2, -2.0)]):
        observed = track(
            scene.noisy(scene.depth(can, pose), np.random.default_rng(k)), scene.view, seen, last
        )
        assert observed.valid and observed.pose[2] == 0.0
        np.testing.assert_allclose(observed.pose[:2] - seen.first_pose[:2], pose[:2], atol=1e-3)
        assert observed.covariance[2, 2] >= 1.0 and np.linalg.eigvalsh(observed.covariance).min() > 0
        last = observed.pose


def test_the_angle_of_what_is_not_seen_is_not_held(scene):
    """A picture in which no reading is left cannot show that the object is round."""
    depth = scene.depth(strips(0.03), (0.0, 0.0, 0.3))
    table, raw, heights, mask = _standing_object(depth, scene.view, None)
    assert not _angle_shown(mask, raw, heights, table, scene.view)
    assert _angle_shown(mask, raw, np.full_like(heights, np.nan), table, scene.view)


# Surfaces of round objects from above and from below: radii and heights, m.
BOWL = (
    [[0, 0.025, 0.045, 0.068, 0.0775, 0.0805, 0.0806], [5e-3, 5e-3, 0.014, 0.037, 0.055, 0.055, -1]],
    [[0, 0.03, 0.046, 0.07, 0.0806, 0.0807], [0, 0, 8e-3, 0.034, 0.054, 1]],
)
CAN = [[0, 0.035, 0.0351], [0.1, 0.1, -1]], [[0, 0.0351, 0.0352], [0, 0, 1]]
RING = [[0, 0.0349, 0.035, 0.07, 0.0701], [-1, -1, 0.03, 0.03, -1]], [[0, 0.0701, 0.0702], [0, 0, 1]]
PLATE = (
    [[0, 0.065, 0.1, 0.101, 0.1011], [6e-3, 6e-3, 0.024, 0.024, -1]],
    [[0, 0.066, 0.101, 0.1011], [0, 0, 0.02, 1]],
)


def turned_shape(scene, shape, pose, longer=0.0, lobe=0.0):
    """Depth picture of a round shape, made longer than wide by a share, or given four lobes (m)."""
    top, bottom = shape
    size, high = top[0][-1] * (1 + longer) + lobe, max(top[1])
    depth = scene.depth((), (0.0, 0.0, 0.0))
    corners = [(x, y, z) for x in (-size, size) for y in (-size, size) for z in (0.0, high)]
    there = scene.around(np.add(corners, [*pose[:2], 0.0]))
    seen, rays, start = depth[there], scene.rays[there], scene.view.p_WC
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for z in np.arange(0.0, high + 2e-4, 5e-4):  # upwards: the highest place on a ray is seen
        along = (z - start[2]) / rays[..., 2]
        x, y = np.moveaxis(start[:2] + along[..., None] * rays[..., :2] - pose[:2], -1, 0)
        x, y = (c * x + s * y) / np.sqrt(1 + longer), (c * y - s * x) * np.sqrt(1 + longer)
        radius = np.hypot(x, y)
        if lobe:
            radius /= 1 + lobe / top[0][-1] * np.cos(4 * np.arctan2(y, x))
        inside = (np.interp(radius, *top) >= z) & (np.interp(radius, *bottom) <= z)
        seen[inside] = along[inside]
    return depth


def slid(scene, shape, first, rng, **form):
    """What is seen of a shape at a place (2,), and errors (k, 3) of its poses as it slides and turns."""
    first = np.array([*first, 0.4])
    picture = turned_shape(scene, shape, first, **form)
    seen = first_look([scene.noisy(picture, rng) for _ in range(5)], scene.view)
    last, errors = seen.first_pose, []
    for share in (0.25, 0.5, 0.75, 1.0):
        motion = share * (np.array([-0.6, -1.6, 0.0]) * first + [0.0, 0.0, np.pi / 3])
        observed = track(
            scene.noisy(turned_shape(scene, shape, first + motion, **form), rng), scene.view, seen, last
        )
        assert observed.valid, observed.why
        last = observed.pose
        errors.append(last - seen.first_pose - motion)
    return seen, np.array(errors)


@pytest.mark.parametrize("camera", ["scene", "slanted"])
@pytest.mark.parametrize("shape", [BOWL, CAN, RING, PLATE], ids=["bowl", "can", "ring", "plate"])
def test_the_angle_of_what_is_nearly_round_is_held_wherever_it_is_first_seen(request, camera, shape):
    """Edges in the picture move with the direction of view: a seen angle would follow them."""
    scene, rng = request.getfixturevalue(camera), np.random.default_rng(3)
    for longer in (0.0, 0.015, 0.03):
        for first in ((0.0, 0.0), (-0.22, 0.2)):
            seen, errors = slid(scene, shape, first, rng, longer=longer)
            off = 1e3 * np.linalg.norm(errors[:, :2], axis=1).max()
            print(
                f"{camera}, {longer:.1%} longer, at {first}: angle seen: {seen.angle_seen}, off {off:.1f} mm"
            )
            assert not seen.angle_seen and seen.first_pose[2] == 0.0
            assert off < 2.5


@pytest.mark.parametrize(
    ("shape", "form"),
    [(BOWL, {"longer": 0.1}), (PLATE, {"longer": 0.15}), (CAN, {"longer": 0.4}), (RING, {"lobe": 4e-3})],
    ids=["bowl", "plate", "can", "knob"],
)
def test_the_angle_of_what_is_not_round_is_right_wherever_it_is_first_seen(scene, slanted, shape, form):
    rng = np.random.default_rng(3)
    for camera, first in ((scene, (-0.22, 0.2)), (slanted, (0.0, 0.0))):
        seen, errors = slid(camera, shape, first, rng, **form)
        turn = np.rad2deg(np.abs(errors[:, 2]).max())
        print(f"angle seen: {seen.angle_seen}, off {turn:.1f}°")
        assert seen.angle_seen and turn < 6.0


def test_the_angle_of_what_is_not_round_is_seen(look):
    for boxes in (BLOCK, ELL, strips(0.05, 0.008, 4), ((-0.03, -0.03, 0.03, 0.03, 0.04),)):
        assert look(boxes, (0.0, 0.0, 0.3)).angle_seen
