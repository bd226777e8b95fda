"""The plant's world slides like the model, falls where its weight is, repeats itself, and can refuse."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from slipmap.diagrams.application.campaigns import plant_world
from slipmap.diagrams.application.campaigns.adaptation import FIRST, HIDDEN, shifts_of_ends
from slipmap.diagrams.application.campaigns.plant_world import PlantWorld
from slipmap.diagrams.application.campaigns.worlds import DirectWorld, WorldNoise, commanded_path
from slipmap.diagrams.station.hidden_effects import HiddenEffectsConfig, TableTilt
from slipmap.models.geometry import compose, placed, relative, turn
from slipmap.models.inference.observations import observe
from slipmap.models.measurements.push_dataset import Noise
from slipmap.models.measurements.trial import Channel, Trial
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.physics.balance import balance_margins
from slipmap.models.physics.rollout import Push, Slider
from slipmap.planners.exploration import candidate_pushes
from slipmap.planners.push_decisions import ObjectFell, PushNotMade
from slipmap.planners.settings import GoalSettings
from slipmap.planners.table_push import TablePush

EXACT = WorldNoise(control=0.0, sensors=Noise(), camera=100.0)
POSE = np.array([-0.05, 0.02, 2.9])
STEEP = HiddenEffectsConfig(table_tilt=TableTilt(down_x=0.4))


@pytest.fixture(scope="module")
def exact() -> PlantWorld:
    return PlantWorld(benchmark_object("hammer"), noise=EXACT)


@pytest.fixture(scope="module")
def noisy() -> PlantWorld:
    return PlantWorld(benchmark_object("book"))


def _push(world: DirectWorld, number: int, length: float = 0.1) -> TablePush:
    candidates = candidate_pushes(
        world.true_object.grid, world.finger_radius, np.random.default_rng(1), number + 1
    )
    c = candidates[number]
    rotation = turn(POSE[2])
    begin, end = c.touch - 0.01 * c.direction, c.touch + length * c.direction
    return TablePush(POSE[:2] + rotation @ begin, POSE[:2] + rotation @ end, 0.06)


@pytest.fixture(scope="module")
def pushed(exact: PlantWorld) -> Callable[[int], Trial]:
    """The trial of a candidate without noise. Each is simulated once, which takes seconds."""

    @cache
    def trial(number: int) -> Trial:
        exact.reset(POSE, np.random.default_rng(0))
        return exact.push(_push(exact, number))

    return trial


@pytest.mark.parametrize("number", [0, 2, 3])
def test_ten_centimetres_are_those_of_the_cell_grid_model(
    exact: PlantWorld, pushed: Callable[[int], Trial], number: int
) -> None:
    trial = pushed(number)
    thing = exact.true_object
    push = Push(0.01, trial.tip_pose.values, POSE, pose_times=trial.object_pose.time[1:])
    expected = Slider(thing.grid, exact.finger_radius).rollout(thing.maps, [push]).poses_of(0)[0]
    off = trial.object_pose.values[1:] - expected
    assert np.hypot(*(expected[-1] - POSE)[:2]) > 0.02
    assert np.linalg.norm(off[:, :2], axis=1).max() < 1e-3
    assert np.abs(off[:, 2]).max() < np.radians(0.5)


def test_a_tapped_light_object_slides_no_farther_than_the_model_says() -> None:
    """On the walls that the arm needs it would slide 1 mm farther; see `YIELD_AT_RIGID_FINGER`."""
    thing, pose = benchmark_object("wrench"), np.array([-0.0437, -0.0159, 1.6141])
    world = PlantWorld(thing, noise=WorldNoise(control=0.0, sensors=Noise(), camera=0.0))
    world.reset(pose, np.random.default_rng(0))
    trial = world.push(TablePush(np.array([-0.072, -0.0959]), np.array([0.0099, -0.0667]), 0.3, creep=0.019))
    end = Slider(thing.grid, world.finger_radius).rollout(thing.maps, [observe(trial).push]).end[0, 0]
    assert np.hypot(*(end[:3] - pose)[:2]) > 0.05
    assert np.hypot(*(world.true_pose - end[:3])[:2]) < 5e-4


@pytest.mark.parametrize(
    ("name", "pose", "begin", "end", "speed"),
    [
        ("wrench", (0.0, 0.0, -1.16683), (-0.04368, 0.03245), (0.13450, 0.05677), 0.059),
        ("wrench", (-0.21647, -0.02134, 0.97127), (-0.20682, -0.07450), (-0.44367, 0.09922), 0.085),
        ("hammer", (0.03682, 0.36792, 1.35653), (0.01835, 0.20204), (0.12146, 0.40816), 0.083),
        ("hammer", (0.09685, 0.49962, 0.87122), (0.03466, 0.48889), (0.06474, 0.46205), 0.085),
        ("wrench", (0.1847, -0.43375, -0.13557), (0.13587, -0.46406), (0.12239, -0.40266), 0.08),
        ("wrench", (0.47932, 0.08756, 1.13192), (0.56451, 0.22861), (0.4376, 0.11585), 0.08),
        ("book", (0.16885, 0.36857, 1.18548), (0.37333, 0.45676), (0.25243, 0.50359), 0.08),
    ],
    ids=["balance", "balance, long", "rim, long", "rim", "light cells", "light cells, long", "wide cells"],
)
def test_pushes_near_balance_and_over_the_rim_are_those_of_the_model(name, pose, begin, end, speed) -> None:
    """Near balance, a contact that jumps up and down a long finger sends the object 30 and 60 mm elsewhere.
    Over the rim, an object that leans on its blocks ends elsewhere: the wrench by 20 and 83 mm on feet that
    sink by 2 µm, the book by 59 mm on one foot for each cell and blocks 0.3 mm up."""
    world = PlantWorld(benchmark_object(name), noise=EXACT)
    world.reset(np.array(pose), np.random.default_rng(0))
    asked = TablePush(np.array(begin), np.array(end), speed)
    trial = world.push(asked)
    thing = world.true_object
    push = Push(2e-3, commanded_path(asked, 2e-3), np.array(pose))
    slider = Slider(thing.grid, world.finger_radius, table=world.table)
    expected = slider.rollout(thing.maps, [push]).end[0, 0, :3]
    off = placed(thing.grid.centers, trial.object_pose.values[-1]) - placed(thing.grid.centers, expected)
    assert np.hypot(*off.T).mean() < 3e-3


def test_force_is_that_of_the_finger_on_the_object(exact: PlantWorld, pushed: Callable[[int], Trial]) -> None:
    thing, push, trial = exact.true_object, _push(exact, 0), pushed(0)
    assert trial.ft_wrench is not None
    along = trial.ft_wrench.values[:, :2] @ push.direction
    pressing = along > 0.1
    assert pressing.sum() > 100
    weight = 9.81 * (thing.mass * thing.mu).sum()
    assert along[pressing].max() < 1.2 * weight
    assert (along > -1e-6).all()


def test_finger_is_where_it_was_told_to_be(exact: PlantWorld, pushed: Callable[[int], Trial]) -> None:
    path = commanded_path(_push(exact, 0), 0.01)
    off = np.linalg.norm(pushed(0).tip_pose.values - path, axis=1)
    assert off.max() < 2e-5


@pytest.mark.parametrize(
    "name, pose, begin, end",
    [
        ("spray_gun", (-0.0729589, 0.2680897, 2.1049277), (-0.0032860, 0.2799210), (-0.2888657, 0.3940171)),
        ("snack", (0.2244082, -0.1434625, -0.7493232), (0.0924288, -0.0767592), (0.3184244, -0.2469382)),
    ],
)
def test_what_falls_during_a_push_has_fallen_when_it_ends(name, pose, begin, end) -> None:
    """Drake's contact solver gives up on it while it tumbles over the rim or far below it."""
    world = PlantWorld(benchmark_object(name), noise=EXACT)
    world.reset(np.array(pose), np.random.default_rng(0))
    trial = world.push(TablePush(np.array(begin), np.array(end), 0.08))
    assert trial.tip_pose.values[-1] == pytest.approx(end, abs=1e-4)
    assert np.isfinite(trial.tip_pose.values).all() and np.isfinite(trial.object_pose.values).all()
    assert trial.object_pose.time[-1] < trial.tip_pose.time[-1]
    with pytest.raises(ObjectFell):
        _ = world.true_pose


