"""Units, axes that point up, frames, signs and offsets: the same push comes out however it was recorded."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tables import POSE, SETUP, TIME, TIP, WAY, written

from slipmap.models.geometry import compose, seen_from
from slipmap.models.measurements import DatasetError
from slipmap.models.measurements.importing import import_dataset

TURNED = POSE + np.array([0.1, -0.05, 0.4])
NAMES = ["t", "x", "y", "z", "qx", "qy", "qz", "qw", "fx", "fy", "fz"]


def trial_of(tmp_path, names, columns, setup):
    file = written(tmp_path / "push.csv", names, columns, form="{:.9f}")
    (tmp_path / "setup.yaml").write_text(SETUP + setup)
    (trial,) = import_dataset(file, tmp_path / "setup.yaml", tell=lambda text: None).trials
    return trial


# Where the table's x, y and z point in the source, for each axis that is up: right-handed, by hand.
AXES = {
    "z": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "-z": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "-y": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "x": [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
    "-x": [[0, 1, 0], [0, 0, -1], [-1, 0, 0]],
}


@pytest.mark.parametrize("up", AXES)
def test_each_axis_can_point_up(tmp_path, up):
    axes = np.array(AXES[up], dtype=float)  # rows: axes of the table in the source
    assert np.linalg.det(axes) == pytest.approx(1.0)
    place = np.column_stack([TURNED[:, :2], np.full(len(TIME), 0.03)]) @ axes
    turn = Rotation.from_rotvec(TURNED[:, 2:] * axes[2])
    tip = np.column_stack([TIP, np.full(len(TIME), 0.02)]) @ axes
    trial = trial_of(
        tmp_path, NAMES, [TIME, place, turn.as_quat(), tip],
        f"up: '{up}'\nobject_pose: {{position: [x, y, z], quaternion: [qx, qy, qz, qw]}}\n"
        "tip_pose: {position: [fx, fy, fz]}\n",
    )  # fmt: skip
    assert trial.object_pose.values == pytest.approx(TURNED, abs=1e-7)
    assert trial.tip_pose.values == pytest.approx(TIP, abs=1e-7)


def test_a_frame_and_units(tmp_path):
    frame = np.array([0.3, -0.2, np.radians(30.0)])
    pose = np.column_stack([1e3 * seen_from(TURNED[:, :2], frame), np.degrees(TURNED[:, 2] - frame[2])])
    tip = 1e3 * seen_from(TIP, frame)
    trial = trial_of(
        tmp_path, ["ms", "a", "b", "c", "d", "e"], [1e3 * TIME, pose, tip],
        "time: ms\nframe: [0.3, -0.2, 30 deg]\nunit: {position: mm, angle: deg, time: ms}\n"
        "object_pose: {position: [a, b], angle: c}\ntip_pose: {position: [d, e]}\n",
    )  # fmt: skip
    assert trial.object_pose.values == pytest.approx(TURNED, abs=1e-6)
    assert trial.object_pose.time == pytest.approx(TIME, abs=1e-9)
    assert trial.tip_pose.values == pytest.approx(TIP, abs=1e-6)


def test_a_frame_as_a_matrix_or_a_quaternion(tmp_path):
    turn = Rotation.from_euler("z", 30, degrees=True)
    rows = np.eye(4)
    rows[:3, :3], rows[:3, 3] = turn.as_matrix(), [0.3, -0.2, 0.5]
    place = seen_from(TURNED[:, :2], np.array([0.3, -0.2, np.radians(30.0)]))
    columns = [TIME, place, TURNED[:, 2] - np.radians(30.0)]
    for frame in (rows.tolist(), [0.3, -0.2, 0.5, *turn.as_quat().tolist()]):
        trial = trial_of(
            tmp_path, ["t", "a", "b", "c"], columns,
            f"object_pose: {{position: [a, b], angle: c, frame: {frame}}}\ntip_pose: null\n",
        )  # fmt: skip
        assert trial.object_pose.values == pytest.approx(TURNED, abs=1e-6)
        assert not trial.finger_near()


def test_offsets_and_signs(tmp_path):
    tracked = compose(TURNED, np.array([-0.01, 0.02, -0.3]))  # then the outline sits at the inverse of that
    outline = np.append(seen_from(np.zeros(2), np.array([-0.01, 0.02, -0.3])), 0.3)
    pushed = 2.0 * (POSE[:, 0] > 0)
    force = np.column_stack([-pushed, 0.0 * TIME])
    trial = trial_of(
        tmp_path, ["t", "a", "b", "c", "d", "e", "f", "g"],
        [TIME, tracked[:, :2], -tracked[:, 2], TIP - [0.004, 0.0], force + np.array([-0.5, 0.25])],
        f"object_pose: {{position: [a, b], angle: c, sign: -1, offset: {outline.tolist()}}}\n"
        "tip_pose: {position: [d, e], offset: [0.004, 0]}\n"
        "ft_wrench: {force: [f, g], sign: -1, offset: [-0.5, 0.25]}\n",
    )  # fmt: skip
    assert trial.object_pose.values == pytest.approx(TURNED, abs=1e-7)
    assert trial.tip_pose.values == pytest.approx(TIP, abs=1e-7)
    assert trial.ft_wrench.values[:, 0] == pytest.approx(pushed, abs=1e-7)


def test_an_offset_in_the_tools_axes(tmp_path):
    # A flange that looks down, turned by 90° about the vertical; the finger is 40 mm beside and 100 mm below.
    turn = Rotation.from_euler("xz", [180, 90], degrees=True)
    offset = np.array([0.04, 0.0, 0.1])
    flange = np.column_stack([TIP, np.full(len(TIME), 0.02)]) - turn.apply(offset)
    quaternion = np.tile(turn.as_quat(), (len(TIME), 1))
    trial = trial_of(
        tmp_path, ["t", "a", "b", "c", "p_x", "p_y", "p_z", "q_x", "q_y", "q_z", "q_w"],
        [TIME, POSE, flange, quaternion],
        "object_pose: {position: [a, b], angle: c}\n"
        "tip_pose: {position: p, quaternion: q, offset: [0.04, 0, 0.1]}\n",
    )  # fmt: skip
    assert trial.tip_pose.values == pytest.approx(TIP, abs=1e-7)


@pytest.mark.parametrize("offset", ["[0.04, 0.01]", "[0.04, 0.01, 0.1]"])
@pytest.mark.parametrize("by", ["angle: yaw", "angle: back, sign: -1", "quaternion: q"])
def test_an_offset_turns_with_an_upright_tool(tmp_path, offset, by):
    """Seen from a robot's base that is itself turned by 30° on the table."""
    yaw = np.pi / 2 + 0.2 * TIME
    base = np.array([0.3, -0.2, np.radians(30.0)])
    tool = np.column_stack([seen_from(TIP, base), yaw])
    flange = compose(tool, np.array([-0.04, -0.01, 0.0]))
    quaternion = Rotation.from_euler("z", yaw[:, None]).as_quat()
    trial = trial_of(
        tmp_path, ["t", "a", "b", "c", "d", "e", "yaw", "back", "q_x", "q_y", "q_z", "q_w"],
        [TIME, POSE, flange[:, :2], yaw, -yaw, quaternion],
        "object_pose: {position: [a, b], angle: c}\n"
        f"tip_pose: {{position: [d, e], {by}, offset: {offset}, frame: [0.3, -0.2, 30 deg]}}\n",
    )  # fmt: skip
    assert trial.tip_pose.values == pytest.approx(TIP, abs=1e-7)


