"""What is wrong with pushes is found with its size; what is right is left in peace."""

import re
from dataclasses import replace

import numpy as np
import pytest
from straight_pushes import RADIUS, forced, posed, straight_pushes, tipped

from slipmap import Maps, Slider, candidate_pushes, cells_from_polygon, record_pushes
from slipmap.models.effects.library import LIBRARY
from slipmap.models.geometry import rotated
from slipmap.models.inference.identification import identify
from slipmap.models.measurements import Channel, DatasetError, Noise, Table, read_dataset, write_dataset
from slipmap.models.measurements.dataset_check import check_dataset
from slipmap.models.measurements.what_pushes_show import EFFECT_NEEDS, quantities_shown


def waited(trial):
    """With 0.6 s before it in which nothing moves."""
    early = 0.01 * np.arange(60)
    channels = {
        name: Channel(
            np.concatenate([early, 0.6 + channel.time]),
            np.concatenate([np.tile(channel.values[0], (60, 1)), channel.values]),
        )
        for name, channel in trial.channels.items()
    }
    return replace(trial, **channels)


def changed(change):
    dataset = straight_pushes(8)
    return check_dataset(replace(dataset, trials=tuple(change(waited(one)) for one in dataset.trials)))


def finding(check, what):
    (found,) = (one for one in check.findings if one.what == what)
    return found


def test_nothing_is_wrong_with_good_pushes():
    check = check_dataset(straight_pushes(8))
    assert not check.wrong
    assert {one.verdict for one in check.findings} == {"good"}, check.findings
    assert check.headline == "The recording is sound."


@pytest.mark.parametrize(("spread", "jitters"), [(0.0, False), (0.002, False), (0.015, True)])
def test_stamps_that_jitter_though_rows_are_even_are_wrong(spread, jitters, tmp_path):
    rng = np.random.default_rng(3)

    def unsteady(trial):
        return replace(
            trial,
            **{
                name: Channel(
                    np.sort(channel.time + spread * rng.standard_normal(len(channel.time))), channel.values
                )
                for name, channel in waited(trial).channels.items()
            },
        )

    dataset = straight_pushes(8)
    dataset = replace(dataset, trials=tuple(unsteady(waited(one)) for one in dataset.trials))
    found = [one for one in check_dataset(dataset).findings if one.what == "jitter of stamps"]
    told = [
        text
        for text in read_dataset(write_dataset(dataset, tmp_path / "pushes")).warnings
        if "jitter" in text
    ]
    assert len(found) == len(told) == int(jitters)
    if jitters:
        assert found[0].verdict == "wrong" and "`rate`" in found[0].advice
        size = float(found[0].found.split("jitter by ")[1].split(" ms")[0])
        assert size == pytest.approx(1e3 * spread, rel=0.5)
        assert "evenly spaced" in told[0] and told[0].endswith(found[0].advice)


def test_rows_that_are_missing_are_no_jitter():
    rng = np.random.default_rng(4)

    def dropped(trial):
        kept = {name: rng.random(len(channel.time)) < 0.5 for name, channel in trial.channels.items()}
        for rows in kept.values():
            rows[[0, -1]] = True
        return replace(
            trial,
            **{
                name: Channel(channel.time[kept[name]], channel.values[kept[name]])
                for name, channel in trial.channels.items()
            },
        )

    assert not [one for one in changed(dropped).findings if one.what == "jitter of stamps"]


def test_a_late_finger_is_told_with_its_size():
    def late(trial):
        return replace(trial, tip_pose=Channel(trial.tip_pose.time + 0.05, trial.tip_pose.values))

    check = changed(late)
    found = finding(check, "clock of the finger")
    assert found.verdict == "wrong" and check.headline.startswith("Wrong: clock of the finger")
    told = float(found.found.split("finger ")[1].split(" ms late")[0])
    assert told == pytest.approx(50.0, abs=5.0)
    assert f"finger {told:.0f} ms late, or equally the tracker {told:.0f} ms early" in found.found