def test_a_trial_repeats_itself_whatever_was_before(noisy: PlantWorld) -> None:
    results = []
    for _ in range(2):
        noisy.reset(POSE, np.random.default_rng(5))
        trials = [noisy.push(_push(noisy, 0, 0.02)) for _ in range(2)]
        results.append((*trials, noisy.look()))
    (first, second, seen), (first_again, second_again, seen_again) = results
    for one, other in ((first, first_again), (second, second_again)):
        np.testing.assert_array_equal(one.object_pose.values, other.object_pose.values)
        np.testing.assert_array_equal(one.tip_pose.values, other.tip_pose.values)
        assert one.ft_wrench is not None and other.ft_wrench is not None
        np.testing.assert_array_equal(one.ft_wrench.values, other.ft_wrench.values)
    np.testing.assert_array_equal(seen, seen_again)
    assert (first.name, second.name) == ("trials/000.json", "trials/001.json")


def test_sensors_and_control_are_as_noisy_as_stated(noisy: PlantWorld) -> None:
    noisy.reset(POSE, np.random.default_rng(3))
    looks = np.array([noisy.look() for _ in range(400)])
    sensors = noisy.noise.sensors
    np.testing.assert_allclose(looks.std(axis=0), [sensors.position] * 2 + [sensors.angle], rtol=0.15)
    np.testing.assert_allclose(looks.mean(axis=0), POSE, atol=2e-4)
    push = TablePush(np.array([0.3, 0.3]), np.array([0.302, 0.3]), 0.1)
    trials = [noisy.push(push) for _ in range(6)]
    tips = np.array([trial.tip_pose.values[[0, -1]] for trial in trials])
    off = (tips - [push.begin, push.end]).ravel()
    assert off.std() == pytest.approx(noisy.noise.control, rel=0.35)
    assert np.abs(off).max() < 3 * noisy.noise.control


