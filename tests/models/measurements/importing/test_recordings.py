"""Which files belong together, what is cut, and what a guess says."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from tables import POSE, SETUP, TIME, TIP, written

from slipmap.models.measurements import DatasetError, read_dataset, write_dataset
from slipmap.models.measurements.importing import clocks, guess_setup, import_dataset
from slipmap.models.measurements.importing.import_setup import UNITS

ROOT = Path(__file__).resolve().parents[4]
SAYS = """
object_pose: {source: cam_*.csv, position: [x, y], angle: theta, clock: 0}
tip_pose: {source: robot_*.csv, position: [a, b], clock: 0.5}
"""


def pairs(tmp_path, count):
    for k in range(count):
        written(tmp_path / f"cam_{k}.csv", ["t", "x", "y", "theta"], [TIME, POSE + 0.01 * k])
        written(tmp_path / f"robot_{k}.csv", ["t", "a", "b"], [TIME - 0.5, TIP + 0.01 * k])


def test_files_go_together_by_what_stands_under_the_star(tmp_path):
    pairs(tmp_path, 3)
    (tmp_path / "s.yaml").write_text(SETUP + SAYS)
    (tmp_path / "README.txt").write_text("These are pushes.")
    dataset = import_dataset(tmp_path, tmp_path / "s.yaml", tell=lambda text: None)
    assert [trial.name for trial in dataset.trials] == ["cam_0.csv", "cam_1.csv", "cam_2.csv"]
    for k, trial in enumerate(dataset.trials):
        assert trial.tip_pose.values == pytest.approx(TIP + 0.01 * k, abs=1e-6)
        assert trial.tip_pose.time == pytest.approx(TIME)
    assert "tip_pose: 0.5 s added to the stamps" in dataset.provenance


def test_files_are_in_the_order_of_the_numbers_in_their_names(tmp_path):
    """Also in folders, and pushes 10 to 12 are held out, not 7 to 9."""
    for k in range(1, 13):
        folder = tmp_path / f"day {9 + (k > 10)}"
        folder.mkdir(exist_ok=True)
        written(folder / f"push_{k}.csv", ["t", "x", "y", "theta"], [TIME, POSE + 0.01 * k])
    (tmp_path / "s.yaml").write_text(SETUP + "object_pose: {position: [x, y]}\ntip_pose: null\n")
    dataset = import_dataset(tmp_path, tmp_path / "s.yaml", tell=lambda text: None)
    names = [f"day {9 + (k > 10)}/push_{k}.csv" for k in range(1, 13)]
    assert [trial.name for trial in dataset.trials] == names
    assert [trial.role for trial in dataset.trials] == ["fit"] * 9 + ["heldout"] * 3


def test_a_file_without_its_partner_is_named(tmp_path):
    pairs(tmp_path, 3)
    (tmp_path / "robot_1.csv").unlink()
    (tmp_path / "s.yaml").write_text(SETUP + SAYS)
    with pytest.raises(DatasetError, match=r"no file goes with cam_1\.csv"):
        import_dataset(tmp_path, tmp_path / "s.yaml")


def test_the_force_is_turned_only_if_asked(tmp_path):
    angle = 0.7
    size = 2.0 * (POSE[:, 0] > 0)
    columns = [TIME, POSE, TIP, size * np.cos(angle), size * np.sin(angle)]
    file = written(tmp_path / "p.csv", ["t", "x", "y", "theta", "a", "b", "fx", "fy"], columns)
    says = SETUP + "tip_pose: {position: [a, b]}\nft_wrench: {force: [fx, fy]%s}\n"
    for asked, direction in (("", angle), (", frame: contact", 0.0)):
        (tmp_path / "s.yaml").write_text(says % asked)
        (trial,) = import_dataset(file, tmp_path / "s.yaml", tell=lambda text: None).trials
        force = trial.ft_wrench.at(1.0)
        assert np.arctan2(force[1], force[0]) == pytest.approx(direction, abs=0.03)


@pytest.mark.parametrize("off", [-14, -8, 0, 8, 14])
def test_a_force_is_aligned_by_its_rise_wherever_it_is_large(tmp_path, monkeypatch, off):
    """Forces that grow or fall off late in a push mislead the search for when they are large, here by `off`
    steps of 20 ms."""
    found = clocks._correlated
    monkeypatch.setattr(clocks, "_correlated", lambda one, other: np.roll(found(one, other), off))
    fine = np.arange(0.0, 1.49, 1e-3)
    touch = TIME[np.argmax(POSE[:, 0] > 0)]
    force = 4.0 * ((fine > touch) & (fine < 1.2))
    written(tmp_path / "p.csv", ["t", "x", "y", "theta", "a", "b"], [TIME, POSE, TIP])
    written(tmp_path / "f.csv", ["t", "fx", "fy"], [fine + 5.0, force, 0.0 * fine])
    (tmp_path / "s.yaml").write_text(
        SETUP + "object_pose: {source: p.csv, position: [x, y], angle: theta}\n"
        "tip_pose: {source: p.csv, position: [a, b]}\nft_wrench: {source: f.csv, force: [fx, fy]}\n"
    )
    files = [tmp_path / "p.csv", tmp_path / "f.csv"]
    dataset = import_dataset(files, tmp_path / "s.yaml", tell=lambda text: None)
    (said,) = (text for text in dataset.provenance if "s added" in text)
    assert "by its rise" in said and float(said.split()[1]) == pytest.approx(-5.0, abs=0.012)


def test_a_guess_is_right_but_for_what_no_file_says(tmp_path):
    columns = [1e3 * TIME, 1e3 * POSE[:, :2], np.degrees(POSE[:, 2]) + 400.0, 1e3 * TIP]
    file = written(
        tmp_path / "p.csv", ["time", "block_x", "block_y", "block_theta", "tip_x", "tip_y"], columns
    )
    text = guess_setup(file)
    assert all("#" in line or ":" in line for line in text.splitlines())
    said = yaml.safe_load(text)
    assert said["object_pose"] == {
        "position": ["block_x", "block_y"], "angle": "block_theta", "time": "time",
        "unit": {"time": "ms", "position": "mm", "angle": "deg"},
    }  # fmt: skip
    said |= yaml.safe_load(SETUP)
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(said))
    (trial,) = import_dataset(file, tmp_path / "s.yaml", tell=lambda text: None).trials
    assert trial.object_pose.values[:, :2] == pytest.approx(POSE[:, :2], abs=1e-8)
    assert trial.tip_pose.values == pytest.approx(TIP, abs=1e-8)


def test_rotations_beside_positions_are_no_positions(tmp_path):
    """As in an export of Vicon, where RX, RY, RZ stand before TX, TY, TZ."""
    zero = np.zeros(len(TIME))
    columns = [TIME, zero, zero, POSE[:, 2], POSE[:, :2], zero]
    said = yaml.safe_load(
        guess_setup(written(tmp_path / "p.csv", ["t", "rx", "ry", "rz", "x", "y", "z"], columns))
    )
    assert said["object_pose"]["position"] == ["x", "y", "z"]
    assert said["object_pose"]["rotation_vector"] == ["rx", "ry", "rz"]
    named = written(tmp_path / "q.csv", ["t", "rx", "ry", "rz"], [*columns[:2], POSE[:, :2]])
    assert yaml.safe_load(guess_setup(named))["object_pose"]["position"] == ["rx", "ry", "rz"]


def test_an_axis_may_stand_before_what_moves(tmp_path):
    columns = [TIME, POSE[:, :2], POSE[:, 2], TIP, np.zeros((len(TIME), 2))]
    names = ["t", "x_box", "y_box", "yaw_box", "x_pusher", "y_pusher", "x_rate", "y_rate"]
    said = yaml.safe_load(guess_setup(written(tmp_path / "p.csv", names, columns)))
    assert said["object_pose"] == {"position": ["x_box", "y_box"], "angle": "yaw_box", "time": "t"}
    assert said["tip_pose"]["position"] == ["x_pusher", "y_pusher"]


def test_a_column_of_row_numbers_without_a_name_is_no_angle(tmp_path):
    columns = [np.arange(len(TIME)), TIME, POSE, TIP]
    names = ["", "t", "block_x", "block_y", "block_yaw", "tip_x", "tip_y"]
    said = yaml.safe_load(guess_setup(written(tmp_path / "p.csv", names, columns)))
    assert said["object_pose"]["angle"] == "block_yaw"


@pytest.mark.parametrize("angle", ["block_deg", "block [deg]"])
def test_a_column_of_degrees_named_after_the_object_is_its_angle(tmp_path, angle):
    columns = [TIME, 1e3 * POSE[:, :2], np.degrees(POSE[:, 2]), 1e3 * TIP]
    names = ["time", "block_x_mm", "block_y_mm", angle, "tip_x_mm", "tip_y_mm"]
    said = yaml.safe_load(guess_setup(written(tmp_path / "p.csv", names, columns)))
    assert said["object_pose"]["angle"] == angle
    assert said["object_pose"]["unit"] == {"position": "mm", "angle": "deg"}


def test_a_finger_that_moves_straight_says_nothing_of_up(tmp_path):
    height = 0.03 + 1e-4 * np.sin(50.0 * TIME)
    tip = [0.36 + 1e-6 * np.sin(TIME), TIP[:, 0], height]
    names = ["t", "block_x", "block_y", "block_z", "block_yaw", "tip_x", "tip_y", "tip_z"]
    file = written(tmp_path / "p.csv", names, [TIME, POSE[:, :2], height, POSE[:, 2], *tip])
    assert "up:" not in guess_setup(file)
    names[1:4] = "block_z", "block_x", "block_y"
    plane = POSE[:, :1] * [1.0, 0.3]
    file = written(tmp_path / "p.csv", names, [TIME, plane, height, POSE[:, 2], *tip])
    said = yaml.safe_load(guess_setup(file))
    assert said["object_pose"]["up"] == said["tip_pose"]["up"] == "y"


def test_a_finger_in_the_plane_has_no_axis_up(tmp_path):
    names = ["t", "block_z", "block_x", "block_y", "block_yaw", "tip_x", "tip_y"]
    plane, height = POSE[:, :1] * [1.0, 0.3], 0.03 + 0.0 * TIME
    file = written(tmp_path / "p.csv", names, [TIME, plane, height, POSE[:, 2], TIP])
    said = yaml.safe_load(guess_setup(file))
    assert said["object_pose"]["up"] == "y"
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(said | yaml.safe_load(SETUP)))
    (trial,) = import_dataset(file, tmp_path / "s.yaml", tell=lambda text: None).trials
    assert trial.tip_pose.values == pytest.approx(TIP, abs=1e-8)


def test_a_lone_yaw_is_the_angle(tmp_path):
    names = ["t", "puck_x", "puck_y", "yaw", "tip_x", "tip_y"]
    file = written(tmp_path / "p.csv", names, [TIME, POSE, TIP])
    said = yaml.safe_load(guess_setup(file))
    assert said["object_pose"]["position"] == ["puck_x", "puck_y"] and said["object_pose"]["angle"] == "yaw"

    # The tool's own angle is not taken for that of an object without one.
    (tmp_path / "two").mkdir()
    written(tmp_path / "two" / "camera.csv", ["t", "puck_x", "puck_y"], [TIME, POSE[:, :2]])
    written(tmp_path / "two" / "robot.csv", ["t", "tip_x", "tip_y", "yaw"], [TIME, TIP, 0.1 * TIME])
    said = yaml.safe_load(guess_setup(tmp_path / "two"))
    assert said["object_pose"]["position"] == ["puck_x", "puck_y"] and said["object_pose"]["angle"] is None


def test_a_guess_says_that_commas_may_mean_either(tmp_path):
    (tmp_path / "p.csv").write_text("t\tx\ty\tyaw\n1\t1,500\t2,500\t0\n")
    with pytest.raises(DatasetError, match=r"'1,500' may be 1\.5 or 1500"):
        guess_setup(tmp_path / "p.csv")


@pytest.mark.parametrize("stem", ['the "block" ', "block\\", "Klötzchen: "])
def test_a_guess_quotes_any_name(tmp_path, stem):
    names = ["t", f"{stem}x", f"{stem}y", f"{stem}yaw"]
    header = ",".join('"{}"'.format(name.replace('"', '""')) for name in names)
    rows = [",".join(f"{cell:.6f}" for cell in row) for row in np.column_stack([TIME, POSE])]
    (tmp_path / "p.csv").write_text("\n".join([header, *rows]), encoding="utf-8")
    text = guess_setup(tmp_path / "p.csv")
    assert yaml.safe_load(text)["object_pose"] == {"position": names[1:3], "angle": names[3], "time": "t"}
    assert "\\u" not in text


def test_columns_in_an_unknown_unit_are_named_with_the_known_ones(tmp_path):
    names = ["t", "block X (mm)", "block Y (mm)", "block_yaw", "probe X (in)", "probe Y (in)"]
    names += ["Fx (gf)", "Fy (gf)"]
    columns = [TIME, 1e3 * POSE[:, :2], POSE[:, 2], TIP / 0.0254, np.ones((len(TIME), 2))]
    text = guess_setup(written(tmp_path / "p.csv", names, columns))
    for channel, column, known in (
        ("tip_pose", "probe X (in)", "m, cm, mm, um"),
        ("ft_wrench", "Fx (gf)", "N, mN, kN"),
    ):
        told = f'the unit of "{column}" is unknown, so convert it; known units are {known}'
        assert f"{channel}: null  # {told}\n" in text
    assert yaml.safe_load(text)["object_pose"]["unit"] == {"position": "mm"}
    # Micrometres are known, too.
    names[4:6] = "probe X (um)", "probe Y (um)"
    columns[3] = 1e6 * TIP
    said = yaml.safe_load(guess_setup(written(tmp_path / "p.csv", names, columns)))
    assert said["tip_pose"]["unit"] == {"position": "um"}
    names[1:3] = "block X (in)", "block Y (in)"
    with pytest.raises(DatasetError, match=r"the unit of .block X \(in\). is unknown, so convert it"):
        guess_setup(written(tmp_path / "p.csv", names, columns))


def test_the_page_lists_all_units():
    page = (ROOT / "docs" / "import.md").read_text(encoding="utf-8")
    (row,) = re.findall(r"\| `unit` \| .*", page)
    for kind, units in UNITS.items():
        assert f"{kind} {', '.join(units)}" in row


def test_nothing_to_guess(tmp_path):
    (tmp_path / "p.csv").write_text("temperature,humidity\n1,2\n")
    with pytest.raises(DatasetError, match=r"nothing looks like an object's pose.*docs/import\.md"):
        guess_setup(tmp_path / "p.csv")


def test_small_numbers_may_be_in_millimetres_or_centimetres(tmp_path):
    for span, words in ((50.0, "size of the numbers (or cm?)"), (500.0, "size of the numbers\n")):
        rows = "".join(f"{k / 100},{span * k / 99},0,0\n" for k in range(100))
        (tmp_path / "p.csv").write_text("t,block_x,block_y,block_yaw\n" + rows)
        assert words in guess_setup(tmp_path / "p.csv")


def forces(tmp_path, late, short):
    """Four recordings whose force has a file of its own and is late; the third one begins in contact, and its
    force is large for `short` s."""
    touch = TIME[np.argmax(POSE[:, 0] > 0)]
    for k in range(4):
        rows = slice(60 if k == 2 else 0, None)
        until = touch + short if k == 2 else 1.2
        force = 2.0 * ((touch <= TIME) & (until > TIME)) + 0.02 * np.sin(40.0 * TIME + k)
        written(
            tmp_path / f"pose_{k}.csv", ["t", "x", "y", "theta", "a", "b"],
            [TIME[rows], POSE[rows] + 0.01 * k * np.array([1.0, 0, 0]), TIP[rows] + [0.01 * k, 0.0]],
        )  # fmt: skip
        written(
            tmp_path / f"force_{k}.csv", ["t", "fx", "fy"], [TIME[rows] + late, force[rows], 0.0 * TIME[rows]]
        )
    (tmp_path / "s.yaml").write_text(
        SETUP + "object_pose: {source: pose_*.csv, position: [x, y], angle: theta}\n"
        "tip_pose: {source: pose_*.csv, position: [a, b]}\n"
        "ft_wrench: {source: force_*.csv, force: [fx, fy]}\n"
    )


def test_a_force_on_the_same_clock_keeps_its_stamps(tmp_path):
    forces(tmp_path, late=0.0, short=0.3)
    said = []
    dataset = import_dataset(tmp_path, tmp_path / "s.yaml", tell=said.append)
    for trial in dataset.trials:
        assert trial.ft_wrench.time == pytest.approx(trial.object_pose.time, abs=1e-9)
    assert any("pose_2.csv: ft_wrench alone" in text for text in said), said


def test_a_clock_that_contact_does_not_show_is_that_of_the_session(tmp_path):
    forces(tmp_path, late=0.25, short=0.3)
    dataset = import_dataset(tmp_path, tmp_path / "s.yaml", tell=lambda text: None)
    for trial in dataset.trials:
        assert trial.ft_wrench.time == pytest.approx(trial.object_pose.time, abs=0.015)


def test_the_angle_of_a_finger_is_on_its_clock(tmp_path):
    written(tmp_path / "object.csv", ["t", "x", "y", "theta"], [TIME, POSE])
    written(tmp_path / "finger.csv", ["t", "x", "y", "theta"], [TIME + 100.0, TIP, 0.4 * TIME])
    (tmp_path / "s.yaml").write_text(
        SETUP + "object_pose: {source: object.csv}\n"
        "tip_pose: {source: finger.csv, position: [x, y], angle: theta}\n"
    )
    (trial,) = import_dataset(tmp_path, tmp_path / "s.yaml", tell=lambda text: None).trials
    assert trial.tip_pose.time == pytest.approx(TIME, abs=0.02)
    assert trial.tip_angle.at(trial.tip_pose.time)[:, 0] == pytest.approx(0.4 * TIME, abs=1e-6)


def test_a_force_that_no_touch_times_is_on_the_clock_of_the_finger_beside_it(tmp_path):
    """Of a row every 33 ms the rise of the force shows no clock; that it stands in the robot's file does."""
    dataset = read_dataset(ROOT / "diagrams" / "application" / "tilted_block")
    for k, trial in enumerate(dataset.trials[:3]):
        pose, tip, force = trial.object_pose, trial.tip_pose, trial.ft_wrench
        written(tmp_path / f"cam_{k}.csv", ["t", "x", "y", "theta"], [pose.time, pose.values])
        columns = [tip.time - 1.7, tip.values, force.at(tip.time)[:, :2]]
        written(tmp_path / f"robot_{k}.csv", ["t", "a", "b", "fx", "fy"], columns)
    outline = dataset.grid.exterior.tolist()
    (tmp_path / "s.yaml").write_text(
        f"object: {{outline: {outline}}}\nfinger: {{radius: 0.006}}\n"
        "object_pose: {source: cam_*.csv, position: [x, y], angle: theta}\n"
        "tip_pose: {source: robot_*.csv, position: [a, b]}\n"
        "ft_wrench: {source: robot_*.csv, force: [fx, fy]}\n"
    )
    read = import_dataset(tmp_path, tmp_path / "s.yaml")
    for trial, true in zip(read.trials, dataset.trials, strict=False):
        assert trial.tip_pose.time[0] == pytest.approx(true.tip_pose.time[0], abs=0.01)
        assert trial.ft_wrench.time[0] == trial.tip_pose.time[0]
    assert any("as for the finger in the same file" in step for step in read.provenance)