@pytest.mark.parametrize(
    ("name", "provenance", "finger", "force", "bias"),
    [
        (
            "trials/{}.json",
            (),
            r" s to t of each row of tip_pose, in every push \(trials/\*\.json\)$",
            r"^add -0\.\d+ s to t of each row of ft_wrench, in every push \(trials/\*\.json\)$",
            "remove it from fx and fy of each row of ft_wrench, in every push",
        ),
        (
            "trials/{}.json",
            ("imported from log.txt",),
            r" s to `clock` of tip_pose, in the setup\.yaml, and import again$",
            r"^add -0\.\d+ s to `clock` of ft_wrench, in the setup\.yaml, and import again$",
            "subtract it with ft_wrench.offset in the setup.yaml, and import again",
        ),
        (
            "{}.csv",
            (),
            r" s to `clock` of tip_pose, in a setup\.yaml, and read the files with slipmap import$",
            r"^add -0\.\d+ s to `clock` of ft_wrench, in a setup\.yaml, and read the files with slipmap",
            "subtract it with ft_wrench.offset in a setup.yaml, and read the files with slipmap import",
        ),
    ],
)
def test_advice_names_what_can_be_changed_in_these_files(name, provenance, finger, force, bias):
    dataset = straight_pushes(8)

    def check(channel, seconds=0.0, change=0.0):
        trials = []
        for number, trial in enumerate(map(waited, dataset.trials)):
            rows = getattr(trial, channel)
            own = {channel: Channel(rows.time + seconds, rows.values + change)}
            trials.append(replace(trial, name=name.format(number), **own))
        return check_dataset(replace(dataset, trials=tuple(trials), provenance=provenance))

    assert re.search(finger, finding(check("tip_pose", 0.05), "clock of the finger").advice)
    assert re.search(force, finding(check("ft_wrench", 0.03), "clock of the force").advice)
    biased = check("ft_wrench", change=np.array([0.3, -0.4, 0.0]))
    assert finding(biased, "force at rest").advice.startswith(bias)


def test_a_late_force_is_told_with_its_size():
    def late(trial):
        return replace(trial, ft_wrench=Channel(trial.ft_wrench.time + 0.03, trial.ft_wrench.values))

    check = changed(late)
    found = finding(check, "clock of the force")
    assert found.verdict == "note"
    assert check.headline == "The recording is usable, with a doubt about: clock of the force."
    assert float(found.found.split("force ")[1].split(" ms late")[0]) == pytest.approx(30.0, abs=6.0)


def late_force(trial, seconds=0.03):
    return replace(trial, ft_wrench=Channel(trial.ft_wrench.time + seconds, trial.ft_wrench.values))


@pytest.mark.parametrize("late", [0.0, 0.05])
def test_a_wrong_radius_is_told_beside_a_late_force(late):
    dataset = straight_pushes(8)
    trials = tuple(late_force(waited(trial), late) for trial in dataset.trials)
    found = finding(
        check_dataset(replace(dataset, finger_radius=RADIUS + 0.0024, trials=trials)), "clock of the force"
    )
    assert found.verdict == "note" and "2.4 mm of depth while pushing would look" in found.found
    assert "finger.radius, about 2.4 mm too large" in found.advice and "add" not in found.advice


def test_a_late_force_is_no_advice_where_contact_is_in_doubt():
    dataset = straight_pushes(8)
    late = [late_force(waited(trial)) for trial in dataset.trials]
    inwards = dataset.trials[0].tip_pose.values[60, :2] - dataset.trials[0].tip_pose.values[0, :2]
    late[0] = tipped(lambda tip: tip + 0.006 * inwards / np.hypot(*inwards))(late[0])
    check = check_dataset(replace(dataset, trials=tuple(late)))
    assert finding(check, "contact").advice
    found = finding(check, "clock of the force")
    assert found.verdict == "note" and not found.advice and "contact" in found.found


def test_two_touches_are_too_few_for_advice():
    dataset = straight_pushes(2)
    check = check_dataset(
        replace(dataset, trials=tuple(late_force(waited(trial)) for trial in dataset.trials))
    )
    found = finding(check, "clock of the force")
    assert found.verdict == "note" and not found.advice and "2 touches, too few" in found.found


def test_a_bias_is_told_with_its_size():
    found = finding(changed(forced(lambda wrench: wrench + np.array([0.3, -0.4, 0.0]))), "force at rest")
    assert found.verdict == "wrong" and "0.50 N" in found.found


