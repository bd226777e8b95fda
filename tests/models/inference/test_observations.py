"""Trials prepared for comparison, and the smoothing of finger tracks."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from slipmap.models.inference import observations
from slipmap.models.inference.observations import MEASURED_CONTACT, SAMPLES, observe, observe_all
from slipmap.models.inference.paper_method import observe_steps
from slipmap.models.measurements import Channel, Noise, Trial, read_dataset
from slipmap.models.measurements.motion import smooth_track
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.rollout import Maps, Push, Slider
from slipmap.planners.exploration import candidate_pushes
from slipmap.planners.table_push import TablePush


def test_smoothing_removes_jitter_and_keeps_sudden_stops():
    rng = np.random.default_rng(0)
    t = np.arange(300) * 0.01
    x = 0.1 * np.minimum(t, 1.5)  # stops dead at 1.5 s
    true = np.column_stack([x, 0.0 * x])
    noisy = true + 5e-5 * rng.standard_normal(true.shape)
    grid, smooth, _ = smooth_track(t, noisy)
    away = np.abs(grid - 1.5) > 0.1
    assert np.abs(grid - t).max() < 1e-9
    assert np.sqrt(((smooth - true)[away] ** 2).mean()) < 0.4 * 5e-5
    assert np.abs(smooth - true).max() < 4 * 5e-5
    speed = np.hypot(*np.diff(smooth, axis=0).T) / 0.01
    raw_speed = np.hypot(*np.diff(noisy, axis=0).T) / 0.01
    moving = (grid[1:] > 0.2) & (grid[1:] < 1.3)
    assert speed[moving].std() < 0.1 * raw_speed[moving].std()


@pytest.mark.parametrize("rate", [100, 250, 1000])
def test_smoothing_keeps_the_corners_of_a_tap_at_any_rate(rate):
    t = np.arange(rate) / rate
    acceleration = np.select([(t >= 0.3) & (t < 0.4), (t >= 0.6) & (t < 0.7)], [3.0, -3.0])  # to 0.3 m/s
    x = np.cumsum(np.cumsum(acceleration)) / rate**2
    true = np.column_stack([0.6 * x, 0.8 * x])
    errors = []
    for seed in range(20):
        noisy = true + 1e-4 * np.random.default_rng(seed).standard_normal(true.shape)
        errors.append((smooth_track(t, noisy)[1] - true) @ [0.6, 0.8])
    assert np.sqrt(np.mean(np.square(errors))) < 0.5e-4
    assert np.abs(np.mean(errors, axis=0)).max() < 0.5e-4
    cruising = np.array(errors)[:, (t > 0.45) & (t < 0.55)]
    speed = 1e3 * (cruising[:, rate // 100 :] - cruising[:, : -(rate // 100)]) / 0.01  # mm/s, over 10 ms
    assert np.sqrt(np.mean(speed**2)) < 1.0


def test_jitter_makes_a_struck_object_slide_no_farther_and_by_as_much_as_likely_tracks_say():
    rows = TablePush(np.array([-0.11, 0.0]), np.array([0.0, 0.0]), 0.3, creep=0.06).path(0.01)
    t = 0.01 * np.arange(len(rows) + 40)  # the object comes to rest
    true = np.vstack([rows, np.repeat(rows[-1:], 40, axis=0)])
    grid = cells_from_polygon([[-0.04, -0.03], [0.04, -0.03], [0.04, 0.03], [-0.04, 0.03]], width=0.01)
    slider = Slider(grid, 0.008, smoothing=MEASURED_CONTACT)
    maps = Maps(np.full((1, len(grid)), 1.0 / len(grid)), np.full((1, len(grid)), 0.3), np.array([0.25]))
    ends = 2e-3 * np.arange(int(t[-1] / 2e-3) + 1)

    def slid(tracks: np.ndarray) -> np.ndarray:
        pushes = [Push(2e-3, PchipInterpolator(t, track)(ends), np.zeros(3)) for track in tracks]
        return slider.rollout(maps, pushes).end[0, :, 0]

    farther, scatter = [], []
    (base,) = slid(smooth_track(t, true)[1][None])
    for seed in range(40):
        noisy = true + 1e-4 * np.random.default_rng(seed).standard_normal(true.shape)
        _, mean, likeliest = smooth_track(t, noisy)
        end, *others = slid(np.concatenate([mean[None], likeliest[::2]]))
        farther.append(end - base)
        scatter.append(np.std(others))
    assert abs(np.mean(farther)) < 1.5e-4  # with the likeliest track alone 0.34 mm
    inside = np.abs(farther) < 1.645 * np.array(scatter)
    assert 0.8 <= inside.mean() <= 0.975


def test_a_single_row_off_the_track_hardly_bends_it():
    t = np.arange(100) * 0.01
    true = np.column_stack([0.05 * np.clip(t - 0.2, 0.0, 0.5), 0.0 * t])
    bends = []
    for seed in range(5):
        noisy = true + 2e-5 * np.random.default_rng(seed).standard_normal(true.shape)
        noisy[50] += [5e-4, -5e-4]
        bends.append(np.abs(smooth_track(t, noisy)[1] - true)[30:65].max())
    assert np.mean(bends) < 1.5e-4


def test_a_weaving_track_without_noise_keeps_its_shape():
    t = np.arange(200) * 0.01
    track = np.column_stack([np.abs(t - 1.0), 0.02 * np.sin(6.0 * t)])
    _, smooth, _ = smooth_track(t, track)
    assert np.abs(smooth - track).max() < 5e-5


def test_short_tracks_come_back_as_they_are():
    t, track = np.array([0.0, 5.0]), np.array([[0.0, 0.0], [0.05, 0.0]])
    _, smooth, likeliest = smooth_track(t, track)
    assert smooth is track and likeliest.tolist() == [track.tolist()]


def resting_trial(noise: float) -> Trial:
    rng = np.random.default_rng(1)
    t = np.arange(300) * 0.01
    pose = np.column_stack([0.02 * np.maximum(t - 1.0, 0.0), 0 * t, 0 * t]) + noise * rng.standard_normal(
        (300, 3)
    )
    tip = np.column_stack([-0.05 + 0.02 * t, 0 * t])
    force = np.column_stack([np.where(t > 1.0, 2.0, 0.0), 0 * t, 0 * t])
    return Trial("t", "fit", Channel(t, pose), Channel(t, tip), Channel(t, force))


def test_start_pose_is_the_mean_of_the_resting_rows():
    observation = observe(resting_trial(2e-4))
    assert np.abs(observation.push.start_pose).max() < 6e-5
    assert not observation.push.start_twist.any()


def test_noise_of_the_angle_alone_does_not_end_the_rest():
    trial = resting_trial(1e-4)
    pose = trial.object_pose.values.copy()
    pose[:, 2] = np.radians(2.0) * np.random.default_rng(2).standard_normal(len(pose))
    noisy = observe(replace(trial, object_pose=Channel(trial.object_pose.time, pose)))
    still = observe(trial)
    assert still.start_rows > 60
    assert noisy.start_rows == pytest.approx(still.start_rows, abs=2)


def test_an_object_that_turns_on_the_spot_is_not_at_rest():
    """Its angle, not noise of it, changes from row to row."""
    trial = resting_trial(1e-4)
    pose = trial.object_pose.values.copy()
    pose[:, :2] -= 0.02 * np.maximum(trial.object_pose.time - 1.0, 0.0)[:, None] * [1.0, 0.0]
    pose[:, 2] = 2.0 * np.maximum(trial.object_pose.time - 1.0, 0.0)
    turning = observe(replace(trial, object_pose=Channel(trial.object_pose.time, pose)))
    assert 60 < turning.start_rows < 75


def test_first_touch_and_stop_do_not_count_as_force():
    observation = observe(resting_trial(0.0))
    times = observation.push.force_times
    assert len(times) == SAMPLES
    assert observation.sliding.sum() > 10
    assert times[observation.sliding].min() > 1.05
    assert not observation.sliding[-1] or times[observation.sliding].max() < 3.0


def pushed_trial(rest: float = 0.0, gap: float = 0.0) -> Trial:
    """A second of motion at 80 mm/s under 2 N, with rests before and after it, and a gap in its middle, s."""
    t = np.arange(round((1.0 + 2.0 * rest) / 0.005)) * 0.005
    x = 0.08 * np.clip(t - rest, 0.0, 1.0)
    pose = np.column_stack([x, 0 * t, 0 * t])
    seen = np.abs(t - rest - 0.5) >= 0.5 * gap
    force = np.where((t > rest) & (t < rest + 1.0), 2.0, 0.0)
    return Trial(
        "t", "fit", Channel(t[seen], pose[seen]), Channel(t, np.column_stack([x - 0.04, 0 * t])),
        Channel(t, np.column_stack([force, 0 * t, 0 * t])),
    )  # fmt: skip


@pytest.mark.parametrize("rest", [0.0, 0.0025, 0.3])
def test_long_steps_keep_the_finger_and_the_times(rest):
    fine = observe(pushed_trial(rest))
    long = fine.with_long_steps
    time, tip = _track(fine)
    own, longer = _track(long)
    assert len(own) - 1 == max(8, len(time) // 2) and own[-1] == pytest.approx(time[-1])
    np.testing.assert_allclose(longer.T, [np.interp(own, time, column) for column in tip.T], atol=1e-9)
    np.testing.assert_array_equal(long.push.pose_times, fine.push.pose_times)
    np.testing.assert_array_equal(long.poses, fine.poses)


def test_a_finger_turns_as_recorded_also_with_long_steps():
    trial = pushed_trial(0.3)
    time = trial.tip_pose.time
    jitter = np.random.default_rng(1).normal(0.0, 2e-3, len(time))
    angle = Channel(time, (0.5 * time + jitter)[:, None])
    for observation in (fine := observe(replace(trial, tip_angle=angle)), fine.with_long_steps):
        push = observation.push
        inner = slice(len(push.tip) // 10, -len(push.tip) // 10)
        expected = 0.5 * (trial.start + push.h * np.arange(len(push.tip)))
        np.testing.assert_allclose(push.tip_angle[inner], expected[inner], atol=5e-3)
        assert np.diff(push.tip_angle)[inner].std() / push.h < 0.1  # rad/s; of the rows it is 0.3
    assert observe(trial).push.tip_angle is None
    once = Channel(time[5:6], np.ones((1, 1)))
    assert (observe(replace(trial, tip_angle=once)).push.tip_angle == 1.0).all()


def _track(observation):
    push = observation.push
    return push.h * np.arange(len(push.tip)), push.tip


@pytest.mark.parametrize("gap", [0.0, 0.1, 0.3])
def test_poses_beside_a_gap_stay_on_the_track(gap):
    observation = observe(pushed_trial(gap=gap))
    expected = 0.08 * np.minimum(observation.push.pose_times, 1.0)
    assert np.abs(observation.poses[:, 0] - expected).max() < 2e-4
    assert observation.pose_rows.max() == 5


@pytest.mark.parametrize("rest", [4.0, 20.0])
def test_long_rests_leave_poses_and_forces_to_the_motion(rest):
    observation = observe(pushed_trial(rest))
    steps = np.diff(observation.poses[:, 0], prepend=0.0)
    assert (steps > 1e-3).sum() > SAMPLES / 3
    assert observation.sliding.sum() > SAMPLES / 4
    assert observation.push.start_pose == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert observation.poses[-1] == pytest.approx([0.08, 0.0, 0.0], abs=1e-9)
    assert np.allclose(observation.forces[observation.sliding], [2.0, 0.0])


@pytest.mark.parametrize(("way", "turn"), [(0.0025, 0.0), (0.0, 0.1), (0.004, 0.0)])
def test_the_ends_of_a_small_motion_between_long_rests_are_not_cut_off(way, turn):
    t = np.arange(1600) * 0.005
    moved = np.clip(t - 3.5, 0.0, 1.0)
    pose = np.column_stack([way * moved, 0 * t, turn * moved])
    tip = np.column_stack([way * moved - 0.04, 0 * t])
    observation = observe(Trial("t", "fit", Channel(t, pose), Channel(t, tip)))
    assert observation.push.start_pose == pytest.approx([0.0, 0.0, 0.0], abs=1e-4)
    assert observation.poses[-1] == pytest.approx([way, 0.0, turn], abs=1e-9)
    assert not observation.push.start_twist.any()
    assert observation.push.h * (len(observation.push.tip) - 1) < 4.0


def test_rows_in_bursts_are_averaged_all_the_same():
    t = np.cumsum(np.tile([0.001, 0.001, 0.001, 0.037], 60))
    pose = np.column_stack([0.02 * np.maximum(t - 0.5, 0.0), 0 * t, 0 * t])
    observation = observe(Trial("t", "fit", Channel(t, pose), Channel(t, pose[:, :2] - [0.04, 0.0])))
    assert (observation.pose_rows == 5).sum() > 20


def test_a_push_keeps_its_place_in_the_experiment_whatever_is_left_out(shared_data):
    whole = read_dataset(shared_data / "real" / "mit_abs_rect1")
    places = {push.trial: push.push.order for push in observe_all(whole)}
    assert list(places.values()) == list(range(len(whole.trials)))
    for some in (
        whole.with_fit_pushes(1),
        replace(whole, trials=whole.trials[3:]),
        replace(whole, trials=tuple(replace(trial, role="fit") for trial in whole.heldout_trials)),
        pickle.loads(pickle.dumps(whole.with_fit_pushes(1))),
    ):
        assert [push.push.order for push in observe_all(some)] == [places[one.name] for one in some.trials]
    again = tuple(replace(trial, name=f"{trial.name} again") for trial in whole.trials)
    twice = observe_all(replace(whole, trials=whole.trials + again))  # one experiment after the other
    assert [push.push.order for push in twice] == list(range(len(twice)))


@pytest.mark.parametrize("method", ["gauss-newton", "paper"])
def test_a_finger_far_from_the_frame_of_its_object_pushes_it(recorded, method):
    dataset, off = recorded.dataset, np.array([1.5, 0.0])
    grid = CellGrid(dataset.grid.centers + off, dataset.grid.width, dataset.grid.exterior + off)

    def from_there(trial):
        x, y, theta = trial.object_pose.values.T
        poses = np.column_stack([x - 1.5 * np.cos(theta), y - 1.5 * np.sin(theta), theta])
        return replace(trial, object_pose=Channel(trial.object_pose.time, poses))

    far = replace(dataset, grid=grid, trials=tuple(map(from_there, dataset.trials)))
    if method == "paper":
        assert np.isfinite(observe_steps(far.trials[0], far.reach).tip).all()
        return
    for one, other in zip(observe_all(dataset), observe_all(far), strict=True):
        assert np.array_equal(one.push.tip, other.push.tip) and one.push.h == other.push.h


def test_two_row_trials_compare_at_the_end_alone(shared_data):
    dataset = read_dataset(shared_data / "real" / "mit_abs_rect1")
    observation = observe(dataset.trials[0])
    assert len(observation.poses) == 1
    assert observation.push.pose_times[0] == pytest.approx(5.0, abs=0.01)


@pytest.mark.parametrize("speed", [0.2, 1.0])
def test_steps_are_short_enough_for_a_fast_slide(speed):
    """Implicit steps stop the object half a step too early."""
    mu, gravity = 0.3, 9.81
    time = 0.005 * np.arange(100)
    since = np.minimum(time, speed / (mu * gravity))
    x = speed * since - 0.5 * mu * gravity * since**2
    away = np.full((100, 2), 10.0)
    trial = Trial("t", "fit", Channel(time, np.column_stack([x, 0 * x, 0 * x])), Channel(time, away))
    grid = cells_from_polygon([[-0.03, -0.03], [0.03, -0.03], [0.03, 0.03], [-0.03, 0.03]], width=0.02)
    maps = Maps(np.full((1, len(grid)), 0.1), np.full((1, len(grid)), mu), np.full(1, 0.3))
    end = Slider(grid, 0.005, gravity=gravity).rollout(maps, [observe(trial).push]).end[0, 0]
    assert end[0] == pytest.approx(trial.initial_velocity()[0] ** 2 / (2.0 * mu * gravity), abs=1.5e-4)


def test_an_object_that_slides_without_a_finger_gets_its_first_velocity(shared_data):
    dataset = read_dataset(shared_data / "real" / "cube_slides")
    observation = observe(dataset.trials[0])
    assert np.isnan(observation.push.tip).all()
    assert 0.2 < np.hypot(*observation.push.start_twist[:2]) < 1.0


@pytest.mark.parametrize("rate", [25.0, 50.0, 100.0])
def test_the_blow_of_the_first_touch_is_in_no_force_that_counts(rate):
    """A blow of milliseconds falls into a row of the sensor, which may be stamped after it."""
    rng = np.random.default_rng(6)
    grid = cells_from_polygon(
        np.array([[-0.12, -0.08], [0.12, -0.08], [0.12, 0.08], [-0.12, 0.08]]), count=24
    )
    slider = Slider(grid, 0.008, smoothing=MEASURED_CONTACT)
    truth = Maps(np.full(len(grid), 0.8 / len(grid)), np.full(len(grid), 0.4), np.array([0.4]))
    pushes = [c.push(np.zeros(3)) for c in candidate_pushes(grid, 0.008, rng, 12, speed=(0.1, 0.1))]
    noise = Noise(position=1e-5, angle=1e-4, tip=1e-6, force=1e-3)
    dataset = record_pushes(slider, truth, pushes, rng, rate=rate, noise=noise)
    observations = observe_all(dataset)
    rollouts = slider.rollout(truth, [o.push for o in observations])
    for b, o in enumerate(observations):
        assert o.sliding.sum() > 5
        off = np.hypot(*(rollouts.forces_of(b)[0] - o.forces)[o.sliding].T)
        assert off.max() < 0.2 * np.hypot(*o.forces[o.sliding].T).mean(), b


def test_the_force_of_an_accelerating_finger_does_not_ring_at_its_rows():
    mass, mu, faster, width = 1.0, 0.3, 3.0, 0.1  # kg, 1, m/s², m
    square = width * (np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) - 0.5)
    grid = cells_from_polygon(square, count=16)
    t = np.arange(31) * 0.01
    still = np.zeros_like(t)
    tip = np.column_stack([0.05 * t + 0.5 * faster * t**2 - width / 2 - 0.01 - 5e-4, still])
    poses = Channel(t, np.zeros((len(t), 3)))
    push = observe(Trial("a", "fit", poses, Channel(t, tip))).push
    slider = Slider(grid, 0.01, smoothing=MEASURED_CONTACT)
    push = replace(push, force_times=np.linspace(0.1, 0.28, 50), force_span=0.0)
    maps = Maps(np.full(len(grid), mass / len(grid)), np.full(len(grid), mu), 0.3)
    force = slider.rollout(maps, [push]).forces_of(0)[0]
    np.testing.assert_allclose(force[:, 0], mass * (mu * 9.81 + faster), rtol=0.05)


def test_forces_of_a_tap_are_compared_as_means_over_their_intervals():
    grid = cells_from_polygon(np.array([[-0.1, -0.06], [0.1, -0.06], [0.1, 0.06], [-0.1, 0.06]]), count=24)
    slider = Slider(grid, 0.01, smoothing=MEASURED_CONTACT)
    truth = Maps(np.full(len(grid), 0.8 / len(grid)), np.full(len(grid), 0.3), np.array([0.3]))
    t = 0.002 * np.arange(401)
    speed = np.interp(t, [0.2, 0.3, 0.5, 0.6], [0.05, 0.35, 0.35, 0.0])  # the force falls within an interval
    x = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 0.002)])
    push = Push(0.002, np.column_stack([x - 0.116, 0.0 * x]), np.zeros(3))
    noise = Noise(position=1e-7, angle=1e-7, tip=1e-7, force=1e-6)
    dataset = record_pushes(slider, truth, [push], np.random.default_rng(0), rate=500.0, noise=noise)
    seen = observe(dataset.trials[0])
    counted = seen.forces[seen.sliding, 0]
    assert np.ptp(counted) > 1.0
    means = slider.rollout(truth, [seen.counted]).forces_of(0)[0, :, 0]
    assert means == pytest.approx(counted, rel=0.03)


def test_a_stop_between_two_of_few_rows_stays_a_stop():
    t, x = np.array([0.0, 0.5, 1.5, 2.0]), np.array([0.0, 0.0, 0.1, 0.1])
    tip = np.column_stack([x, 0.0 * x])
    push = observe(Trial("a", "fit", Channel(t, np.zeros((4, 3))), Channel(t, tip))).push
    assert (np.diff(push.tip[:, 0]) / push.h).max() == pytest.approx(0.1)


def test_a_track_is_smoothed_once_however_often_its_push_is_observed(recorded, monkeypatch):
    """A push of another track is another one."""
    trial, asked = recorded.dataset.trials[0], []
    monkeypatch.setattr(observations, "smooth_track", lambda *rows: asked.append(rows) or smooth_track(*rows))
    observations._smoothed.cache_clear()
    first, again = (observe(one) for one in (trial, replace(trial, role="heldout")))
    assert len(asked) == 1 and np.array_equal(first.push.tip, again.push.tip)
    beside = Channel(trial.tip_pose.time, trial.tip_pose.values + np.array([1e-4, 0.0]))
    other = observe(replace(trial, tip_pose=beside))
    assert len(asked) == 2
    np.testing.assert_allclose(
        other.push.tip - first.push.tip, np.full_like(first.push.tip, [1e-4, 0.0]), atol=1e-9
    )