def test_midnight_is_no_new_start(tmp_path):
    seconds = 59.0 + TIME
    clock = [f"23:59:{now:09.6f}" if now < 60.0 else f"00:00:{now - 60.0:09.6f}" for now in seconds]
    places = np.column_stack([POSE, TIP])
    rows = (",".join([now, *map(str, row)]) for now, row in zip(clock, places, strict=True))
    (tmp_path / "p.csv").write_text("\n".join(["t,x,y,theta,a,b", *rows]))
    (tmp_path / "s.yaml").write_text(SETUP + "tip_pose: {position: [a, b]}\n")
    (trial,) = import_dataset(tmp_path / "p.csv", tmp_path / "s.yaml").trials
    assert np.diff(trial.object_pose.time) == pytest.approx(np.diff(TIME), abs=1e-6)


@pytest.mark.parametrize("clock", [0.0, 0.1, 1700000000.01])
def test_a_lifted_finger_touches_nothing_whatever_is_added_to_its_stamps(tmp_path, clock):
    """It passes over the object at the end."""
    since = 1.7e9 if clock > 1e9 else 0.0
    height = np.where(TIME < 1.3, 0.01, 0.08)
    over = np.where(TIME[:, None] < 1.3, TIP, TIP + np.array([0.04, 0.0]))
    written(tmp_path / "cam.csv", ["t", "x", "y", "theta"], [since + TIME, POSE])
    written(tmp_path / "robot.csv", ["t", "a", "b", "c"], [TIME + 0.0033 - clock + since, over, height])
    (tmp_path / "s.yaml").write_text(
        SETUP + "object_pose: {source: cam.csv}\n"
        f"tip_pose: {{source: robot.csv, position: [a, b, c], clock: {clock}}}\n"
    )
    (trial,) = import_dataset(tmp_path, tmp_path / "s.yaml", tell=lambda text: None).trials
    assert trial.tip_pose.values == pytest.approx(TIP[TIME < 1.3], abs=1e-6)