def test_a_turned_force_is_wrong():
    def turned(wrench):
        return np.column_stack([rotated(wrench[:, :2], np.radians(80.0)), wrench[:, 2]])

    assert finding(changed(forced(turned)), "force's direction").verdict == "wrong"


def test_a_finger_inside_the_object_is_wrong():
    assert finding(changed(tipped(lambda tip: tip + np.array([0.01, 0.0]))), "contact").verdict == "wrong"


@pytest.mark.parametrize(
    ("change", "advice"),
    [
        (tipped(lambda tip: np.asarray(tip) * 0.1), "never touches its outline"),
        (posed(lambda pose: np.asarray(pose) * [1e3, 1e3, 1.0]), "faster than 10 m/s"),
    ],
)
def test_pushes_that_cannot_be_are_wrong(change, advice):
    check = check_dataset(replace(straight_pushes(8), trials=tuple(map(change, straight_pushes(8).trials))))
    found = finding(check, "units and frames")
    assert check.wrong and found.verdict == "wrong" and advice in found.advice
    assert "8 of 8 pushes" in found.found


@pytest.mark.parametrize(
    "table", [Table("round", (5.0, 5.0), radius=0.5), Table("rectangle", (-3.0, 0.0), size=(1.0, 0.8))]
)
def test_objects_that_no_table_carries_are_wrong_and_nothing_is_learned(table):
    beside = replace(straight_pushes(8), table=table)
    assert "wholly beyond the table's rim" in finding(check_dataset(beside), "units and frames").advice
    with pytest.raises(DatasetError, match=r"trials/.*begins wholly beyond the table's rim; table\.center"):
        identify(beside)


def at_rim(beyond, numbers=range(8)):
    """Pushes in all directions that begin with the outline's middle so far, m, beyond a table's rim."""
    dataset = straight_pushes(8)
    moved = []
    for trial in (dataset.trials[number] for number in numbers):
        pose, tip = trial.object_pose, trial.tip_pose
        x, y, _ = pose.values[0]
        poses = Channel(pose.time, pose.values - np.array([x, y, 0.0]))
        moved.append(
            replace(trial, object_pose=poses, tip_pose=Channel(tip.time, tip.values - np.array([x, y])))
        )
    table = Table("rectangle", (-beyond - 1.0, 0.0), size=(2.0, 2.0))
    return replace(dataset, trials=tuple(moved), table=table)


def test_a_table_off_which_the_object_would_fall_wherever_its_mass_is_is_wrong(tmp_path, caplog):
    contradicted = at_rim(0.02)
    found = finding(check_dataset(contradicted), "table")
    assert found.verdict == "wrong" and "would fall off the table" in found.found
    assert "20 mm beyond the rim" in found.found and "table.center" in found.advice
    write_dataset(contradicted, tmp_path)
    (warning,) = read_dataset(tmp_path).warnings
    assert found.found in warning and found.advice in warning
    caplog.clear()
    identify(contradicted, hypotheses=2, friction_laws=False)
    assert found.found in caplog.text
    # The rim may be off by 10 mm, and what is always over the table may hold nearly all of the mass.
    for possible in (at_rim(0.008), at_rim(0.02, (0, 7))):
        assert not [one for one in check_dataset(possible).findings if "begins" in one.found]


def test_an_object_that_ends_beyond_the_table_is_said_to_have_fallen():
    dataset = at_rim(-0.1)
    first, *others = dataset.trials
    poses = first.object_pose.values + np.linspace(0.0, 0.15, len(first.object_pose.time))[:, None] * [
        1,
        0,
        0,
    ]
    fell = replace(first, object_pose=Channel(first.object_pose.time, poses))
    found = finding(check_dataset(replace(dataset, trials=(fell, *others))), "table")
    assert found.verdict == "note" and "trials/000.json: the object ends" in found.found
    assert "so it fell" in found.found and "end the trial" in found.advice


def slid(times, tip):
    """A free slide at 1 m/s that has begun before the first row."""
    way = times - 1.2 * times**2
    pose = Channel(times, np.column_stack([way, 0 * way, 0 * way]))
    return lambda trial: replace(trial, object_pose=pose, tip_pose=tip, ft_wrench=None)