@pytest.mark.parametrize("turn", [["qx", "qy", "qz", "qw"], ["rx", "ry", "rz"]])
def test_the_objects_rotation_is_not_the_fingers(tmp_path, turn):
    rotation = Rotation.from_rotvec(TURNED[:, 2:] * [0, 0, 1])
    cells = rotation.as_quat() if len(turn) == 4 else rotation.as_rotvec()
    trial = trial_of(
        tmp_path, ["t", "x", "y", *turn, "a", "b"], [TIME, TURNED[:, :2], cells, TIP - [0.004, 0.0]],
        "tip_pose: {position: [a, b], offset: [0.004, 0, 0.1]}\n",
    )  # fmt: skip
    assert trial.object_pose.values == pytest.approx(TURNED, abs=1e-7)
    assert trial.tip_pose.values == pytest.approx(TIP, abs=1e-7)


def test_the_rotation_in_the_fingers_own_file_is_its_own(tmp_path):
    quaternion = np.tile(Rotation.from_euler("z", 90, degrees=True).as_quat(), (len(TIME), 1))
    names = ["t", "x", "y", "qx", "qy", "qz", "qw"]
    written(tmp_path / "object.csv", ["t", "x", "y", "theta"], [TIME, POSE])
    written(tmp_path / "finger.csv", names, [TIME, TIP - [0.0, 0.004], quaternion], form="{:.9f}")
    (tmp_path / "setup.yaml").write_text(
        SETUP + "object_pose: {source: object.csv}\n"
        "tip_pose: {source: finger.csv, offset: [0.004, 0], clock: 0}\n"
    )
    (trial,) = import_dataset(tmp_path, tmp_path / "setup.yaml").trials
    assert trial.tip_pose.values == pytest.approx(TIP, abs=1e-6)