def test_angle_is_continuous_over_a_trial(noisy: PlantWorld) -> None:
    turned = np.add(POSE, [0.0, 0.0, 4 * np.pi])
    noisy.reset(turned, np.random.default_rng(3))
    assert noisy.look()[2] == pytest.approx(turned[2], abs=0.03)
    trial = noisy.push(_push(noisy, 2, 0.05))
    angles = trial.object_pose.values[:, 2]
    assert angles[0] == pytest.approx(turned[2], abs=0.03)
    assert np.abs(np.diff(angles)).max() < 0.5


@pytest.mark.parametrize("angle", [0.4, 2.0, 5.0])
def test_falls_where_its_weight_is_beyond_the_edge(exact: PlantWorld, angle: float) -> None:
    assert exact.table.radius is not None
    middle = turn(angle) @ exact.true_object.center_of_mass[:2]
    outward = middle / np.hypot(*middle)
    # The edge is round, so that weight a little within it may still tip over the chord of what is supported.
    for beyond, falls in ((-0.02, False), (2e-3, True)):
        place = (exact.table.radius + beyond) * outward - middle
        exact.reset(np.array([*place, angle]), np.random.default_rng(0))
        if falls:
            with pytest.raises(ObjectFell, match="hammer fell; it was seen last at x ="):
                exact.look()
        else:
            np.testing.assert_allclose(exact.look(), [*place, angle], atol=1e-3)


def test_what_balances_by_the_margin_of_a_goal_stays() -> None:
    """With stiff feet and blocks 1 mm up, it would fall off its last row of feet."""
    world = PlantWorld(benchmark_object("box"), noise=EXACT)
    thing, margin = world.true_object, GoalSettings().margin
    for angle in (0.4, 2.0, 5.0):
        middle = turn(angle) @ thing.center_of_mass[:2]
        out = np.linspace(0.4, 0.5, 401)[:, None] * turn(angle + 1.0)[:, 0] - middle
        poses = np.column_stack([out, np.full(len(out), angle)])
        margins = balance_margins(thing.grid, thing.center_of_mass[None, :2], poses, world.table).ravel()
        pose = poses[np.flatnonzero(margins > margin)[-1]]
        world.reset(pose, np.random.default_rng(0))
        assert np.hypot(*(world.look() - pose)[:2]) < 1e-3  # it leans by a degree or two