@pytest.mark.parametrize("rate", [5.0, 10.0, 30.0, 100.0])
@pytest.mark.parametrize("place", [(100.0, 100.0), (-0.3, -0.3)])
def test_free_slides_are_not_wrong(rate, place):
    dataset = straight_pushes(8)
    slide = slid(np.arange(0.0, 0.4, 1.0 / rate), Channel(np.zeros(1), np.array([place])))
    check = check_dataset(replace(dataset, trials=tuple(map(slide, dataset.trials))))
    assert not check.wrong, [one for one in check.findings if one.verdict == "wrong"]


@pytest.mark.parametrize(("factor", "wrong"), [(1.0, False), (1e3 / 9.81, True)], ids=["N", "grams"])
def test_forces_that_no_object_of_this_size_needs_are_wrong(factor, wrong, tmp_path):
    """Without a mass to compare them with."""
    dataset = replace(straight_pushes(8), mass=None, height=0.02)
    pushed = [
        replace(one, ft_wrench=Channel(one.ft_wrench.time, factor * one.ft_wrench.values))
        for one in dataset.trials
    ]
    dataset = replace(dataset, trials=tuple(pushed))
    read = read_dataset(write_dataset(dataset, tmp_path / "pushes"))
    assert ["in grams or mN?" in text for text in read.warnings] == [True] * wrong
    found = [one for one in check_dataset(read).findings if one.what == "force and size"]
    assert [one.verdict for one in found] == ["wrong"] * wrong
    assert check_dataset(read).wrong == wrong


@pytest.mark.parametrize(("mass", "wrong"), [(None, False), (1.0, False), (1000.0, True), (1e-3, True)])
def test_force_and_mass_in_different_units_are_wrong(mass, wrong):
    check = check_dataset(replace(straight_pushes(8), mass=mass))
    assert check.wrong == wrong
    assert [one.verdict for one in check.findings if one.what == "force and mass"] == ["wrong"] * wrong


@pytest.mark.parametrize("mass", [0.2, 12.0])
def test_a_mass_that_contradicts_the_force_is_a_doubt(mass):
    found = finding(check_dataset(replace(straight_pushes(8), mass=mass)), "force and mass")
    assert found.verdict == "note" and "object.mass" in found.advice


def noisy_pushes(declared):
    rng = np.random.default_rng(0)

    def noisy(trial):
        pose = trial.object_pose.values + rng.normal(0.0, [2e-4, 2e-4, 2e-3], trial.object_pose.values.shape)
        force = trial.ft_wrench.values + rng.normal(0.0, 0.05, trial.ft_wrench.values.shape)
        return replace(
            trial, object_pose=Channel(trial.object_pose.time, pose),
            ft_wrench=Channel(trial.ft_wrench.time, force),
        )  # fmt: skip

    dataset = straight_pushes(8)
    trials = tuple(noisy(waited(trial)) for trial in dataset.trials)
    return replace(dataset, trials=trials, noise=declared)


def test_noise_declared_too_small_is_told():
    check = check_dataset(noisy_pushes(Noise(position=2e-5, angle=2e-4, force=0.005)))
    texts = [one.found for one in check.findings if one.what == "noise" and one.verdict == "note"]
    assert [text.split(" scatter")[0] for text in texts] == ["positions", "angles", "forces without contact"]
    right = check_dataset(noisy_pushes(Noise(position=2e-4, angle=2e-3, force=0.05)))
    assert right.headline == "The recording is sound."


def test_noise_is_no_coasting():
    assert check_dataset(noisy_pushes(Noise())).coverage.coasting == 0


def test_sliding_without_the_finger_is_coasting():
    def slides(trial):
        time, pose = trial.object_pose.time, trial.object_pose.values
        way = pose[60, :2] - pose[0, :2]
        free = np.clip((time - 0.9) / 0.2, 0.0, 1.0)[:, None] * 0.01 * way / np.hypot(*way)
        return replace(trial, object_pose=Channel(time, pose + np.column_stack([free, 0.0 * time])))

    dataset = straight_pushes(8)
    check = check_dataset(replace(dataset, trials=tuple(map(slides, dataset.trials))))
    assert check.coverage.coasting == 8