@pytest.mark.parametrize(
    ("axis", "lean", "known"),
    [("X", 180.0, True), ("X", 155.0, True), ("X", 90.0, True), ("Y", -90.0, True), ("X", 150.0, False)],
)
def test_a_finger_turns_about_its_axis_unless_it_leans(tmp_path, axis, lean, known):
    """A lean of 90° makes another axis of the tracked tool the finger's."""
    turn = np.linspace(170.0, 200.0, len(TIME))
    angles = np.column_stack([turn, np.full(len(TIME), lean)])
    quaternion = Rotation.from_euler(f"Z{axis}", angles, degrees=True).as_quat()
    written(tmp_path / "object.csv", ["t", "x", "y", "theta"], [TIME, POSE])
    written(tmp_path / "finger.csv", ["t", "x", "y", "qx", "qy", "qz", "qw"], [TIME, TIP, quaternion])
    (tmp_path / "setup.yaml").write_text(
        SETUP + "object_pose: {source: object.csv}\ntip_pose: {source: finger.csv, clock: 0}\n"
    )
    (trial,) = import_dataset(tmp_path, tmp_path / "setup.yaml").trials
    assert (trial.tip_angle is not None) == known
    if known:
        first, last = trial.tip_angle.values[[0, -1], 0]
        assert np.degrees(last - first) == pytest.approx(30.0, abs=0.1)


def test_a_finger_is_left_out_where_the_rotation_its_offset_needs_is_unknown(tmp_path):
    yaw = np.where(TIME < 1.0, np.pi / 2, np.nan)
    trial = trial_of(
        tmp_path, ["t", "a", "b", "c", "d", "e", "yaw"], [TIME, POSE, TIP - [0.0, 0.01], yaw],
        "object_pose: {position: [a, b], angle: c}\n"
        "tip_pose: {position: [d, e], angle: yaw, offset: [0.01, 0]}\n",
    )  # fmt: skip
    assert trial.tip_pose.values == pytest.approx(TIP[TIME < 1.0], abs=1e-7)


def test_frames_and_rates(tmp_path):
    trial = trial_of(
        tmp_path, ["Frame", "a", "b", "c"], [np.arange(len(TIME)), POSE],
        "rate: 100\ntime: Frame\nobject_pose: {position: [a, b], angle: c}\ntip_pose: null\n",
    )  # fmt: skip
    assert trial.object_pose.time == pytest.approx(TIME, abs=1e-9)


def test_a_wrong_axis_is_said(tmp_path):
    up = np.column_stack([TURNED[:, 0], 0.03 + 0 * TIME, -TURNED[:, 1] + 0.5 * WAY])
    file = written(tmp_path / "push.csv", ["t", "x", "y", "z", "theta"], [TIME, up, TURNED[:, 2]])
    (tmp_path / "setup.yaml").write_text(SETUP + "object_pose: {position: [x, y, z], angle: theta}\n")
    said = []
    import_dataset(file, tmp_path / "setup.yaml", tell=said.append)
    assert any("is `up: y` right?" in text for text in said), said


