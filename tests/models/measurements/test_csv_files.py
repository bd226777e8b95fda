import numpy as np
import pytest

from slipmap.models.measurements import DatasetError, read_dataset

HEADER = "t,object_x,object_y,object_theta,tip_x,tip_y,force_x,force_y,force_tau"


def lines(push=0):
    """Poses every 20 ms, the tip 5 ms and the force 10 ms after them, in one time column."""
    rows = []
    for step in range(40):
        t = 0.02 * step
        x = max(0.0, 0.1 * t - 0.005)
        rows.append(f"{t:.3f},{x:.4f},0,{0.1 * x:.5f},,,,,")
        rows.append(f"{t + 0.005:.3f},,,,{0.1 * t - 0.055:.4f},{0.001 * push},,,")
        rows.append(f"{t + 0.010:.3f},,,,,,{2.0 if x else 0.0},0.1,-0.01")
    return rows


def write(folder, rows, header=HEADER, name="push.csv", end="\n"):
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(end.join([header, *rows]) + end, encoding="utf-8", newline="")
    return folder / name


def test_channels_of_different_rates_share_one_time_column(tmp_path):
    dataset = read_dataset(write(tmp_path, lines()), object_name="rect1")
    trial = dataset.trials[0]
    assert dataset.warnings == () and (trial.name, trial.role) == ("push.csv", "fit")
    np.testing.assert_allclose(trial.object_pose.time, 0.02 * np.arange(40), atol=1e-12)
    np.testing.assert_allclose(trial.tip_pose.time, 0.005 + 0.02 * np.arange(40), atol=1e-12)
    np.testing.assert_allclose(trial.tip_pose.values[:, 0], 0.002 * np.arange(40) - 0.055, atol=1e-12)
    np.testing.assert_allclose(trial.ft_wrench.values[-1], [2.0, 0.1, -0.01])  # not turned


def test_a_finger_that_turns_has_its_angle_in_a_column_of_its_own(tmp_path):
    rows = [f"{row},{0.01 * number if number % 3 == 1 else ''}" for number, row in enumerate(lines())]
    (trial,) = read_dataset(write(tmp_path, rows, f"{HEADER},tip_theta"), object_name="rect1").trials
    np.testing.assert_array_equal(trial.tip_angle.time, trial.tip_pose.time)
    np.testing.assert_allclose(trial.tip_angle.values[:, 0], 0.01 * np.arange(1, 120, 3), atol=1e-12)


def test_a_folder_order_of_columns_and_line_ends_do_not_matter(tmp_path):
    for push in range(4):
        shuffled = [",".join(reversed(row.split(","))) for row in lines(push)]
        header = "\ufeff" + " , ".join(reversed(HEADER.split(",")))
        write(tmp_path / "pushes", shuffled, header, f"{push}.csv", end="\r\n")
    dataset = read_dataset(tmp_path / "pushes", object_name="rect1")
    assert [(trial.name, trial.role) for trial in dataset.trials] == [
        ("0.csv", "fit"), ("1.csv", "fit"), ("2.csv", "fit"), ("3.csv", "heldout"),
    ]  # fmt: skip
    assert dataset.trials[2].tip_pose.values[0, 1] == 0.002


def test_files_are_in_the_order_of_the_numbers_in_their_names(tmp_path):
    for push in (8, 9, 10, 11):
        write(tmp_path / "pushes", lines(push), name=f"push {push}.csv")
    dataset = read_dataset(tmp_path / "pushes", object_name="rect1")
    assert [(trial.name, trial.role) for trial in dataset.trials] == [
        ("push 8.csv", "fit"), ("push 9.csv", "fit"), ("push 10.csv", "fit"), ("push 11.csv", "heldout"),
    ]  # fmt: skip


def test_force_can_be_left_out_or_left_empty(tmp_path):
    short = [",".join(row.split(",")[:6]) for row in lines()]
    bare = write(tmp_path, short, ",".join(HEADER.split(",")[:6]))
    assert read_dataset(bare, object_name="rect1").trials[0].ft_wrench is None
    empty = write(tmp_path, [row + ",,," for row in short], name="empty.csv")
    assert read_dataset(empty, object_name="rect1").trials[0].ft_wrench is None