def test_pushed_over_the_edge_it_is_gone(exact: PlantWorld) -> None:
    middle = exact.true_object.center_of_mass[:2]
    exact.reset(np.array([0.46 - middle[0], -middle[1], 0.0]), np.random.default_rng(0))
    left = exact.true_object.grid.exterior[:, 0].min() + 0.46 - middle[0]
    trial = exact.push(TablePush(np.array([left - 0.012, 0.0]), np.array([left + 0.1, 0.0]), 0.1))
    assert np.isfinite(trial.object_pose.values).all()
    assert trial.object_pose.time[-1] < trial.tip_pose.time[-1]
    with pytest.raises(ObjectFell):
        exact.look()
    with pytest.raises(PushNotMade, match="fell"):
        exact.push(_push(exact, 0))
    exact.reset(POSE, np.random.default_rng(0))
    np.testing.assert_allclose(exact.look(), POSE, atol=1e-6)


def test_refuses_to_come_down_on_the_object(exact: PlantWorld) -> None:
    exact.reset(POSE, np.random.default_rng(0))
    middle = POSE[:2] + turn(POSE[2]) @ exact.true_object.grid.centers[0]
    with pytest.raises(PushNotMade, match=r"land on the hammer.*closer than its radius of 8 mm"):
        exact.push(TablePush(middle, np.add(middle, [0.1, 0.0]), 0.05))
    np.testing.assert_allclose(exact.look(), POSE, atol=1e-9)
    assert exact.pushes == 0


def test_hidden_effects_act() -> None:
    world = PlantWorld(benchmark_object("hammer"), noise=EXACT, hidden=STEEP)
    world.reset(POSE, np.random.default_rng(0))
    world.push(TablePush(np.array([0.3, 0.3]), np.array([0.31, 0.3]), 0.1))
    with pytest.raises(ObjectFell):
        world.look()


def test_a_recorded_push_ends_the_same_when_it_is_replayed(
    exact: PlantWorld, pushed: Callable[[int], Trial]
) -> None:
    trial = pushed(0)
    start, end = trial.object_pose.values[[0, -1]]
    assert np.hypot(*(end - start)[:2]) > 0.02
    exact.reset(np.zeros(3), np.random.default_rng(0))
    np.testing.assert_allclose(exact.replayed(trial, start), end, atol=2e-4)
    world = PlantWorld(benchmark_object("hammer"), noise=EXACT, hidden=STEEP)
    assert np.isnan(world.replayed(trial, start)).all()


def test_how_far_hidden_effects_move_the_ends_of_recorded_pushes(
    exact: PlantWorld, pushed: Callable[[int], Trial], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The camera sees the object in a frame of its own."""

    class Replays:
        def __init__(self, true_object: TrueObject, *, hidden: HiddenEffectsConfig | None) -> None:
            self._fall = hidden is STEEP
            self._end = np.array([0.0, 0.0, 0.0] if hidden is None else [0.003, 0.004, 0.0])

        def replayed(self, trial: Trial, pose: np.ndarray) -> np.ndarray:
            np.testing.assert_allclose(pose, true_start, atol=1e-12)
            return np.full(3, np.nan) if self._fall else self._end

    monkeypatch.setattr(plant_world, "PlantWorld", Replays)
    true = pushed(0).object_pose
    true_start = true.values[0]
    X_SO = np.array([0.02, -0.01, 0.5])
    X_OS = relative(X_SO, np.zeros(3))
    seen = np.array([compose(X_WO, X_OS) for X_WO in true.values])
    trial = replace(pushed(0), object_pose=Channel(true.time, seen))
    run = SimpleNamespace(
        true_object=exact.true_object, X_SO=X_SO, dataset=SimpleNamespace(trials=[trial] * (FIRST + 1))
    )
    assert shifts_of_ends(run, HIDDEN["film"]) == pytest.approx([0.005] * FIRST)
    assert shifts_of_ends(run, STEEP) == [None] * FIRST
    assert shifts_of_ends(run, HIDDEN["latency"]) == [0.0] * FIRST


def test_path_has_the_speed_asked_for() -> None:
    path = commanded_path(TablePush(np.zeros(2), np.array([0.03, 0.04]), 0.05), 2e-3)
    speed = np.hypot(*np.diff(path, axis=0).T) / 2e-3
    assert speed.max() == pytest.approx(0.05)
    np.testing.assert_allclose(path[[0, -1]], [[0, 0], [0.03, 0.04]], atol=1e-12)
    assert (len(path) - 1) % 5 == 0


def test_noise_out_of_range_is_refused() -> None:
    with pytest.raises(ValueError, match="control"):
        WorldNoise(control=-1e-3)