@pytest.mark.parametrize(
    ("setup", "fault"),
    [
        ("object_pose: {position: [a, b], angel: c}", "angel"),
        ("objekt_pose: {position: [a, b]}", "objekt_pose"),
        ("object_pose: {position: [a, nowhere], angle: c}", "no column 'nowhere'; there are t, a, b, c"),
        ("object_pose: {position: [a, b], angle: c, frame: [1, 2]}", "3, 7 or 4 by 4 numbers"),
        ("object_pose: {position: [a, b], angle: c, frame: [0, 0, 0, 1, 1, 1, 1]}", "length 1"),
        ("object_pose: {position: [a, b], angle: c, up: w}", "one of z, y, x"),
        ("object_pose: {position: [a, b], angle: c, up: y}", "needs x, y and z"),
        ("object_pose: {position: [a, b], angle: c, unit: inch}", "one of m, cm, mm"),
        ("object_pose: {position: [a, b], angle: c, quaternion: q}", "give the rotation only once"),
        ("object_pose: {position: [a, b], angle: c, source: other.csv}", "no file matches 'other.csv'"),
        ("object_pose: {position: [a, b], angle: c, sign: 2}", "1 or -1"),
        ("object_pose: {position: [a, b], angle: c, frame: contact}", "only a force"),
        ("object_pose: {position: [a, b]}", "object's angle"),
        ("object_pose: {position: [a, b], angle: c, time: when}", "no column 'when'"),
        ("object_pose: null", "is null"),
        ("csv: {object_x: {unit: mm}}", "setup.yaml: csv: object_x and object_y have different units"),
        ("csv: {force_x: {unit: mN}}", "csv: force_x and force_y have different units"),
    ],
)
def test_a_wrong_setup_is_refused(tmp_path, setup, fault):
    with pytest.raises(DatasetError, match=fault.replace("[", r"\[")):
        trial_of(tmp_path, ["t", "a", "b", "c"], [TIME, POSE], setup)


def test_units_of_all_and_of_one_channel_are_merged(tmp_path):
    trial = trial_of(
        tmp_path, ["t", "a", "b", "c", "d", "e"], [1e3 * TIME, 1e2 * TURNED[:, :2], TURNED[:, 2], 1e3 * TIP],
        "unit: {time: ms, position: mm}\n"
        "object_pose: {position: [a, b], angle: c, unit: cm}\ntip_pose: {position: [d, e]}\n",
    )  # fmt: skip
    assert trial.object_pose.time == pytest.approx(TIME)
    assert trial.object_pose.values == pytest.approx(TURNED, abs=1e-7)
    assert trial.tip_pose.values == pytest.approx(TIP, abs=1e-7)


def test_what_a_setup_leaves_empty_is_of_the_object(tmp_path):
    file = written(tmp_path / "p.csv", ["t", "x", "y", "theta", "a", "b"], [TIME, POSE, TIP])
    (tmp_path / "object.yaml").write_text(SETUP)
    (tmp_path / "setup.yaml").write_text(
        "object: {outline: null, mass: 0.5}\nfinger: {radius: null}\ntip_pose: {position: [a, b]}\n"
    )
    dataset = import_dataset(file, tmp_path / "setup.yaml", object_name=str(tmp_path / "object.yaml"))
    assert dataset.finger_radius == 0.005 and dataset.mass == 0.5
    assert dataset.grid.exterior[:, 0].max() == pytest.approx(0.03)


@pytest.mark.parametrize("turn", ["angle: a", "quaternion: [qx, qy, qz, qw]"])
def test_a_sign_turns_the_angle_alone_whatever_the_frame(tmp_path, turn):
    frame = np.array([0.4, -0.25, np.radians(30.0)])
    angle = -(TURNED[:, 2] - frame[2])
    quaternion = Rotation.from_rotvec(angle[:, None] * np.array([0.0, 0.0, 1.0])).as_quat()
    trial = trial_of(
        tmp_path, ["t", "x", "y", "a", "qx", "qy", "qz", "qw", "fx", "fy"],
        [TIME, seen_from(TURNED[:, :2], frame), angle, quaternion, seen_from(TIP, frame)],
        f"frame: [0.4, -0.25, 30 deg]\nobject_pose: {{position: [x, y], {turn}, sign: -1}}\n"
        "tip_pose: {position: [fx, fy]}\n",
    )  # fmt: skip
    assert trial.object_pose.values == pytest.approx(TURNED, abs=1e-6)


