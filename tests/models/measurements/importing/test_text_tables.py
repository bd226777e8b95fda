"""Tables in text of many dialects, and exports of motion-capture programs, give the numbers in them."""

import numpy as np
import pytest
from tables import POSE, SETUP, TIME, TIP, written

from slipmap.models.measurements import DatasetError
from slipmap.models.measurements.importing import import_dataset
from slipmap.models.measurements.importing.source import Source
from slipmap.models.measurements.importing.text_tables import read_text, seconds


def source(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    return read_text(tmp_path / "a.csv", "a.csv")


@pytest.mark.parametrize(
    "text",
    [
        "t,x\n0,1.5\n0.5,-2.25\n",
        "t;x\n0;1,5\n0,5;-2,25\n",
        "t;x\n0;1.5\n0.5;-2.25\n",
        "t\tx\n0\t1,5\n0,5\t-2,25\n",
        "t x\n0 1.5\n0.5 -2.25\n",
        "t   x\n0,0   1,5\n0,5   -2,25\n",
        "# t x\n0 1.5\n0.5 -2.25\n",
        "# written by a robot\nt,x\n0,1.5\n0.5,-2.25\n",
        '"t","x"\r\n"0","1.5"\r\n"0.5","-2.25"\r\n',
        "t, x,\n0, 1.5,\n0.5, -2.25,\n",
        "\ufefft,x\n0,1.5\n0.5,-2.25\n",
        "\ufeffsep=;\r\nt;x\r\n0;1,5\r\n0,5;-2,25\r\n",
        't,x\n"0,0","1,5"\n"0,5","-2,25"\n',
    ],
)
def test_dialects(tmp_path, text):
    (table,) = source(tmp_path, text)
    assert table.numbers("t") == pytest.approx([0.0, 0.5])
    assert table.numbers("x") == pytest.approx([1.5, -2.25])


def test_a_line_of_units_under_the_header_is_told(tmp_path):
    with pytest.raises(DatasetError, match=r"row 0: there are words below the header, such as 'ms'"):
        source(tmp_path, "t,x\nms,mm\n0,1.5\n")
    (table,) = source(tmp_path, "t,x\n,N/A\n0,1.5\n")
    assert table.numbers("x")[1] == 1.5

    with pytest.raises(DatasetError, match=r"below the header, such as 'mm'"):
        source(tmp_path, "t,x\n,mm\n0,1.5\n")


@pytest.mark.parametrize(
    "above",
    ["Experiment: block 7\n", "Block, run 3\n\nOperator;JK\nrate = 100 Hz\n", "# written by hand\nBlock\n"],
)
@pytest.mark.parametrize("sign", [",", ";", "\t"])
@pytest.mark.parametrize("end", ["", "sign"])
def test_lines_above_the_header_are_passed_over(tmp_path, above, sign, end):
    rows = [
        ["t", "x", "y", "z", "w", "v"],
        *[[f"{0.1 * k:.1f}", "1.5", "2.5", "3", "4", "5"] for k in range(20)],
    ]
    lines = [sign.join(row) + (sign if end and k else "") for k, row in enumerate(rows)]
    (table,) = source(tmp_path, above + "\n".join(lines) + "\n")
    assert table.numbers("t") == pytest.approx(0.1 * np.arange(20))
    assert table.numbers("y") == pytest.approx(np.full(20, 2.5))


def test_a_header_with_too_few_names_is_shown(tmp_path):
    rows = "0,1,2,3,4,5\n" * 20
    with pytest.raises(DatasetError, match=r"row 0: has 6 cells, but the header 't,pose' has 2"):
        source(tmp_path, "t,pose\n" + rows)
    # Numbers are no header below a title, also where words stand beside them.
    for first in ("t,pose", "0"):
        with pytest.raises(DatasetError, match="has 4 cells, but the header"):
            source(tmp_path, f"{first}\n" + "0,1,2,ok\n" * 20)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("t;x\n0,143;24,405\n0,153;102,734\n", [24.405, 102.734]),
        ("t;x\n1;24,405\n2;102,734\n", [24.405, 102.734]),  # semicolons, since commas are decimal
        ("t\tx\n1,000\t24,405\n2,000\t-0,734\n", [24.405, -0.734]),  # no group of thousands starts with 0
        ("t\tx\n" + 40 * "1,000\t24,405\n" + "2,000\t24,40\n", [24.405] * 40 + [24.4]),
        ("t;x\n0;1.024,5\n0,5;-2,25\n", [1024.5, -2.25]),
        ("t;x\n" + 40 * "0;1,5\n" + "0;0.5\n", [1.5] * 40 + [0.5]),  # a later line of another dialect
        ("t;x\n" + 40 * "0;1,5\n" + "0;0.123\n", [1.5] * 40 + [0.123]),
    ],
)
def test_decimal_commas_with_three_decimals(tmp_path, text, wanted):
    (table,) = source(tmp_path, text)
    assert table.numbers("x") == pytest.approx(wanted)


