"""Contact over whole pushes: what is common to all is named and kept, single pushes are left out."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from straight_pushes import RADIUS, forced, posed, reread, straight_pushes, tipped

from slipmap.models.geometry import compose, rotated
from slipmap.models.measurements import Channel, DatasetError, read_dataset, write_dataset
from slipmap.models.measurements.contact import contact_rows
from slipmap.models.measurements.trial_checks import fault_of_frame


def same(trial):
    return trial


def in_unit(metres):
    def of(trial):
        pose, tip = trial.object_pose.values, trial.tip_pose.values
        longer = posed(lambda _: pose / [metres, metres, 1.0])(trial)
        return tipped(lambda _: tip / metres)(longer)

    return of


def late(seconds):
    return lambda trial: replace(
        trial, object_pose=Channel(trial.object_pose.time + seconds, trial.object_pose.values)
    )


def test_exact_contact_is_read_without_a_word(tmp_path):
    dataset = reread(tmp_path, straight_pushes(), same)
    assert dataset.warnings == () and len(dataset.trials) == 12


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (posed(lambda pose: pose * [1.0, 1.0, -1.0]), ["is theta's sign right?"]),
        (
            posed(lambda pose: np.add(pose, [0.0, 0.0, np.pi / 2])),
            ["is theta, or the outline, rotated by", "90°?"],
        ),
        (tipped(lambda tip: np.add(tip, [0.006, -0.003])), ["tip_offset (6, -3) mm", "not the flange"]),
        (
            posed(lambda pose: compose(pose, np.array([0.004, 0.005, 0.0]))),
            [
                "tracked frame lies at (4, 5) mm in the object frame",
                "rotated by 0.0°",
                "effect tracker_offset",
            ],
        ),
        (late(0.06), ["are the object's poses stamped 60 ms late?"]),
    ],
)
def test_what_is_common_to_all_pushes_is_named_and_kept(tmp_path, change, words):
    dataset = reread(tmp_path, straight_pushes(), change)
    assert len(dataset.trials) == 12
    deep = [warning for warning in dataset.warnings if "one correction would" in warning]
    assert len(deep) == 1, dataset.warnings
    for word in ["the object", "of 12 pushes; one correction would make it 0.0 mm", *words]:
        assert word in deep[0], deep[0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (posed(lambda pose: pose * [1.0, 1.0, -1.0]), "is theta's sign right?"),
        (posed(lambda pose: np.add(pose, [0.0, 0.0, np.pi / 2])), "rotated by"),
        (tipped(lambda tip: np.add(tip, [0.006, -0.003])), None),
        (posed(lambda pose: pose), None),
        (in_unit(0.01), "of its outline; are positions in m?"),
        (in_unit(0.0254), "of its outline; are positions in m?"),
        (tipped(lambda tip: np.add(np.multiply(tip, 1e3), 1e4)), "is the tip in m"),
        (tipped(lambda tip: np.full_like(tip, 9.0)), None),
    ],
)
def test_a_frame_that_no_effect_can_mend_is_told(tmp_path, change, words):
    dataset = reread(tmp_path, straight_pushes(), change)
    fault = fault_of_frame(dataset, dataset.trials)
    assert fault is None if words is None else words in fault
    # What an effect explains is told among the warnings alone.
    assert fault is None or any(fault in warning for warning in dataset.warnings)


def test_warnings_reach_python(tmp_path, caplog):
    dataset = reread(tmp_path, straight_pushes(), tipped(lambda tip: np.add(tip, [0.006, -0.003])))
    assert [record.getMessage() for record in caplog.records] == list(dataset.warnings)
    assert caplog.records[0].levelname == "WARNING" and "tip_offset (6, -3) mm" in caplog.text
    told = []
    read_dataset(tmp_path / "pushes", tell=told.append)
    assert told == list(dataset.warnings) and len(caplog.records) == 1


def test_a_finger_thicker_than_it_is_and_what_nothing_explains(tmp_path):
    thick = replace(straight_pushes(), finger_radius=RADIUS + 0.005)
    (warning,) = reread(tmp_path, thick, same).warnings
    assert "the finger goes 5.0 mm into the object during 12 of 12" in warning
    assert "is finger.radius 6.1 mm rather than 11.0 mm" in warning

    def scattered(trial):
        number = int(trial.name[7:10])
        return tipped(lambda tip: tip + 0.012 * np.array([np.cos(number**2), np.sin(number**2)]))(trial)

    warnings = reread(tmp_path, straight_pushes(), scattered).warnings
    (deep,) = [warning for warning in warnings if "the finger goes" in warning]
    assert "check theta's sign, the frames, the clocks" in deep


def test_no_correction_is_named_that_only_moves_the_finger_away(tmp_path):
    """A tool whose flange was recorded, 30 mm from the finger, and that turns while it pushes."""

    def flange(trial):
        turned = 1.2 * trial.tip_pose.time + 0.7 * int(trial.name[-6])
        return tipped(lambda tips: tips - rotated(np.tile([0.03, 0.01], (len(tips), 1)), turned))(trial)

    warnings = reread(tmp_path, straight_pushes(8), flange).warnings
    assert any("mm inside the object in" in text for text in warnings)
    assert not any("tip_offset" in text for text in warnings)  # 130 mm away it would go nowhere deep


def test_single_pushes_are_left_out_and_can_be_kept(tmp_path):
    deeper = tipped(lambda tip: tip + 0.3 * (tip[-1] - tip[0]) / np.hypot(*(tip[-1] - tip[0])) * 0.03)
    dataset = reread(tmp_path, straight_pushes(), deeper, only=5)
    (warning,) = dataset.warnings
    assert warning.startswith(
        "trials/005.json: the finger goes 9.0 mm into the object, but contact fits in 11 of 12"
    )
    assert "left out; to keep it, set `keep: true` beside its file" in warning
    assert len(dataset.trials) == 11 and "trials/005.json" not in [trial.name for trial in dataset.trials]
    assert [trial.order for trial in dataset.trials] == [*range(5), *range(6, 12)]

    path = tmp_path / "pushes" / "dataset.yaml"
    document = yaml.safe_load(path.read_text())
    document["trials"][5]["keep"], document["trials"][7]["keep"] = True, False
    path.write_text(yaml.safe_dump(document))
    forced_ = read_dataset(path.parent)
    names = [trial.name for trial in forced_.trials]
    assert "trials/005.json" in names and "trials/007.json" not in names
    assert "kept as requested" in forced_.warnings[0]
    again = read_dataset(write_dataset(forced_, tmp_path / "again"))
    assert [(t.name, t.order) for t in again.trials] == [(t.name, int(t.name[7:10])) for t in forced_.trials]
    assert len(read_dataset(write_dataset(forced_, tmp_path / "third"), keep_all=True).trials) == 11
    document["trials"][5]["keep"] = "yes please"
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(DatasetError, match="trials, row 5: keep must be true or false, got 'yes please'"):
        read_dataset(path.parent)


def test_of_few_pushes_none_is_left_out(tmp_path):
    """Of four, one says little about the others; the last push to learn from stays in any case."""
    deeper = tipped(lambda tip: tip + 0.3 * (tip[-1] - tip[0]) / np.hypot(*(tip[-1] - tip[0])) * 0.03)
    four = reread(tmp_path, straight_pushes(4), deeper, only=2)
    assert len(four.trials) == 4 and "1 of 4 pushes; check theta's sign, the frame" in four.warnings[0]
    one_fit = straight_pushes(8)
    trials = tuple(replace(t, role="fit" if n == 1 else "heldout") for n, t in enumerate(one_fit.trials))
    assert len(reread(tmp_path, replace(one_fit, trials=trials), deeper, only=1).trials) == 8


def test_one_push_tells_no_offset(tmp_path):
    """Three numbers explain any single push."""
    tip = tipped(lambda tip: np.add(tip, [0.012, 0.012]))
    (warning,) = [w for w in reread(tmp_path, straight_pushes(1), tip).warnings if "the finger" in w]
    assert "1 of 1 pushes; check theta's sign, the frames, the clocks" in warning


def test_a_finger_that_starts_inside_is_no_reason_to_refuse(tmp_path):
    inside = tipped(lambda tip: tip + (tip[60] - tip[0]) / np.hypot(*(tip[60] - tip[0])) * 0.008)
    (warning,) = reread(tmp_path, straight_pushes(), inside).warnings
    assert "of 12 pushes" in warning and "8.0 mm" in warning


@pytest.mark.parametrize("turned", [90, -90, 120])
def test_a_force_in_another_frame_is_named_with_its_turn(tmp_path, turned):
    def change(wrench):
        return np.column_stack([rotated(wrench[:, :2], np.radians(turned)), wrench[:, 2]])

    (warning,) = reread(tmp_path, straight_pushes(), forced(change)).warnings
    assert f"on 100 % of the rows; rotated by about {-turned}°" in warning
    assert "100 % would fit; ft_wrench must be the force of the finger on the object in the world" in warning


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda w: -w, "with its sign reversed, as if it were the force of the object on the finger"),
        (lambda w: w * [-1, 1, 1], "with fx negated"),
        (lambda w: w * [1, -1, 1], "with fy negated"),
        (lambda w: w[:, [1, 0, 2]], "with fx and fy swapped 100 %"),
    ],
)
def test_a_force_with_other_axes_is_named(tmp_path, change, words):
    (warning,) = reread(tmp_path, straight_pushes(), forced(change)).warnings
    assert words in warning


def test_a_force_in_the_objects_frame_is_named(tmp_path):
    def change(trial):
        theta = trial.object_pose.at(trial.ft_wrench.time)[:, 2]
        wrench = trial.ft_wrench.values
        turned = np.column_stack([rotated(wrench[:, :2], -theta), wrench[:, 2]])
        return replace(trial, ft_wrench=Channel(trial.ft_wrench.time, turned))

    (warning,) = reread(tmp_path, straight_pushes(), change).warnings
    assert "rotated by theta, as if from the object frame, 100 % would fit" in warning


def test_a_force_within_friction_is_no_fault(tmp_path):
    def change(wrench):
        return np.column_stack([rotated(wrench[:, :2], 0.5), wrench[:, 2]])

    assert reread(tmp_path, straight_pushes(), forced(change)).warnings == ()


def case(shared_data, name):
    folder = shared_data / "cases" / name
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    return read_dataset(folder)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("theta_sign_wrong_y_up", ["goes 12 mm into the object during 10 of 10", "is theta's sign right?"]),
        ("tip_is_flange_not_finger", ["tip_offset (4, -2) mm"]),
        ("force_in_rotated_frame", ["off the contact normal", "rotated by about -90°"]),
    ],
)
def test_shared_cases_are_named(shared_data, name, words):
    (warning,) = case(shared_data, name).warnings
    assert all(word in warning for word in words), warning


def test_the_reference_of_the_rotated_force_is_read_without_a_word(shared_data):
    assert case(shared_data, "force_right_frame_reference").warnings == ()


@pytest.mark.parametrize("kind", ["real_mit", "real_feet", "edge", "engines"])
def test_good_measurements_have_no_warning(shared_data, kind):
    for path in sorted(shared_data.glob(f"{kind}/*/dataset.yaml")):
        assert read_dataset(path).warnings == (), path


def seldom_seen(trial):
    """Four times as fast as the others, and seen so seldom that no pose tells when the bar stops."""
    pose, tip, wrench = trial.object_pose, trial.tip_pose, trial.ft_wrench
    rows = np.isin(np.arange(len(pose.time)), range(0, len(pose.time), 40))
    return replace(
        trial,
        object_pose=Channel(pose.time[rows] / 4.0, pose.values[rows]),
        tip_pose=Channel(tip.time / 4.0, tip.values),
        ft_wrench=Channel(wrench.time / 4.0, wrench.values),
    )


def test_between_poses_that_are_far_apart_nothing_is_said_of_contact(tmp_path):
    """The bar stops between two poses; a line between them has the finger 7 mm in the bar."""
    dataset = reread(tmp_path, straight_pushes(), seldom_seen, only=5)
    assert len(dataset.trials) == 12 and not any("into" in warning for warning in dataset.warnings)


def test_the_first_pose_is_compared_whatever_follows(tmp_path):
    """Where the object starts and stops within one interval, too."""

    def jerked(trial):
        pose = trial.object_pose
        return replace(trial, object_pose=Channel(pose.time[[0, -40, -1]], pose.values[[0, -40, -1]]))

    dataset = reread(tmp_path, straight_pushes(), jerked)
    assert len(dataset.trials) == 12
    for trial in dataset.trials:
        assert contact_rows(dataset, [trial])[0].time[0] == trial.object_pose.time[0]


def test_an_outline_that_may_be_off_allows_as_much_more_depth():
    dataset = straight_pushes()
    exact, off = (
        contact_rows(replace(dataset, noise=replace(dataset.noise, outline=outline)), dataset.trials)[
            0
        ].allowed
        for outline in (None, 1e-2)
    )
    assert exact < 0.01 < 0.03 < off < 0.04


def test_one_push_that_seems_deep_is_not_left_out_if_few_others_can_be_judged(tmp_path):
    """Contact of pushes whose angles are in degrees is not judged."""
    dataset = straight_pushes(6)

    def degrees(pose):
        return pose + np.column_stack([0.0 * pose[:, :2], np.linspace(0.0, 30.0, len(pose))])

    trials = (tipped(lambda tip: np.add(tip, [0.012, 0.012]))(dataset.trials[0]),)
    trials += tuple(map(posed(degrees), dataset.trials[1:]))
    read = reread(tmp_path, replace(dataset, trials=trials), same)
    assert len(read.trials) == 6 and not [text for text in read.warnings if "left out" in text]


def in_millimetres(trial):
    scaled = posed(lambda pose: pose * [1e3, 1e3, 1.0])(trial)
    return tipped(lambda tip: np.multiply(tip, 1e3))(scaled)


def aside(trial):
    return tipped(lambda tip: np.add(tip, [0.3, 0.3]))(trial)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (in_millimetres, ["moves 50 m (are positions in m?), but in the other pushes a median of 50 mm; "]),
        (aside, ["moves 50 mm, but the finger stays ", " mm or more away from it; "]),
    ],
)
def test_a_single_push_that_cannot_be_one_is_left_out_and_can_be_kept(tmp_path, change, words):
    dataset = reread(tmp_path, straight_pushes(), change, only=5)
    (warning,) = dataset.warnings
    assert warning.startswith("trials/005.json: the object moves ")
    assert all(word in warning for word in [*words, "left out; to keep it, set `keep: true`"]), warning
    assert "trials/005.json" not in [trial.name for trial in dataset.trials]

    kept = read_dataset(tmp_path / "pushes", keep_all=True)
    assert len(kept.trials) == 12 and any("kept as requested" in text for text in kept.warnings)
    everywhere = reread(tmp_path, straight_pushes(), change)
    assert len(everywhere.trials) == 12 and not any("left out" in text for text in everywhere.warnings)
    assert len(reread(tmp_path, straight_pushes(4), change, only=2).trials) == 4


def test_none_is_left_out_where_the_others_do_not_touch_either(tmp_path):
    def behind(trial):
        """By 12 mm, and in one push by 60 mm."""
        way = trial.tip_pose.values[60] - trial.tip_pose.values[0]
        gap = 0.06 if trial.name == "trials/005.json" else 0.012
        return tipped(lambda tip: tip - gap * way / np.hypot(*way))(trial)

    assert len(reread(tmp_path, straight_pushes(), behind).trials) == 12


def ends(channel):
    return Channel(channel.time[[0, -1]], channel.values[[0, -1]])


def returned(trial):
    """The finger goes back to where it came from, 30 mm away, and is seen at its start and end alone."""
    inward = trial.tip_pose.values[60] - trial.tip_pose.values[0]
    start = trial.tip_pose.values[0] - 0.03 * inward / np.hypot(*inward)
    return replace(trial, tip_pose=Channel(trial.tip_pose.time[[0, -1]], np.array([start, start])))


def seen_before_and_after(trial):
    return replace(trial, object_pose=ends(trial.object_pose), tip_pose=returned(trial).tip_pose)


@pytest.mark.parametrize("change", [returned, seen_before_and_after])
def test_a_finger_that_came_and_went_unseen_may_have_pushed(tmp_path, change):
    assert len(reread(tmp_path, straight_pushes(), change, only=5).trials) == 12