@pytest.mark.parametrize(
    ("fastest", "coasting", "could"), [(0.15, 0, False), (0.15, 2, True), (0.25, 0, True)]
)
def test_a_centre_of_mass_shows_where_objects_coast_or_are_thrown(fastest, coasting, could):
    seen = check_dataset(straight_pushes(8)).coverage
    told = quantities_shown(replace(seen, fastest=fastest, turned=0.5, coasting=coasting))
    (inertia,) = (one for one in told if one.name == "centre of mass, moment of inertia")
    assert inertia.could is could and f"coast: {coasting}" in inertia.reason


@pytest.mark.parametrize(
    ("pushes", "fastest", "told"),
    [
        (8, 0.0004, "fastest 0.4 mm/s"),
        (8, 1.2345, "fastest 1230 mm/s"),
        (8, 0.0, "no poses while it moves"),
        (0, 0.0, "fastest 0 mm/s"),
    ],
)
def test_a_speed_is_told_where_it_was_measured(pushes, fastest, told):
    seen = check_dataset(straight_pushes(8)).coverage
    reasons = [one.reason for one in quantities_shown(replace(seen, pushes=pushes, fastest=fastest))]
    assert sum(told in reason for reason in reasons) == 1


@pytest.mark.parametrize(
    ("declared", "advice"), [(None, "rounded on export"), (1e-4, "0.00029 m or more"), (5e-4, "export")]
)
def test_rounded_poses_are_told(declared, advice):
    dataset = straight_pushes(8)
    trials = tuple(map(posed(lambda pose: np.round(pose / 1e-3) * 1e-3), dataset.trials))
    check = check_dataset(replace(dataset, trials=trials, noise=Noise(position=declared)))
    found = finding(check, "rounding")
    assert found.found == "positions come in steps of 1 mm" and advice in found.advice


def test_milliseconds_and_a_frozen_tracker_are_wrong():
    def slow(trial):
        channels = {name: Channel(1e3 * c.time, c.values) for name, c in trial.channels.items()}
        return replace(trial, **channels)

    def frozen(trial):
        start = np.tile(trial.object_pose.values[0], (len(trial.object_pose.time), 1))
        return replace(trial, object_pose=Channel(trial.object_pose.time, start))

    assert "times in s" in finding(changed(slow), "units and frames").advice
    assert "frozen" in finding(changed(frozen), "units and frames").advice


@pytest.mark.parametrize("every", [1, 10])
def test_noise_that_is_not_declared_is_no_depth(every):
    rng = np.random.default_rng(0)

    def noisy(trial):
        pose = trial.object_pose
        values = pose.values + rng.normal(0.0, [2e-3, 2e-3, 0.01], pose.values.shape)
        return replace(trial, object_pose=Channel(pose.time[::every], values[::every]))

    check = changed(noisy)
    assert finding(check, "contact").verdict != "wrong"
    assert all(one.verdict == "good" for one in check.findings if one.what == "clock of the finger")


def test_one_push_alone_has_an_uncertain_clock():
    """Of a single noisy push, the spread over pushes says nothing."""
    rng = np.random.default_rng(3)
    trial = waited(straight_pushes(1).trials[0])
    pose = trial.object_pose
    noisy = Channel(pose.time, pose.values + rng.normal(0.0, [1e-3, 1e-3, 3e-3], pose.values.shape))
    check = check_dataset(replace(straight_pushes(1), trials=(replace(trial, object_pose=noisy),)))
    assert float(finding(check, "clock of the finger").found.split("± ")[1].split(" ms")[0]) > 3.0


def test_tracks_that_jump_or_turn_in_degrees_are_wrong():
    def jumps(pose):
        return pose + np.where(np.arange(len(pose)) > len(pose) - 12, 0.05, 0.0)[:, None] * [1.0, 0.0, 0.0]

    def degrees(pose):
        return np.column_stack([pose[:, :2], np.linspace(0.0, 30.0, len(pose))])

    found = finding(changed(posed(jumps)), "jumps")
    assert found.verdict == "wrong" and "50 mm" in found.found and "8 of 8 pushes" in found.found
    found = finding(changed(posed(degrees)), "angles")
    assert found.verdict == "wrong" and "were these degrees?" in found.advice

    def spun(trial):
        return posed(degrees)(tipped(lambda tip: tip + 100.0)(trial))

    assert finding(changed(spun), "angles").verdict == "note"
    dataset = straight_pushes(8)
    mixed = [spun(one) if number % 2 else one for number, one in enumerate(dataset.trials)]
    assert finding(check_dataset(replace(dataset, trials=tuple(mixed))), "angles").verdict == "note"