@pytest.mark.parametrize("again", [0.0, 0.02, -0.03])
def test_stamps_that_start_anew_part_the_pushes(tmp_path, again):
    columns = [
        np.concatenate([TIME, TIME + again, TIME]),
        *(np.concatenate([one, one + 0.01, one + 0.02]) for one in (POSE[:, :2], TIP)),
        np.tile(POSE[:, 2], 3),
    ]
    file = written(tmp_path / "p.csv", ["t", "x", "y", "a", "b", "theta"], columns)
    (tmp_path / "s.yaml").write_text(SETUP + "tip_pose: {position: [a, b]}\n")
    dataset = import_dataset(file, tmp_path / "s.yaml", tell=lambda text: pytest.fail(text))
    assert [trial.name for trial in dataset.trials] == ["p.csv#1", "p.csv#2", "p.csv#3"]
    for k, trial in enumerate(dataset.trials):
        assert trial.object_pose.values[:, :2] == pytest.approx(POSE[:, :2] + 0.01 * k, abs=1e-6)


def test_a_push_has_one_number_however_files_write_it(tmp_path):
    """A spreadsheet makes 1.0 of 1, and a robot writes 001."""
    numbers = np.repeat([1, 2], len(TIME))
    twice = [np.tile(TIME, 2), np.concatenate([POSE, POSE + 0.01])]
    written(tmp_path / "cam.csv", ["push_id", "t", "x", "y", "theta"], [numbers, *twice])  # 1.000000
    rows = zip(numbers, np.tile(TIME, 2), np.concatenate([TIP, TIP + 0.01]), strict=True)
    lines = ["push_id,t,a,b", *(f"{number:03d},{t},{a},{b}" for number, t, (a, b) in rows)]
    (tmp_path / "robot.csv").write_text("\n".join(lines))
    (tmp_path / "s.yaml").write_text(
        SETUP + "object_pose: {source: cam.csv}\ntip_pose: {source: robot.csv, position: [a, b], clock: 0}\n"
    )
    dataset = import_dataset(tmp_path, tmp_path / "s.yaml")
    assert [trial.name for trial in dataset.trials] == ["cam.csv#1", "cam.csv#2"]
    assert dataset.trials[1].tip_pose.values[0] == pytest.approx(TIP[0] + 0.01)