def test_an_angle_about_an_axis_that_points_down_turns_the_other_way(tmp_path):
    down = np.array([1.0, -1.0])
    trial = trial_of(
        tmp_path, ["t", "x", "y", "a", "fx", "fy"],
        [TIME, TURNED[:, :2] * down, -TURNED[:, 2], TIP * down],
        "up: '-z'\nobject_pose: {position: [x, y], angle: a}\ntip_pose: {position: [fx, fy]}\n",
    )  # fmt: skip
    assert trial.object_pose.values == pytest.approx(TURNED, abs=1e-7)
    assert trial.tip_pose.values == pytest.approx(TIP, abs=1e-7)


@pytest.mark.parametrize("up", ["z", "-z"])
def test_an_angle_in_a_frame_that_looks_down_turns_the_other_way(tmp_path, up):
    """As of a camera above the table. `up: -z` turns the source over once more, before its frame does."""
    turn = Rotation.from_euler("z", 30, degrees=True) * Rotation.from_euler("x", 180, degrees=True)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn.as_matrix(), [0.3, -0.2, 1.0]
    side = 1.0 if up == "z" else -1.0
    place, tip = (((one - [0.3, -0.2]) @ matrix[:2, :2]) * [1.0, side] for one in (TURNED[:, :2], TIP))
    for frame in (matrix.tolist(), [0.3, -0.2, 1.0, *turn.as_quat().tolist()]):
        trial = trial_of(
            tmp_path, ["t", "a", "b", "c", "d", "e"],
            [TIME, place, side * (np.radians(30.0) - TURNED[:, 2]), tip],
            f"up: '{up}'\nframe: {frame}\nobject_pose: {{position: [a, b], angle: c}}\n"
            "tip_pose: {position: [d, e]}\n",
        )  # fmt: skip
        assert trial.object_pose.values == pytest.approx(TURNED, abs=1e-7)
        assert trial.tip_pose.values == pytest.approx(TIP, abs=1e-7)


def test_an_angle_in_a_frame_on_its_side_is_refused(tmp_path):
    frame = [0.0, 0.0, 0.0, *Rotation.from_euler("x", 50, degrees=True).as_quat().tolist()]
    says = f"frame: {frame}\ntip_pose: null\nobject_pose: {{position: [a, b], angle: c}}\n"
    with pytest.raises(DatasetError, match=r"push\.csv: object_pose: .* 50° from the vertical"):
        trial_of(tmp_path, ["t", "a", "b", "c"], [TIME, POSE], says)


@pytest.mark.parametrize("up", ["z", "y"])
def test_a_quaternion_with_w_first_is_told(tmp_path, up):
    axes = np.array(AXES[up], dtype=float)
    place = np.column_stack([TURNED[:, :2], np.full(len(TIME), 0.03)]) @ axes
    turn = Rotation.from_rotvec((TURNED[:, 2:] + 1.0) * axes[2]).as_quat()
    file = written(tmp_path / "push.csv", NAMES[:8], [TIME, place, turn[:, [3, 0, 1, 2]]], form="{:.9f}")
    told: list[str] = []
    for order, right in (("[qx, qy, qz, qw]", False), ("[qy, qz, qw, qx]", True)):
        told.clear()
        (tmp_path / "setup.yaml").write_text(
            f"{SETUP}up: '{up}'\ntip_pose: null\nobject_pose: {{position: [x, y, z], quaternion: {order}}}\n"
        )
        import_dataset(file, tmp_path / "setup.yaml", tell=told.append)
        assert any("if the quaternion were w, x, y, z" in text for text in told) != right