@pytest.mark.parametrize("text", ['t,x\n1,"1,500"\n2,"2,500"\n', "t\tx\n1\t1,500\n2\t2,500\n"])
def test_commas_of_either_meaning_are_refused(tmp_path, text):
    (table,) = source(tmp_path, text)
    assert table.numbers("t") == pytest.approx([1.0, 2.0])
    with pytest.raises(DatasetError, match=r"row 0, x: '1,500' may be 1.5 or 1500; write decimal points"):
        table.numbers("x")


@pytest.mark.parametrize("text", ['t,x\n1,"1,500"\n2.5,"2,500"\n', "t;x\n1;1,500\n2;1,234,567\n"])
def test_thousands_are_no_decimals(tmp_path, text):
    (table,) = source(tmp_path, text)
    with pytest.raises(DatasetError, match="'1,500' is not a number"):
        table.numbers("x")


def test_no_header(tmp_path):
    (table,) = source(tmp_path, "0 1.5\n0.5 -2.25\n")
    assert table.numbers("1") == pytest.approx([1.5, -2.25])


def test_words_for_no_number_and_texts_nobody_asked_for(tmp_path):
    (table,) = source(tmp_path, "t,x,phase\n0,N/A,push\n1,,push\n2,null,rest\n3,7,rest\n")
    assert table.numbers("x")[3] == 7.0 and np.isnan(table.numbers("x")[:3]).all()
    with pytest.raises(DatasetError, match="row 0, phase: 'push' is not a number"):
        table.numbers("phase")


def test_underscores_make_no_numbers(tmp_path):
    """Though Python reads 1_0 as 10."""
    (table,) = source(tmp_path, "t,x\n0,1.5\n0.5,1_0\n")
    with pytest.raises(DatasetError, match=r"a\.csv, row 1, x: '1_0' is not a number"):
        table.numbers("x")
    (table,) = source(tmp_path, "1_0,2_0\n0,1.5\n")
    assert table.numbers("2_0") == [1.5]


def test_only_digits_number_a_column(tmp_path):
    (table,) = source(tmp_path, "t,x\n0,1.5\n")
    assert table.name_of("1") == "x"
    for odd in ("²", "１", "-1"):
        with pytest.raises(DatasetError, match=f"there is no column '{odd}'"):
            table.name_of(odd)


def test_a_text_with_a_comma_makes_no_decimal_commas(tmp_path):
    (table,) = source(tmp_path, "t\tx\tnote\n0\t1.5\tok\n0.5\t-2.25\t1,2\n")
    assert table.numbers("x") == pytest.approx([1.5, -2.25])


def test_numbers_of_pushes_keep_all_their_digits():
    table = Source("a.h5", "log", {"push": np.array([20240206001.0, 20240206002.0, 7.5])})
    assert table.texts("push") == ["20240206001", "20240206002", "7.5"]


