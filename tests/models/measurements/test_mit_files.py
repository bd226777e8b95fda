import json
import math

import h5py
import numpy as np
import pytest
import yaml
from example_dataset import push_record
from shapely.geometry import Polygon

from slipmap.models.measurements import DatasetError, read_dataset
from slipmap.models.measurements.mit_files import MIT_SHAPES, THICKNESS

NAME = "motion_surface=plywood_shape=rect1_a=0_v=50_i=1.000_s=0.{:03d}_t=-0.349"


def mit_record(index=0):
    """A push of a 90 mm square, as the laboratory stores it: with the force on the finger."""
    record = push_record(0.05, 0.01 * index)
    for row in record["tip_pose"]:
        row[1] += 0.005
    for row in record["ft_wrench"]:
        row[1:] = [-value for value in row[1:]]
    return record


def write_json(folder, index=0, record=None, name=NAME):
    folder.mkdir(exist_ok=True)
    path = folder / (name.format(index) + ".json")
    path.write_text(json.dumps(record or mit_record(index)))
    return path


def write_hdf5(folder, index=0, record=None, ending=".h5"):
    folder.mkdir(exist_ok=True)
    path = folder / (NAME.format(index) + ending)
    with h5py.File(path, "w") as file:
        for key, rows in (record or mit_record(index)).items():
            file.create_dataset(key, data=np.array(rows))
    return path


@pytest.mark.parametrize("write", [write_json, write_hdf5])
def test_the_force_is_turned_into_that_on_the_object(tmp_path, write):
    dataset = read_dataset(write(tmp_path / "pushes"))
    trial = dataset.trials[0]
    stored = np.array(mit_record()["ft_wrench"])
    np.testing.assert_array_equal(trial.ft_wrench.time, stored[:, 0])
    np.testing.assert_array_equal(trial.ft_wrench.values, -stored[:, 1:])
    moving = trial.object_pose.values[-1, :2] - trial.object_pose.values[0, :2]
    assert trial.ft_wrench.values[-1, :2] @ moving > 0.0  # a finger pushes, it does not pull
    np.testing.assert_array_equal(trial.object_pose.values, np.array(mit_record()["object_pose"])[:, 1:])


def test_object_finger_and_names_come_from_the_laboratory(tmp_path):
    dataset = read_dataset(write_json(tmp_path / "pushes"))
    assert (dataset.mass, dataset.height, dataset.finger_radius) == (0.8374, 0.013, 0.00475)
    assert dataset.grid.polygon.area == pytest.approx(0.09**2)
    assert dataset.gravity == 9.81 and dataset.warnings == ()
    assert dataset.trials[0].name == NAME.format(0) + ".json"
    assert "rect1" in dataset.description


def test_a_folder_is_split_in_sorted_order(tmp_path):
    folder = tmp_path / "pushes"
    for index in (8, 3, 1, 0, 5, 2, 7, 4, 6):
        (write_hdf5 if index % 2 else write_json)(folder, index % 4 if index < 4 else index, None)
    (folder / ".hidden.json").write_text("{")
    (folder / "notes.txt").write_text("hello")
    dataset = read_dataset(folder)
    assert [trial.name for trial in dataset.trials] == sorted(p.name for p in folder.glob("motion*"))
    assert [trial.role for trial in dataset.trials] == ["fit"] * 7 + ["heldout"] * 2
    assert dataset.name == "pushes"


@pytest.mark.parametrize(("count", "heldout"), [(1, 0), (3, 0), (4, 1), (7, 1), (8, 2)])
def test_the_last_quarter_is_heldout(tmp_path, count, heldout):
    for index in range(count):
        write_json(tmp_path / "pushes", index)
    assert len(read_dataset(tmp_path / "pushes").heldout_trials) == heldout