@pytest.mark.parametrize("word", ["", "nan", "NaN", "  "])
def test_ways_to_say_that_nothing_was_measured(tmp_path, word):
    rows = lines()
    rows[6] = f"0.040,{word},0,0,,,,,"
    assert len(read_dataset(write(tmp_path, rows), object_name="rect1").trials[0].object_pose.time) == 39


def changed(row, text):
    def change(rows):
        rows[row] = text

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (changed(6, "0.040,abc,0,0,,,,,"), ["row 6, object_x: 'abc' is not a number"]),
        (changed(6, "0.040,1_0,0,0,,,,,"), ["row 6, object_x: '1_0' is not a number"]),
        (changed(6, "0.040,0,0"), ["row 6: has 3 cells, but the header has 9"]),
        (changed(6, "0.020,0,0,0,,,,,"), ["object_pose, row 6", "repeats that of row 3"]),
        (changed(6, "0.010,0,0,0,,,,,"), ["object_pose, row 6", "is earlier than that of row 3"]),
        (changed(6, "0.040,inf,0,0,,,,,"), ["object_pose, row 6", "infinite"]),
        (changed(6, ",0.1,0,0,,,,,"), ["object_pose, row 6: has values but no time"]),
        (lambda rows: rows.clear(), ["object_pose: has no rows"]),
    ],
)
def test_faults_name_the_row_below_the_header(tmp_path, change, words):
    rows = lines()
    change(rows)
    with pytest.raises(DatasetError) as caught:
        read_dataset(write(tmp_path, rows), object_name="rect1")
    for word in ["push.csv", *words]:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("header", "words"),
    [
        (
            "time" + HEADER[1:],
            ["lacks t;", "expected columns are t, object_x, object_y, object_theta, tip_x, tip_y and"],
        ),
        (HEADER.replace("tip_x,tip_y", "finger_x,finger_y"), ["lacks tip_x, tip_y"]),
        (HEADER.replace(",", ";"), ["separated by semicolons", "push.csv --guess"]),
        (HEADER.replace(",", "\t"), ["separated by tabs", "push.csv --guess"]),
        (HEADER.replace(",", " "), ["separated by blanks", "push.csv --guess"]),
        (
            "Format Version,1.23,Take Name,push",
            ["OptiTrack Motive export", "expected columns are t, object_x"],
        ),
        (HEADER.replace("object_theta", "qx,qy,qz,qw"), ["lacks object_theta", "2 atan2(qz, qw)"]),
        (HEADER.replace("t,", "stamp.sec,stamp.nanosec,", 1), ["lacks t", "sec + 1e-9 nanosec"]),
        (HEADER.replace("force_y", "fy"), ["lacks force_y", "force_x, force_y, force_tau"]),
        (HEADER.replace("force_x,force_y", "fx,fy"), ["lacks force_x, force_y"]),
        (HEADER + ",t", ["the column 't' 2 times"]),
    ],
)
def test_a_wrong_header_is_answered_with_the_right_one(tmp_path, header, words):
    with pytest.raises(DatasetError) as caught:
        read_dataset(write(tmp_path, lines(), header), object_name="rect1")
    for word in ["push.csv", *words]:
        assert word in str(caught.value)


def test_the_suggested_import_quotes_the_file(tmp_path):
    (tmp_path / "two words").mkdir()
    with pytest.raises(DatasetError) as caught:
        read_dataset(write(tmp_path / "two words", lines(), HEADER.replace(",", ";")), object_name="rect1")
    assert f"`slipmap import '{tmp_path}/two words/push.csv' --guess`" in str(caught.value)


def test_an_unknown_column_is_mentioned(tmp_path):
    rows = [row + ",1.5" for row in lines()]
    warnings = read_dataset(write(tmp_path, rows, HEADER + ",humidity"), object_name="rect1").warnings
    assert len(warnings) == 1 and "'humidity' is unknown" in warnings[0]