@pytest.mark.parametrize(
    ("cells", "wanted"),
    [
        (["2024-02-06T15:25:00.020", "2024-02-06T15:25:01.5"], [1707233100.02, 1707233101.5]),
        (["2024-02-06 15:25:00.020Z", "2024-02-06 16:25:01.5+01:00"], [1707233100.02, 1707233101.5]),
        (["01:02:03.5", "01:02:04"], [3723.5, 3724.0]),
        (["23:59:59.5", "", "00:00:00.5", "00:00:01"], [86399.5, np.nan, 86400.5, 86401.0]),
        (["23:00:00", "01:00:00", "23:00:00", "01:00:00"], [82800.0, 90000.0, 169200.0, 176400.0]),
        (["00:00:09", "00:00:10", "00:00:00", "00:00:01"], [9.0, 10.0, 0.0, 1.0]),  # starts again
        (["01:00:00", "23:00:00"], [3600.0, 82800.0]),
        (["2024-02-07T00:00:01", "2024-02-06T00:00:00"], [1707264001.0, 1707177600.0]),
        (["1700000000250000000", "1700000001000000000"], [1700000000.25, 1700000001.0]),
        (["1700000000250", "1700000001000"], [1700000000.25, 1700000001.0]),
        (["1700000000.25", "1700000001"], [1700000000.25, 1700000001.0]),
    ],
)
def test_times(tmp_path, cells, wanted):
    (table,) = source(tmp_path, "when,x\n" + "".join(f"{cell},1\n" for cell in cells))
    assert seconds(table, ["when"], None)[0] == pytest.approx(wanted, abs=1e-6, nan_ok=True)


def test_missing_times_and_words_that_are_none():
    stamps = ["NaT", "06.02.2024 15:25:00.5", "", "06.02.2024 15:25:01.0"]
    time, _ = seconds(Source("a", "", {"t": stamps}), ["t"], None)
    assert time[3] - time[1] == pytest.approx(0.5) and np.isnan(time[[0, 2]]).all()
    assert time[1] == pytest.approx(1707233100.5)  # the sixth of February
    with pytest.raises(DatasetError, match=r"row 0, t: '02/06/2024 03:25 PM' is not a time; write s, 2024-"):
        seconds(Source("a", "", {"t": ["02/06/2024 03:25 PM"]}), ["t"], None)


def test_nanoseconds_since_a_start_are_no_milliseconds_since_1970(tmp_path):
    """88 minutes in ns are the year 2138 in ms."""
    count = 5.3e12 + 1e9 * TIME
    time, told = seconds(Source("a", "", {"t": count}), ["t"], None)
    assert told == "" and time == pytest.approx(count)
    photos = 1.7e12 + 2e5 * np.arange(8.0)  # in ms, before and after pushes
    time, told = seconds(Source("a", "", {"t": photos}), ["t"], None)
    assert told == "t counts ms since 1970" and np.diff(time) == pytest.approx(200.0)
    names = ["t", "x", "y", "theta", "a", "b"]
    for factor, unit in ((1.0, "nano"), (1e-3, "micro"), (1e-6, "milli")):
        file = written(tmp_path / "p.csv", names, [1e9 * factor * TIME, POSE, TIP])
        (tmp_path / "s.yaml").write_text(SETUP + "tip_pose: {position: [a, b]}\n")
        with pytest.raises(DatasetError, match=f"were these {unit}seconds"):
            import_dataset(file, tmp_path / "s.yaml")


def test_rostopic_echo(tmp_path):
    names = "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.pose.position.x"
    (table,) = source(tmp_path, names + "\n1700000000300000000,1,1700000000250000000,/world,0.5\n")
    assert table.time == pytest.approx([1700000000.25], abs=1e-6)
    assert table.numbers("field.pose.position.x") == [0.5]


def test_vicon(tmp_path):
    text = (
        "Objects\n200\n,,lab:block,,,,,,lab:finger,,,,,\n"
        "Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ,RX,RY,RZ,TX,TY,TZ\n,,deg,deg,deg,mm,mm,mm,deg,deg,deg,mm,mm,mm\n"
        "1,0,0,0,90,100,200,30,0,0,0,10,20,30\n2,0,0,0,45,110,210,30,0,0,0,11,21,30\n"
    )
    block, finger = source(tmp_path, text)
    assert (block.part, finger.part, block.length) == ("lab:block", "lab:finger", "mm")
    assert np.diff(block.time) == pytest.approx([1 / 200])
    assert block.numbers("rz") == pytest.approx([90, 45]) and block.angle == "deg"
    assert finger.numbers("x") == pytest.approx([10, 11])