def test_the_shipped_push_reads_as_its_converted_twin(shared_data, tmp_path):
    """The source file is the shipped one with the sign of the force turned back."""
    shipped = shared_data / "real/mit_plywood_hex"
    record = json.loads((shipped / "trials/000.json").read_text())
    record["ft_wrench"] = [[row[0], *(-value for value in row[1:])] for row in record["ft_wrench"]]
    name = "motion_surface=plywood_shape=hex_a=0_v=150_i=1.000_s=0.000_t=-0.349"
    dataset, twin = (
        read_dataset(write_json(tmp_path / "raw", record=record, name=name)),
        read_dataset(shipped),
    )
    np.testing.assert_array_equal(dataset.trials[0].ft_wrench.values, twin.trials[0].ft_wrench.values)
    np.testing.assert_allclose(dataset.grid.exterior, np.roll(twin.grid.exterior, 1, axis=0), atol=1e-7)
    assert (dataset.mass, dataset.finger_radius, dataset.height) == (
        twin.mass,
        twin.finger_radius,
        twin.height,
    )


def test_the_trial_of_a_push_dataset_is_not_taken_for_an_mit_file(example):
    folder = example.write()
    for path in (folder / "trials/000.json", folder / "trials"):
        with pytest.raises(
            DatasetError, match=r"belongs to the push dataset .*example, whose forces have the opposite"
        ):
            read_dataset(path, object_name="rect1")


def test_an_object_of_ones_own(tmp_path):
    path = write_json(tmp_path / "pushes", name="push_{}")
    own = {
        "name": "mine",
        "object": {"outline": [[-0.045, -0.045], [0.045, -0.045], [0.045, 0.045], [-0.045, 0.045]]},
        "finger": {"radius": 0.004},
        "gravity": 9.7,
        "surfaces": 3,
    }
    (tmp_path / "object.yaml").write_text(yaml.safe_dump(own))
    dataset = read_dataset(path, object_name=str(tmp_path / "object.yaml"))
    assert (dataset.name, dataset.finger_radius, dataset.gravity, dataset.mass) == ("mine", 0.004, 9.7, None)
    assert len(dataset.warnings) == 1 and "'surfaces' is unknown" in dataset.warnings[0]
    before = dataset.fingerprint
    (tmp_path / "object.yaml").write_text(yaml.safe_dump(own | {"gravity": 9.8}))
    assert read_dataset(path, object_name=str(tmp_path / "object.yaml")).fingerprint != before


def test_the_object_must_be_known(tmp_path):
    nameless = write_json(tmp_path / "pushes", name="push_{}")
    with pytest.raises(
        DatasetError, match=r"does not say which object was pushed.* \(ellip1, .* or a YAML file"
    ):
        read_dataset(nameless)
    assert read_dataset(nameless, object_name="rect1").mass == 0.8374
    with pytest.raises(DatasetError, match="the outline of 'rect9' is unknown; known are ellip1,"):
        read_dataset(nameless, object_name="rect9")
    with pytest.raises(DatasetError, match=r"object\.yaml: there is no such file"):
        read_dataset(nameless, object_name="object.yaml")
    with pytest.raises(DatasetError, match="say shape=rect1, not hex"):
        read_dataset(write_json(tmp_path / "named"), object_name="hex")
    butterfly = write_json(tmp_path / "butterfly", name="motion_shape=butter_{}")
    with pytest.raises(DatasetError, match="the outline of 'butter'"):
        read_dataset(butterfly)


def test_a_folder_is_about_one_object(tmp_path):
    write_json(tmp_path / "pushes", 0)
    write_json(tmp_path / "pushes", 1, name="motion_shape=hex_{}")
    with pytest.raises(
        DatasetError, match=r"shape=hex_1\.json is about hex, .* about rect1; a dataset has one"
    ):
        read_dataset(tmp_path / "pushes")


def test_two_surfaces_are_mentioned(tmp_path):
    write_json(tmp_path / "pushes", 0)
    write_json(tmp_path / "pushes", 1, name="motion_surface=abs_shape=rect1_{}")
    assert "surfaces, abs, plywood" in read_dataset(tmp_path / "pushes").warnings[0]


@pytest.mark.parametrize("write", [write_json, write_hdf5])
def test_faults_name_file_and_row(tmp_path, write):
    record = mit_record()
    record["tip_pose"][12][0] = record["tip_pose"][11][0]
    path = write(tmp_path / "pushes", record=record)
    with pytest.raises(DatasetError, match=r"tip_pose, row 12: time .* repeats that of row 11") as caught:
        read_dataset(path)
    assert path.name in str(caught.value)
    del record["tip_pose"]
    with pytest.raises(DatasetError, match="`tip_pose` is missing"):
        read_dataset(write(tmp_path / "pushes", record=record))