def test_text_in_columns_nobody_asked_for_is_ignored(tmp_path):
    rows = [f"{row},True,push,/world" for row in lines()]
    header = HEADER + ",in_contact,phase,phase"
    dataset = read_dataset(write(tmp_path, rows, header), object_name="rect1")
    assert dataset.warnings[0].count("'phase'") == 2 and "are unknown and ignored" in dataset.warnings[0]
    assert len(dataset.warnings) == 1 and len(dataset.trials[0].object_pose.time) == 40
    with pytest.raises(DatasetError, match="'/world' is not a number"):
        read_dataset(
            write(tmp_path, rows, HEADER.replace("force_tau", "tau") + ",in_contact,phase,force_tau"),
            object_name="rect1",
        )


@pytest.mark.parametrize("torque", ["missing", "empty", "nan"])
def test_the_torque_is_optional(tmp_path, torque):
    cells = [row.split(",") for row in lines()]
    rows = [",".join(row[:8] + {"missing": [], "empty": [""], "nan": ["nan"]}[torque]) for row in cells]
    header = ",".join(HEADER.split(",")[: 8 if torque == "missing" else 9])
    dataset = read_dataset(write(tmp_path, rows, header), object_name="rect1")
    force = dataset.trials[0].ft_wrench
    assert dataset.warnings == () and len(force.time) == 40
    np.testing.assert_array_equal(force.values[-1], [2.0, 0.1, 0.0])


def test_a_column_push_id_parts_a_file_into_pushes(tmp_path):
    rows = [f"{name},{row}" for push, name in enumerate(["a", "b", "c", "d"]) for row in lines(push)]
    dataset = read_dataset(write(tmp_path, rows, "push_id," + HEADER), object_name="rect1")
    assert [(trial.name, trial.role) for trial in dataset.trials] == [
        ("push.csv#a", "fit"), ("push.csv#b", "fit"), ("push.csv#c", "fit"), ("push.csv#d", "heldout"),
    ]  # fmt: skip
    assert dataset.warnings == () and dataset.trials[2].tip_pose.values[0, 1] == 0.002
    rows[3] = rows[3][1:]
    with pytest.raises(DatasetError, match="row 3: its push_id is empty"):
        read_dataset(write(tmp_path, rows, "push_id," + HEADER), object_name="rect1")


def test_a_push_that_a_file_holds_twice_is_told(tmp_path):
    rows = [f"{name},{row}" for name in "ab" for row in lines()]
    dataset = read_dataset(write(tmp_path, rows, "push_id," + HEADER), object_name="rect1")
    (warning,) = dataset.warnings
    assert len(dataset.trials) == 2 and "push.csv#b holds the same measurement as push.csv#a" in warning


def test_angles_in_degrees_are_told_once_for_all_pushes_with_the_key_that_says_so(tmp_path):
    rows = []
    for push in range(4):
        for t, *cells in (row.split(",") for row in lines(push)):
            turned = f"{(push + 90.0) * float(cells[0]) + 40.0 * push:.2f}" if cells[0] else ""
            rows.append(",".join([str(push), t, *cells[:2], turned, *cells[3:]]))
    told = read_dataset(write(tmp_path, rows, "push_id," + HEADER), object_name="rect1").warnings
    (degrees,) = (warning for warning in told if "degrees?" in warning)
    assert "push_id 1, object_pose; push.csv, push_id 2" in degrees and "in the first" in degrees
    assert degrees.endswith("`csv: {object_theta: {unit: deg}}` into the YAML file of --object")


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"t,object_x\x00\n", b'"' + b"x" * 200_000, b"\n\n"])
def test_bytes_that_are_no_csv(tmp_path, content):
    (tmp_path / "push.csv").write_bytes(content)
    with pytest.raises(DatasetError, match=r"push\.csv"):
        read_dataset(tmp_path / "push.csv", object_name="rect1")


def test_the_object_must_be_named(tmp_path):
    with pytest.raises(DatasetError, match="does not say which object was pushed"):
        read_dataset(write(tmp_path, lines()))