def test_a_constant_angle_in_degrees_blames_nothing_else():
    def upright(trial):
        """As if the bar had lain at 0 rad, and degrees were recorded."""
        back = -trial.object_pose.values[0, 2]
        tips = rotated(trial.tip_pose.values, back)
        poses = np.column_stack([rotated(trial.object_pose.values[:, :2], back), np.full(len(tips), 90.0)])
        forces = np.column_stack([rotated(trial.ft_wrench.values[:, :2], back), np.zeros(len(tips))])
        channels = zip(trial.channels.items(), (poses, tips, forces), strict=True)
        return replace(trial, **{name: Channel(one.time, values) for (name, one), values in channels})

    check = changed(upright)
    assert [one.what for one in check.findings if one.verdict == "wrong"] == ["angles"]
    assert "angles seem to be in degrees" in finding(check, "contact").found


def test_pushes_that_push_nothing_are_told_as_such():
    """Not as a force in a wrong unit, though there is none to speak of."""

    def missed(trial):
        pose = np.tile(trial.object_pose.values[0], (len(trial.object_pose.time), 1))
        force = 0.01 * np.sin(np.arange(3.0 * len(pose))).reshape(-1, 3)
        channels = {"object_pose": pose, "tip_pose": trial.tip_pose.values + 0.3, "ft_wrench": force}
        return replace(
            trial, **{name: Channel(trial.channels[name].time, values) for name, values in channels.items()}
        )

    dataset = replace(straight_pushes(8), mass=1.0)
    check = check_dataset(replace(dataset, trials=tuple(missed(one) for one in dataset.trials)))
    assert [one.what for one in check.findings if one.verdict == "wrong"] == ["contact"]
    assert finding(check, "contact").found == "no object moves, and no finger reaches one in any push"


def test_an_outline_in_a_far_frame_makes_no_advice_to_change_a_clock(shared_data):
    """As one drawn from a corner, where the tracked frame is in the middle."""
    folder = shared_data / "effects" / "public-none"
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    dataset = read_dataset(folder)
    corner = cells_from_polygon(dataset.grid.exterior - dataset.grid.exterior.min(axis=0))
    check = check_dataset(replace(dataset, grid=corner, trials=dataset.trials[:8]))
    assert check.wrong
    clock = [one.advice for one in check.findings if one.what == "clock of the finger"]
    assert not any(advice.startswith("add ") for advice in clock)


def test_a_finger_far_away_is_told_as_such():
    check = changed(tipped(lambda tip: np.full_like(tip, 100.0)))
    assert finding(check, "contact").found == "no finger comes within 1 m of the object"
    moved = finding(changed(tipped(lambda tip: tip + 100.0)), "contact")
    assert moved.verdict == "wrong" and moved.advice.startswith("is the tip in m")


def test_the_force_at_rest_is_that_before_the_finger_moves_if_frames_are_wrong():
    """A finger that never touches by its record is not free of contact all the time."""

    def elsewhere(trial):
        """Most rows are of the push."""
        moves = {"tip_pose": [0.3, 0.2], "ft_wrench": [0.3, -0.4, 0.0], "object_pose": [0.0, 0.0, 0.0]}
        channels = {
            name: Channel(channel.time[40:127], channel.values[40:127] + np.array(moves[name]))
            for name, channel in trial.channels.items()
        }
        return replace(trial, **channels)

    assert "(0.300, -0.400) N" in finding(changed(elsewhere), "force at rest").found


def test_unseen_motion_is_told():
    def gap(trial):
        kept = np.r_[0:80, 115 : len(trial.object_pose.time)]
        return replace(
            trial, object_pose=Channel(trial.object_pose.time[kept], trial.object_pose.values[kept])
        )

    assert finding(changed(gap), "rate of poses").verdict == "note"


def test_twenty_hertz_with_rounded_stamps_are_enough():
    time = 0.05 * (1.0 + 1e-15) * np.arange(24)

    def sampled(trial):
        return replace(trial, **{name: Channel(time, one.at(time)) for name, one in trial.channels.items()})

    assert finding(changed(sampled), "rate of finger").verdict == "good"