def numbered_beside(tmp_path, finger_time, finger):
    """Two numbered pushes of the object, and a file of the finger that does not number them."""
    columns = [np.repeat([1, 2], len(TIME)), np.tile(TIME, 2), np.concatenate([POSE, POSE + 0.01])]
    written(tmp_path / "cam.csv", ["push_id", "t", "x", "y", "theta"], columns)
    written(tmp_path / "robot.csv", ["t", "a", "b"], [finger_time, finger])
    (tmp_path / "s.yaml").write_text(
        SETUP + "object_pose: {source: cam.csv}\ntip_pose: {source: robot.csv, position: [a, b], clock: 0}\n"
    )
    return import_dataset(tmp_path, tmp_path / "s.yaml")


def test_stamps_that_start_anew_go_with_the_numbers_of_another_file(tmp_path):
    dataset = numbered_beside(tmp_path, np.tile(TIME, 2), np.concatenate([TIP, TIP + 0.01]))
    assert [trial.name for trial in dataset.trials] == ["cam.csv#1", "cam.csv#2"]
    for k, trial in enumerate(dataset.trials):
        assert trial.tip_pose.values == pytest.approx(TIP + 0.01 * k, abs=1e-6)


@pytest.mark.parametrize("count", [1, 3])
def test_stamps_that_start_anew_more_or_less_often_than_the_numbers_are_refused(tmp_path, count):
    with pytest.raises(
        DatasetError,
        match=r"cam\.csv: push_id numbers 2 pushes, .* tip_pose in robot\.csv start anew "
        rf"{count - 1} times",
    ):
        numbered_beside(tmp_path, np.tile(TIME, count), np.tile(TIP, (count, 1)))