def test_kinds_are_not_mixed(tmp_path):
    write(tmp_path / "pushes", lines())
    (tmp_path / "pushes" / "push.json").write_text("{}")
    with pytest.raises(DatasetError, match="both CSV and MIT push files"):
        read_dataset(tmp_path / "pushes", object_name="rect1")


OBJECT = """
object: {outline: [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]]}
finger: {radius: 0.005}
csv:
  t: {column: stamp, unit: ms}
  object_x: {column: block x, unit: mm}
  object_theta: {unit: deg}
  tip_x: finger_x
  force_tau: {unit: N mm}
"""


def described(folder, text=OBJECT):
    file = folder / "block.yaml"
    file.write_text(text)
    return str(file)


def test_columns_of_other_names_and_units(tmp_path):
    header = HEADER.replace("tip_x", "finger_x").replace("object_x", "block x").replace("t,", "stamp,", 1)
    rows = [",".join([str(1e3 * float(row.split(",")[0])), *row.split(",")[1:]]) for row in lines()]
    trial = read_dataset(write(tmp_path, rows, header), object_name=described(tmp_path)).trials[0]
    ours = read_dataset(write(tmp_path, lines()), object_name="rect1").trials[0]
    for channel in ("object_pose", "tip_pose", "ft_wrench"):
        np.testing.assert_allclose(getattr(trial, channel).time, getattr(ours, channel).time, atol=1e-12)
    moved = ours.object_pose.values * [1e-3, 1.0, np.pi / 180.0]
    np.testing.assert_allclose(trial.object_pose.values, moved, rtol=1e-12)
    np.testing.assert_array_equal(trial.tip_pose.values, ours.tip_pose.values)
    np.testing.assert_allclose(trial.ft_wrench.values, ours.ft_wrench.values * [1, 1, 1e-3], rtol=1e-12)


def test_a_header_without_a_column_that_was_named(tmp_path):
    with pytest.raises(
        DatasetError, match="lacks stamp, block x, finger_x; expected columns are stamp, block x, obj"
    ):
        read_dataset(write(tmp_path, lines()), object_name=described(tmp_path))


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("tipx: a", ["csv.tipx", "choose from t, object_x"]),
        ("t: {unit: min}", ["csv.t.unit: must be one of s, ms, us, ns, got 'min'"]),
        ("object_x: {unit: deg}", ["csv.object_x.unit", "m, cm, mm, um"]),
        ("object_x: {name: a}", ["csv.object_x", "'name'", "column and unit"]),
        ("object_x: 3", ["csv.object_x", "3"]),
        ("tip_x: object_x", ["'object_x' cannot be both object_x and tip_x"]),
    ],
)
def test_wrong_words_about_columns_are_answered_with_the_right_ones(tmp_path, entry, words):
    text = OBJECT.split("csv:")[0] + f"csv: {{{entry}}}"
    with pytest.raises(DatasetError) as caught:
        read_dataset(write(tmp_path, lines()), object_name=described(tmp_path, text))
    assert all(word in str(caught.value) for word in ["block.yaml", *words]), caught.value


def test_another_encoding_is_told(tmp_path):
    (tmp_path / "push.csv").write_text("\n".join([HEADER, *lines()]), encoding="utf-16")
    with pytest.raises(DatasetError, match=r"push\.csv: not readable as CSV .* UTF-8"):
        read_dataset(tmp_path / "push.csv", object_name="rect1")


def test_every_bad_file_of_a_folder_is_named(tmp_path):
    names = "t,object_x,object_y,object_theta,tip_x,tip_y\n"
    (tmp_path / "0.csv").write_text(names + "0,0,0,0,-0.2,0\n1,0,0,0,-0.2,0\n")
    (tmp_path / "1.csv").write_text(names + "0,0,0,zero,-0.2,0\n")
    (tmp_path / "2.csv").write_text("t,object_x\n0,0\n")
    with pytest.raises(DatasetError, match=r"2 of 3 files cannot be used.*1\.csv.*'zero'.*2\.csv.*lacks"):
        read_dataset(tmp_path, object_name="rect1")