def test_coverage_and_what_is_missing():
    check = check_dataset(straight_pushes(8))
    assert check.coverage.pushes == 8 and check.coverage.forces
    assert check.coverage.fastest == pytest.approx(0.08, rel=0.05)
    assert not check.coverage.speeds_differ
    told = {one.name: one.could for one in (*check.quantities, *check.effects)}
    assert all(one.reason.startswith("needs ") != one.could for one in check.effects)
    assert {type(one.could) for one in (*check.quantities, *check.effects)} == {bool}
    assert told["total friction"] and not told["stribeck_friction"]
    assert any("twice as fast" in wanted for wanted in check.advice)
    still = changed(posed(lambda pose: 0.0 * pose + pose[0]))
    assert still.coverage.pushes == 0 and not any(
        one.could for one in still.quantities if "centre" in one.name
    )


def test_every_effect_of_the_library_has_its_needs():
    assert EFFECT_NEEDS.keys() == {effect.name for effect in LIBRARY}


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("cases/force_in_rotated_frame", "force's direction"),
        ("cases/theta_sign_wrong_y_up", "contact"),
        ("cases/tip_is_flange_not_finger", "contact"),
        ("effects/public-latency", "clock of the finger"),
        ("real/mcube_steel", "clock of the finger"),
        ("cases/force_right_frame_reference", None),
        ("real_feet/board_feet2", None),
    ],
)
def test_measured_pushes(shared_data, name, wrong):
    check = check_dataset(read_dataset(shared_data / name, tell=lambda text: None))
    found = [one.what for one in check.findings if one.verdict == "wrong"]
    assert (wrong in found) if wrong else not found, check.findings


def test_a_row_is_no_lag_of_the_force():
    def early(trial):
        return replace(trial, ft_wrench=Channel(trial.ft_wrench.time - 0.01, trial.ft_wrench.values))

    found = finding(changed(early), "clock of the force")
    assert found.verdict == "good" and not found.advice
    assert float(found.found.split("± ")[1].split(" ms")[0]) >= 10.0


def ell():
    return 0.01 * np.array([[-5, -3], [7, -3], [7, 0.5], [-1, 0.5], [-1, 5], [-5, 5]])


def simulated(count, length, speed=(0.03, 0.1), seed=0):
    """Simulated pushes of an L without any fault."""
    grid = cells_from_polygon(ell(), count=20)
    maps = Maps(np.full((1, len(grid)), 0.6 / len(grid)), np.full((1, len(grid)), 0.3), np.array([0.25]))
    rng = np.random.default_rng(seed)
    chosen = candidate_pushes(grid, RADIUS, rng, count, length=length, speed=speed)
    poses = rng.uniform([-0.1, -0.1, -np.pi], [0.1, 0.1, np.pi], (count, 3))
    pushes = [one.push(pose) for one, pose in zip(chosen, poses, strict=True)]
    return record_pushes(Slider(grid, RADIUS), maps, pushes, rng, mass=0.6, height=0.03)


@pytest.mark.parametrize(("off", "words"), [(2e-3, "large"), (-2e-3, "small")])
def test_a_wrong_radius_is_told_beside_the_clock(off, words):
    """A radius or outline off by 2 mm looks like lags; where speeds differ, it is told apart."""
    pushed = simulated(8, (0.04, 0.08))
    check = check_dataset(replace(pushed, finger_radius=RADIUS + off))
    found = finding(check, "clock of the finger")
    assert found.verdict == "note"
    told = float(found.found.split("or the outline ")[1].split(f" mm too {words}")[0])
    assert told == pytest.approx(2.0, abs=0.7)
    assert "is finger.radius 6.0 mm rather than" in found.advice and f"too {words}?" in found.advice
    # The time of touch is then wrong, too.
    assert check.headline == "The recording is usable, with a doubt about: clock of the finger."


def test_a_radius_that_only_looks_like_a_clock_is_told_too():
    dataset = straight_pushes(8)
    trials = tuple(waited(one) for one in dataset.trials)
    check = check_dataset(replace(dataset, finger_radius=RADIUS - 2e-3, trials=trials))
    found = finding(check, "clock of the finger")
    assert found.verdict == "note" and "or finger.radius or the outline 2.0 mm too small" in found.found