@pytest.mark.parametrize(
    ("unit", "times"), [("", 1.0), ("unit: {angle: deg}\n", 1.0), ("unit: {angle: rad}\n", np.degrees(1.0))]
)
def test_vicon_is_imported_in_its_unit_or_the_stated_one(tmp_path, unit, times):
    rows = np.column_stack(
        [np.arange(len(TIME)), 0 * TIME, np.zeros((len(TIME), 2)), np.degrees(POSE[:, 2] + 0.03),
         1e3 * POSE[:, :2], 30 + 0 * TIME]
    )  # fmt: skip
    head = "Objects\n100\n,,lab:block,,,,,\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n,,deg,deg,deg,mm,mm,mm\n"
    (tmp_path / "v.csv").write_text(head + "\n".join(",".join(f"{c:.6f}" for c in row) for row in rows))
    (tmp_path / "s.yaml").write_text(SETUP + unit + "object_pose: {part: block}\ntip_pose: null\n")
    (trial,) = import_dataset(tmp_path / "v.csv", tmp_path / "s.yaml").trials
    assert trial.object_pose.values == pytest.approx(POSE + np.array([0.0, 0.0, 0.03 * times]), abs=1e-6)


def motive(order, axes, angles):
    """One rigid body in Euler angles, degrees."""
    kinds = ",".join(["Rotation"] * 3 + ["Position"] * 3)
    rows = "\n".join(
        f"{k},{k / 100},{a},{b},{c},0.1,0.05,0.2" for k, (a, b, c) in enumerate(angles)
    )  # fmt: skip
    return (
        f"Format Version,1.23,Take Name,t,Rotation Type,{order},Length Units,Meters\n\n"
        ",Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body\n"
        ",Name,b,b,b,b,b,b\n,ID,1,1,1,1,1,1\n"
        f",,{kinds}\nFrame,Time (Seconds),{axes},X,Y,Z\n{rows}\n"
    )


def test_motive_in_euler_angles(tmp_path):
    # A body that lies level and turns about Motive's y, which is up; beyond 90° the other two turn over.
    (body,) = source(tmp_path, motive("XYZ", "X,Y,Z", [(0, 40, 0), (180, 40, 180)]))
    turns = 2.0 * np.degrees(np.arctan2(body.numbers("qy"), body.numbers("qw")))
    assert turns % 360.0 == pytest.approx([40.0, 140.0])
    assert body.length == "m" and body.up == "y"


def test_two_coordinates_of_a_motive_export_are_refused(tmp_path):
    (tmp_path / "m.csv").write_text(motive("XYZ", "X,Y,Z", [(0, 40, 0)] * 20))
    (tmp_path / "s.yaml").write_text(SETUP + "object_pose: {position: [x, z]}\ntip_pose: null\n")
    with pytest.raises(DatasetError, match=r"m\.csv, b: object_pose: with up: y .* needs x, y and z"):
        import_dataset(tmp_path / "m.csv", tmp_path / "s.yaml")


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "empty"),
        ("t,x\n", "no rows"),
        ("#\n", "no rows"),
        ("# t,x\n#\n\n", "no rows"),
        ("t,x\n1,2,3\n", "row 0: has 3 cells, but the header 't,x' has 2"),
        ("a\0b", "not a text file"),
        ("Format Version,1.23,Take Name,t\n1,2\n", "lacks the lines Name and Frame"),
        ("Objects\nfast\n,,a\nFrame,Sub Frame,RX\n,,deg\n1,0,1\n", "the rate in Hz"),
    ],
)
def test_a_broken_table_is_refused(tmp_path, text, fault):
    with pytest.raises(DatasetError, match=fault):
        source(tmp_path, text)


def test_stamps_that_go_back_are_sorted_and_said(tmp_path):
    order = np.arange(len(TIME))
    order[[40, 41]] = [41, 40]
    columns = [TIME[order], POSE[order], TIP[order]]
    file = written(tmp_path / "p.csv", ["t", "x", "y", "theta", "a", "b"], columns)
    (tmp_path / "s.yaml").write_text(SETUP + "tip_pose: {position: [a, b]}\n")
    said = []
    (trial,) = import_dataset(file, tmp_path / "s.yaml", tell=said.append).trials
    assert (np.diff(trial.object_pose.time) > 0).all() and len(trial.object_pose.time) == len(TIME)
    assert any("go back 1 times, by up to 10 ms" in text for text in said), said