@pytest.mark.parametrize(
    ("heldout", "roles"),
    [("", "fff"), ("heldout: [p.csv#1, p.csv#3]\n", "hfh"), ("heldout: []\n", "fff")],
)
def test_a_setup_says_which_pushes_are_held_out(tmp_path, heldout, roles):
    """Otherwise it is the last quarter, rounded down."""
    numbers = np.repeat([1, 2, 3], len(TIME))
    columns = [numbers, np.tile(TIME, 3), np.tile(POSE, (3, 1)), np.tile(TIP, (3, 1))]
    file = written(tmp_path / "p.csv", ["push_id", "t", "x", "y", "theta", "a", "b"], columns)
    setup = tmp_path / "s.yaml"
    setup.write_text(SETUP + "tip_pose: {position: [a, b]}\n" + heldout)
    assert "".join(trial.role[0] for trial in import_dataset(file, setup).trials) == roles


@pytest.mark.parametrize(
    ("heldout", "said"),
    [
        ("[p.csv#4]", r"s\.yaml: heldout: no push is named p\.csv#4; there are p\.csv#1, p\.csv#2"),
        ("p.csv#1", r"s\.yaml: heldout must be a list of pushes' names, got 'p\.csv#1'"),
        ("[1]", r"heldout must be a list of pushes' names, got \[1\]"),
    ],
)
def test_a_push_to_hold_out_that_is_not_there_is_refused(tmp_path, heldout, said):
    numbers = np.repeat([1, 2], len(TIME))
    columns = [numbers, np.tile(TIME, 2), np.tile(POSE, (2, 1)), np.tile(TIP, (2, 1))]
    file = written(tmp_path / "p.csv", ["push_id", "t", "x", "y", "theta", "a", "b"], columns)
    (tmp_path / "s.yaml").write_text(SETUP + f"tip_pose: {{position: [a, b]}}\nheldout: {heldout}\n")
    with pytest.raises(DatasetError, match=said):
        import_dataset(file, tmp_path / "s.yaml")


