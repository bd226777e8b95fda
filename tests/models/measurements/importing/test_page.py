"""Each setup of the page about importing reads a file of the kind that its section is about."""

import re
from pathlib import Path

import numpy as np
import pytest
from lab_session import _write_motive
from tables import TIME, WAY, written

from slipmap.models.measurements.importing import import_dataset

PAGE = Path(__file__).parents[4] / "docs" / "import.md"
PARTS = re.split(r"^### ", PAGE.read_text(encoding="utf-8"), flags=re.M)
SETUPS = {part.splitlines()[0]: re.findall(r"```yaml\n(.*?)```", part, flags=re.S) for part in PARTS}
POSE = np.column_stack([np.maximum(WAY - 0.01, 0.0), 0.0 * TIME + 0.02, 0.0 * TIME + 0.1])
TIP = np.column_stack([WAY - 0.066, 0.0 * TIME + 0.02])
HALF = 0.5 * POSE[:, 2]
TURN = np.column_stack([0.0 * TIME, 0.0 * TIME, np.sin(HALF), np.cos(HALF)])
FORCE = np.column_stack([2.0 * (POSE[:, 0] > 0.0), 0.0 * TIME])


def least(folder):
    names = ["t", "object_x", "object_y", "object_theta", "tip_x", "tip_y"]
    written(folder / "a.csv", names, [TIME, POSE, TIP])


def quaternions(folder):
    names = [
        "stamp.sec",
        "stamp.nanosec",
        "block_x",
        "block_y",
        "qx",
        "qy",
        "qz",
        "qw",
        "finger.x",
        "finger.y",
        "Fx",
        "Fy",
    ]
    stamps = [1e4 + np.floor(TIME), np.round(1e9 * (TIME % 1.0))]
    written(folder / "a.csv", names, [*stamps, 1e3 * POSE[:, :2], TURN, 1e3 * TIP, FORCE], ";", "{:.9f}")


def without_header(folder):
    rows = np.column_stack([np.arange(len(TIME)), POSE[:, :2], np.degrees(POSE[:, 2]), TIP])
    rows[:, 0] *= 1.2  # of 100 Hz, as frames of 120 Hz
    (folder / "a.txt").write_text("\n".join(" ".join(f"{cell:.7f}" for cell in row) for row in rows))


def motive(folder):
    quiet = np.random.default_rng(0)
    columns = []
    for name, values in (("block", POSE), ("finger", np.column_stack([TIP, 0.0 * TIME]))):
        _write_motive(folder / "part", TIME, lambda times, track: track, values, quiet)
        columns.append([line.replace("hammer", name) for line in (folder / "part").read_text().splitlines()])
    (folder / "part").unlink()
    lines = [
        one if number < 2 else f"{one},{','.join(two.split(',')[2:])}"
        for number, (one, two) in enumerate(zip(*columns, strict=True))
    ]
    (folder / "take_1.csv").write_text("\n".join(lines) + "\n")


def echo(folder):
    names = ["field.header.stamp", *(f"field.transform.translation.{axis}" for axis in "xyz"),
             *(f"field.transform.rotation.{axis}" for axis in "xyzw"),
             *(f"field.pose.position.{axis}" for axis in "xyz")]  # fmt: skip
    height = 0.0 * TIME
    stamp = 1e9 * (1_700_000_000 + TIME)
    written(folder / "a.csv", names, [stamp, POSE[:, :2], height, TURN, TIP, height], form="{:.9f}")


def hdf5(folder):
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "a.h5", "w") as file:
        file["log/pose"] = np.column_stack([TIME, POSE])
        file["log/tip"], file["log/t"] = TIP, TIME


def lerobot(folder):
    pyarrow = pytest.importorskip("pyarrow", reason="pyarrow comes with the extra `import`")
    from pyarrow import parquet

    state = np.column_stack([POSE, TIP]).tolist()
    rows = {"observation.state": state, "timestamp": TIME, "episode_index": [0] * len(TIME)}
    parquet.write_table(pyarrow.table(rows), folder / "a.parquet")


def moved(folder):
    """Tracked elsewhere than the outline and the finger, with angle and force of the opposite sign."""
    c, s = np.cos(POSE[:, 2] - np.radians(5.0)), np.sin(POSE[:, 2] - np.radians(5.0))
    place = POSE[:, :2] - np.column_stack([0.01 * c + 0.02 * s, 0.01 * s - 0.02 * c])
    angle = -(POSE[:, 2] - np.radians(5.0))
    names = ["t", "x", "y", "theta", "a", "b", "fx", "fy"]
    written(folder / "a.csv", names, [TIME, place, angle, TIP - [0.004, 0.0], -FORCE], form="{:.9f}")


@pytest.mark.parametrize(
    ("section", "number", "write"),
    [
        ("The least", 0, least), ("Tables", 0, quaternions), ("Tables", 1, without_header),
        ("Motion capture", 0, motive), ("ROS", 1, echo), ("Arrays", 0, hdf5), ("Arrays", 1, lerobot),
        ("Frames, signs and offsets", 0, moved),
    ],
)  # fmt: skip
def test_a_setup_of_the_page_reads_its_kind_of_file(tmp_path, section, number, write):
    (tmp_path / "files").mkdir()
    write(tmp_path / "files")
    (tmp_path / "setup.yaml").write_text(SETUPS[section][number])
    (trial,) = import_dataset(tmp_path / "files", tmp_path / "setup.yaml", tell=lambda text: None).trials
    noise = 1e-3 if write is motive else 2e-6
    time = trial.object_pose.time - trial.object_pose.time[0]
    shown = np.column_stack([np.interp(time, TIME, column) for column in POSE.T])
    assert trial.object_pose.values[:, :2] == pytest.approx(shown[:, :2], abs=noise)
    assert trial.object_pose.values[:, 2] == pytest.approx(shown[:, 2], abs=10.0 * noise)
    time = trial.tip_pose.time - trial.tip_pose.time[0]
    shown = np.column_stack([np.interp(time, TIME, column) for column in TIP.T])
    assert trial.tip_pose.values == pytest.approx(shown, abs=noise)