@pytest.mark.parametrize("speed", [(0.03, 0.1), (0.2, 0.4)])
def test_short_pushes_show_no_clock(speed):
    """A wide span over which slow motion is seen must not take rest for motion."""
    for seed in range(3):
        check = check_dataset(simulated(15, (0.002, 0.004), speed, seed))
        assert check.headline == "The recording is sound.", check.findings


def test_few_pushes_that_move_are_told_as_such():
    advice = check_dataset(simulated(8, (0.001, 0.002))).advice
    assert advice[0].startswith("6 more pushes that move the object by 5 mm or more")


def test_a_wrong_frame_is_no_clock():
    """A frame beside the outline's looks like lags that contradict each other."""

    def beside(pose):
        return pose + np.column_stack([rotated(np.array([0.008, 0.005]), pose[:, 2]), 0.0 * pose[:, 0]])

    pushed = simulated(8, (0.04, 0.1), seed=4)
    check = check_dataset(replace(pushed, trials=tuple(map(posed(beside), pushed.trials))))
    found = finding(check, "clock of the finger")
    assert found.verdict == "note" and "the tracked frame lies at (8, 5" in found.advice
    assert check.headline == "Wrong: contact."


def test_two_late_pushes_are_a_doubt():
    """Two pushes alone are too few to call a clock wrong."""

    def late(trial):
        return replace(trial, tip_pose=Channel(trial.tip_pose.time + 0.05, trial.tip_pose.values))

    dataset = straight_pushes(8)
    trials = [late(waited(one)) for one in dataset.trials]
    verdicts = [
        finding(check_dataset(replace(dataset, trials=tuple(trials[:count]))), "clock of the finger").verdict
        for count in (2, 3)
    ]
    assert verdicts == ["note", "wrong"]


@pytest.mark.parametrize(("axis", "seed"), [(0, 2), (1, 2)])
def test_a_mirrored_outline_is_named(tmp_path, axis, seed):
    dataset = simulated(15, (0.02, 0.04), seed=seed)
    sides = np.where(np.arange(2) == axis, -1.0, 1.0)
    mirrored = cells_from_polygon((ell() * sides)[::-1], count=20)
    written = write_dataset(replace(dataset, grid=mirrored), tmp_path / "pushes")
    check = check_dataset(read_dataset(written, tell=lambda text: None))
    assert "contact" in check.headline
    assert f"is the outline mirrored in {'xy'[axis]}?" in finding(check, "contact").advice


def test_one_push_that_is_too_deep_is_a_doubt():
    dataset = straight_pushes(8)
    deep = tipped(lambda tip: tip + np.array([0.01, 0.0]))
    trials = [deep(waited(one)) if number == 2 else waited(one) for number, one in enumerate(dataset.trials)]
    found = finding(check_dataset(replace(dataset, trials=tuple(trials))), "contact")
    assert found.verdict == "note" and "too deep in 1 of 8 pushes" in found.found and found.advice


@pytest.mark.parametrize(
    ("warning", "subject"),
    [
        (
            "a/dataset.yaml: object.cells: 32 of 60 centres lie outside the outline, first row 7",
            "object.cells",
        ),
        ("a/dataset.yaml: object.height is 30 m over a footprint of 0.12 m; are both in m?", "object.height"),
        ("b.json: the force points against the finger's motion; is its sign reversed?", "force"),
        ("b.json: the finger goes 23 mm into the object during 1 of 9 pushes; kept as requested", "contact"),
        ("b.json: the tip's rows end while it is still moving; it is held", "reading"),
        ("b.json: the finger goes 12 mm into the object; left out; to keep it, set `keep: true`", None),
        ("b.json: the object moves 0.04 m; the recording was cut there into 2 pushes", None),
        ("b.json, tip_pose; c.json, tip_pose: goes from here to there; is this right?", "reading"),
    ],
)
def test_what_reading_doubts_is_not_sound(warning, subject):
    check = check_dataset(replace(straight_pushes(8), warnings=(warning,)))
    doubt = f"The recording is usable, with a doubt about: {subject}."
    assert check.headline == (doubt if subject else "The recording is sound.")
    (told,) = [one for one in check.findings if warning.startswith(one.found)]
    assert told.verdict == "note" and ": " in told.found
    assert not check.wrong