def test_provenance_names_the_pushes_that_were_treated_otherwise(tmp_path):
    """Of three numbered pushes, the second is cut: after a rest the finger returns and pushes again."""
    back = np.linspace(TIP[-1], TIP[-1] - [0.02, 0.0], 50)
    onward = TIP[-1] - [0.02, 0.0] + np.column_stack([0.06 * np.clip(TIME, 0.0, 1.0), 0.0 * TIME])
    tip = np.concatenate([TIP, back, onward])
    pose = np.zeros((len(tip), 3))
    pose[:, 0] = np.maximum.accumulate(np.maximum(tip[:, 0] + 0.035, 0.0))
    numbers = np.repeat([1, 2, 3], [len(TIME), len(tip), len(TIME)])
    time = 0.01 * np.arange(len(numbers))
    columns = [numbers, time, np.concatenate([POSE, pose, POSE]), np.concatenate([TIP, tip, TIP])]
    file = written(tmp_path / "p.csv", ["push_id", "t", "x", "y", "theta", "a", "b"], columns)
    (tmp_path / "s.yaml").write_text(SETUP + "tip_pose: {position: [a, b]}\n")
    dataset = import_dataset(file, tmp_path / "s.yaml", tell=lambda text: None)
    assert [trial.name for trial in dataset.trials] == ["p.csv#1", "p.csv#2#1", "p.csv#2#2", "p.csv#3"]
    assert dataset.provenance[1:] == (
        "cut into pushes by their numbers, or where the stamps start again",
        "p.csv#2: cut into 2 pushes where the object rests and the finger leaves it",
    )