def test_force_can_be_missing_or_empty(tmp_path):
    record = mit_record()
    record["ft_wrench"] = []
    assert read_dataset(write_hdf5(tmp_path / "a", record=record)).trials[0].ft_wrench is None
    del record["ft_wrench"]
    assert read_dataset(write_hdf5(tmp_path / "b", record=record)).trials[0].ft_wrench is None
    record["object_pose"][3][1] = math.nan
    assert len(read_dataset(write_hdf5(tmp_path / "c", record=record)).trials[0].object_pose.time) == 99


def hdf5_of(change):
    def write(path):
        with h5py.File(path, "w") as file:
            for key, rows in mit_record().items():
                file.create_dataset(key, data=np.array(rows))
            del file["tip_pose"]
            change(file)

    return write


@pytest.mark.parametrize(
    ("write", "word"),
    [
        (lambda path: path.write_bytes(b""), "not readable as HDF5"),
        (lambda path: path.write_bytes(b"\x89HDF\r\n\x1a\n" + b"\0" * 100), "not readable as HDF5"),
        (hdf5_of(lambda file: file.create_group("tip_pose")), "must be an array inside the file"),
        (hdf5_of(lambda file: file.create_dataset("tip_pose", data=b"text")), "must contain numbers"),
        (hdf5_of(lambda file: file.create_dataset("tip_pose", data=[["a", "b"]])), "must contain numbers"),
        (hdf5_of(lambda file: file.create_dataset("tip_pose", data=np.zeros((3, 5)))), r"the shape \(3, 5\)"),
        (hdf5_of(lambda file: file.create_dataset("tip_pose", data=1.0)), r"the shape \(\)"),
        (hdf5_of(lambda file: file.create_dataset("tip_pose", (10**12, 4), "f8", chunks=(9, 4))), "at most"),
        (hdf5_of(lambda file: file.create_dataset("tip_pose", data=h5py.Empty("f"))), "tip_pose"),
        (hdf5_of(lambda file: file.update(tip_pose=h5py.ExternalLink("/etc/passwd", "/x"))), "is missing"),
        (hdf5_of(lambda file: file.update(tip_pose=h5py.SoftLink("/object_pose"))), "is missing"),
    ],
)  # fmt: skip
def test_hdf5_that_is_of_no_use(tmp_path, write, word):
    path = tmp_path / "motion_shape=rect1.h5"
    write(path)
    with pytest.raises(DatasetError, match=word) as caught:
        read_dataset(path)
    assert path.name in str(caught.value)


def test_hdf5_does_not_read_other_files(tmp_path):
    path = tmp_path / "motion_shape=rect1.h5"
    (tmp_path / "raw.bin").write_bytes(np.zeros((9, 4)).tobytes())
    outside = [(str(tmp_path / "raw.bin"), 0, 288)]
    hdf5_of(lambda file: file.create_dataset("tip_pose", (9, 4), "f8", external=outside))(path)
    with pytest.raises(DatasetError, match="must be an array inside the file"):
        read_dataset(path)


@pytest.mark.parametrize("name", sorted(MIT_SHAPES))
def test_area_thickness_and_mass_agree_on_steel(name):
    shape = MIT_SHAPES[name]
    outline = Polygon(shape.outline)
    assert outline.exterior.is_ccw
    assert 7750.0 < shape.mass / (outline.area * THICKNESS) < 8050.0


def test_the_circle_and_the_ellipses_are_round_enough():
    for name, along_y in (("ellip1", 0.105), ("ellip2", 0.13089), ("ellip3", 0.157)):
        x, y = MIT_SHAPES[name].outline.T
        np.testing.assert_allclose((2 * x / 0.105) ** 2 + (2 * y / along_y) ** 2, 1.0)
        middles = 0.5 * (MIT_SHAPES[name].outline + np.roll(MIT_SHAPES[name].outline, 1, axis=0))
        inside = 1.0 - np.hypot(2 * middles[:, 0] / 0.105, 2 * middles[:, 1] / along_y)
        assert np.max(inside) * along_y / 2 < 5e-5
