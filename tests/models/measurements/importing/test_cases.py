"""Files as laboratories and public bug reports have them, each with a setup.yaml of a few lines."""

import re

import numpy as np
import pytest

from slipmap.models.measurements import DatasetError, read_dataset
from slipmap.models.measurements.importing import guess_setup, import_dataset

ECHO = """
time: field.header.stamp
object_pose: {position: field.transform.translation, quaternion: field.transform.rotation}
tip_pose: {position: field.pose.position}
"""
CASES = {
    "motive_export/motive.csv": "object_pose: {part: block}\ntip_pose: {part: finger}\n",
    "session_in_one_file/session2.csv": "",
    "session_in_one_file/session_push_id.csv": "",
    "text_column/pandas.csv": "",
    "force_without_torque/notau.csv": "",
    "formats_not_read/german.csv": "",
    "formats_not_read/iso.csv": "",
    "formats_not_read/nanwords.csv": "",
    "formats_not_read/quat.csv": "object_pose: {quaternion: [qx, qy, qz, qw]}\n",
    "formats_not_read/ros2.csv": "",
    "formats_not_read/rtde.csv": "",
}
FORCED = ("notau.csv", "german.csv", "rtde.csv")


def imported(shared_data, tmp_path, name, more):
    """The dataset of a case: with a setup of a few lines or, if `more` is None, with a guessed one."""
    file = shared_data / "cases" / name
    setup = tmp_path / "setup.yaml"
    square = (file.parent / "sq.yaml").read_text()
    if more is None:
        found = re.findall(r"^(?:object|finger):.*$", square, flags=re.M)
        kept = [line for line in guess_setup(file).splitlines() if "null}" not in line]
        said = "\n".join((*found, *kept))
    else:
        said = square + more
    assert len(said.splitlines()) <= 20
    setup.write_text(said)
    return import_dataset(file, setup, tell=lambda text: None)


_READ = {}


@pytest.fixture
def original(shared_data):
    """The push that most cases hold, read once."""
    if not _READ:
        _READ["trial"] = read_dataset(shared_data / "real/mcube_steel").trials[0]
    return _READ["trial"]


@pytest.mark.parametrize("guessed", [False, True])
@pytest.mark.parametrize("name", CASES)
def test_a_case_gives_the_values_of_the_original(shared_data, original, tmp_path, name, guessed):
    dataset = imported(shared_data, tmp_path, name, None if guessed else CASES[name])
    assert len(dataset.trials) == (3 if "session" in name else 1)
    late = 0.25 if "ros2" in name else 0.0  # its stamps end in .27 where those of the others do in .02
    late += dataset.trials[-1].start - dataset.trials[0].start
    for trial in dataset.trials[:: len(dataset.trials)]:
        assert len(trial.object_pose.time) > 300
        for channel in ("object_pose", "tip_pose"):
            read, true = getattr(trial, channel), getattr(original, channel)
            at = read.time - late if "ros2" in name else read.time
            inside = at > true.time[0]
            # Rows of the finger are those of the poses there, of which the original has a few more.
            tolerance = 2e-6 if channel == "tip_pose" else 2e-4
            assert read.values[inside] == pytest.approx(true.at(at)[inside], abs=tolerance)
        if name.endswith(FORCED):
            assert np.hypot(*trial.ft_wrench.values[:, :2].T).max() > 2.0
            assert np.abs(trial.ft_wrench.at(1.0) - original.ft_wrench.at(1.0)).max() < 0.3
        else:
            assert trial.ft_wrench is None


@pytest.mark.parametrize("says", [ECHO, None])
def test_a_merged_table_of_rostopic(shared_data, tmp_path, says):
    dataset = imported(shared_data, tmp_path, "text_column/merged.csv", says)
    trial = dataset.trials[0]
    assert trial.object_pose.values[0] == pytest.approx([-0.028882, -0.245119, 0.046165], abs=1e-5)
    assert trial.tip_pose.values[0] == pytest.approx([0.359975, -0.300026], abs=1e-6)
    assert trial.object_pose.time[0] == pytest.approx(0.480549, abs=1e-6)
    assert len(trial.object_pose.time) == 74 and len(trial.tip_pose.time) == 65


def test_stamps_that_go_back_are_sorted(shared_data, tmp_path):
    """In the bag's own order, stamps go back by 4 to 5 ms."""
    case = shared_data / "cases/duplicate_stamps"
    header, *rows = (case / "plastic0.csv").read_text().splitlines()
    seen = [row for row, text in enumerate(rows) if text.split(",")[1]]
    for one, two in zip(seen[40:121:40], seen[41:122:40], strict=True):
        rows[one], rows[two] = rows[two], rows[one]
    (tmp_path / "plastic0.csv").write_text("\n".join((header, *rows)))
    told = []
    dataset = import_dataset(tmp_path / "plastic0.csv", case / "sq.yaml", tell=told.append)
    sorted_ = imported(shared_data, tmp_path, "duplicate_stamps/plastic0.csv", "")
    assert any("go back" in text and "the rows were sorted" in text for text in told)
    assert np.array_equal(dataset.trials[0].object_pose.values, sorted_.trials[0].object_pose.values)
    assert any("15 mm into the object" in text for text in told)  # the frames are not calibrated


def test_torque_is_optional(shared_data):
    dataset = read_dataset(shared_data / "cases/force_without_torque/nan_tau")
    forces = [np.hypot(*trial.ft_wrench.values[:, :2].T).max() for trial in dataset.trials]
    assert min(forces) > 1.0


def test_every_bad_file_is_named(tmp_path):
    for number in range(3):
        (tmp_path / f"{number}.csv").write_text("t,object_x\n0,1\n")
    setup = tmp_path / "setup.yaml"
    setup.write_text("object: {outline: [[0, 0], [0.1, 0], [0, 0.1]]}\nfinger: {radius: 0.005}\n")
    with pytest.raises(DatasetError, match=r"3 of 3 recordings.*0\.csv, 1\.csv, 2\.csv: ") as told:
        import_dataset(tmp_path, setup)
    assert str(told.value).count("which columns") == 1