def test_stamps_that_start_anew_in_one_file_alone_are_refused(tmp_path):
    twice = [np.tile(TIME, 2), np.tile(POSE, (2, 1))]
    written(tmp_path / "cam.csv", ["t", "x", "y", "theta"], twice)
    written(tmp_path / "robot.csv", ["t", "a", "b"], [TIME, TIP])
    (tmp_path / "s.yaml").write_text(
        SETUP + "object_pose: {source: cam.csv}\ntip_pose: {source: robot.csv, position: [a, b]}\n"
    )
    with pytest.raises(DatasetError, match=r"to the start 1 times, those of tip_pose in robot\.csv 0"):
        import_dataset(tmp_path, tmp_path / "s.yaml")


def test_a_push_that_no_reader_takes_is_refused(tmp_path):
    file = written(tmp_path / "p.csv", ["t", "x", "y", "theta", "a", "b"], [1e3 * TIME, POSE, TIP])
    (tmp_path / "s.yaml").write_text(SETUP + "tip_pose: {position: [a, b]}\n")
    with pytest.raises(DatasetError, match=r"lasts 1490 s.*were these milliseconds"):
        import_dataset(file, tmp_path / "s.yaml")


def test_a_guess_takes_units_from_names_and_finds_the_number_of_a_push(tmp_path):
    columns = {
        "time_ms": 1e3 * TIME, "block_x_cm": 1e2 * POSE[:, 0], "block_y_cm": 1e2 * POSE[:, 1],
        "block_yaw_rad": POSE[:, 2] + 0.2, "tip_x [mm]": 1e3 * TIP[:, 0], "tip_y [mm]": 1e3 * TIP[:, 1],
        "fx_mN": 0.0 * TIME, "fy_mN": 0.0 * TIME,
    }  # fmt: skip
    both = [np.concatenate([one, one]) for one in columns.values()]
    number = np.repeat([3.0, 4.0], len(TIME))
    names = ["trial", *columns, "trial_speed"]
    file = written(tmp_path / "p.csv", names, [number, *both, 1.0 + 0.0 * number])
    said = yaml.safe_load(guess_setup(file))
    assert {one["push"] for one in (said[name] for name in said) if "push" in one} == {"trial"}
    assert said["object_pose"]["unit"] == {"time": "ms", "position": "cm"}
    assert said["object_pose"]["angle"] == "block_yaw_rad"
    assert said["tip_pose"]["unit"] == {"time": "ms", "position": "mm"}
    assert said["ft_wrench"] == {
        "force": ["fx_mN", "fy_mN"], "time": "time_ms", "push": "trial",
        "unit": {"time": "ms", "force": "mN"},
    }  # fmt: skip
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(said | yaml.safe_load(SETUP)))
    first, second = import_dataset(file, tmp_path / "s.yaml", tell=lambda text: None).trials
    assert [first.name, second.name] == ["p.csv#3", "p.csv#4"]
    assert second.object_pose.values == pytest.approx(POSE + np.array([0.0, 0.0, 0.2]), abs=1e-7)
    assert second.tip_pose.values == pytest.approx(TIP, abs=1e-7)


def below_one_another(path):
    """A table of three bodies, one below the other at each time, told apart by a column of names."""
    zero = np.zeros(len(TIME))
    mug, finger = np.tile([1.0, 1.0, 0.3], (len(TIME), 1)), np.column_stack([TIP, zero])
    bodies = {"block": POSE, "mug": mug, "finger": finger}
    lines = [
        f"{TIME[row]:.3f},{name}," + ",".join(f"{cell:.6f}" for cell in poses[row])
        for row in range(len(TIME))
        for name, poses in bodies.items()
    ]
    path.write_text("t,name,x,y,theta\n" + "\n".join(lines) + "\n")
    return path


def test_bodies_below_one_another_are_told_apart_by_their_names(tmp_path):
    file = below_one_another(tmp_path / "p.csv")
    says = SETUP + "object_pose: {position: [x, y], angle: theta%s}\ntip_pose: {position: [x, y]%s}\n"
    (tmp_path / "s.yaml").write_text(says % (", part: block", ", part: finger"))
    (trial,) = import_dataset(file, tmp_path / "s.yaml", tell=lambda text: None).trials
    assert trial.object_pose.values == pytest.approx(POSE, abs=1e-6)
    assert trial.tip_pose.values == pytest.approx(TIP, abs=1e-6)
    for parts, fault in (
        (("", ""), "jumps to and fro by .* m from row to row; .* `part`, one of block, finger, mug"),
        ((", part: blok", ", part: finger"), "has no part 'blok'; there are block, finger, mug"),
    ):
        (tmp_path / "s.yaml").write_text(says % parts)
        with pytest.raises(DatasetError, match=fault):
            import_dataset(file, tmp_path / "s.yaml")


def test_a_body_that_two_columns_name_is_found(tmp_path):
    file = below_one_another(tmp_path / "p.csv")
    lines = [line.split(",", 2) for line in file.read_text().splitlines()]
    file.write_text("\n".join(f"{t},{name},{'id' if t == 't' else name},{rest}" for t, name, rest in lines))
    (tmp_path / "s.yaml").write_text(
        SETUP + "object_pose: {position: [x, y], angle: theta, part: block}\ntip_pose: null\n"
    )
    (trial,) = import_dataset(file, tmp_path / "s.yaml", tell=lambda text: None).trials
    assert trial.object_pose.values == pytest.approx(POSE, abs=1e-6)


def test_noise_in_a_wrong_unit_makes_no_bodies(tmp_path):
    """Of poses in 0.1 mm that are read as m, beside a column of words."""
    rng = np.random.default_rng(0)
    pose = 1e4 * POSE + rng.normal(0.0, 2.0, POSE.shape) * [1.0, 1.0, 0.0]
    words = np.where(TIME < 0.4, "rest", "push")
    lines = [f"{now:.3f},{word},{x},{y},{z}" for now, word, (x, y, z) in zip(TIME, words, pose, strict=True)]
    file = tmp_path / "p.csv"
    file.write_text("t,phase,x,y,theta\n" + "\n".join(lines) + "\n")
    (tmp_path / "s.yaml").write_text(
        SETUP + "object_pose: {position: [x, y], angle: theta}\ntip_pose: null\n"
    )
    told: list[str] = []
    import_dataset(file, tmp_path / "s.yaml", tell=told.append)
    assert any("are positions in m" in text for text in told)


def test_equal_pushes_of_one_file_are_imported_and_read(tmp_path):
    """As of a simulation: what an import writes, other commands can read."""
    number = np.repeat([0.0, 1.0, 2.0], len(TIME))
    columns = [number, *(np.concatenate([each] * 3) for each in (TIME, POSE, TIP))]
    file = written(tmp_path / "p.csv", ["push_id", "t", "x", "y", "theta", "a", "b"], columns)
    (tmp_path / "s.yaml").write_text(SETUP + "tip_pose: {position: [a, b]}\n")
    dataset = import_dataset(file, tmp_path / "s.yaml", tell=lambda text: None)
    again = read_dataset(write_dataset(dataset, tmp_path / "pushes"), tell=lambda text: None)
    assert len(dataset.trials) == len(again.trials) == 3
    assert any("holds the same measurement" in text and "is one a copy?" in text for text in again.warnings)
