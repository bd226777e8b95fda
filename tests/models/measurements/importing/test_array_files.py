"""Arrays in MATLAB, HDF5, zarr and parquet files, by their paths; what is hostile is refused."""

import json
import zlib

import h5py
import numpy as np
import pytest
from scipy.io import savemat
from tables import POSE, SETUP, TIME, TIP

from slipmap.models.measurements import DatasetError
from slipmap.models.measurements.importing import array_files, import_dataset
from slipmap.models.measurements.importing.files import find_files, read_sources

SAYS = "object_pose: {part: log, position: [pose.0, pose.1], angle: pose.2, time: t}\n"
SAYS += "tip_pose: {part: log, position: tip, time: t}\n"


def check(tmp_path, file, says=SAYS):
    (tmp_path / "s.yaml").write_text(SETUP + says)
    (trial,) = import_dataset(file, tmp_path / "s.yaml", tell=lambda text: None).trials
    assert trial.object_pose.values == pytest.approx(POSE, abs=1e-9)
    assert trial.object_pose.time == pytest.approx(TIME)
    assert trial.tip_pose.values == pytest.approx(TIP, abs=1e-9)


def test_matlab(tmp_path):
    savemat(tmp_path / "a.mat", {"log": {"t": TIME, "pose": POSE, "tip": TIP}, "note": "a text"})
    check(tmp_path, tmp_path / "a.mat")
    savemat(tmp_path / "b.mat", {"log": {"t": TIME, "pose": POSE.T, "tip": TIP}}, do_compression=True)
    check(tmp_path, tmp_path / "b.mat")


def test_hdf5(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["log/t"], file["log/pose"], file["log/tip"] = TIME, POSE, TIP
        file["log/elsewhere"] = h5py.ExternalLink("other.h5", "/x")
        file["log/soft"] = h5py.SoftLink("/log/t")
    check(tmp_path, tmp_path / "a.h5")
    (table,) = (one for one in read_sources(tmp_path / "a.h5", "a.h5") if one.part == "log")
    assert not {"elsewhere", "soft"} & set(table.columns)


def test_hdf5_with_named_fields(tmp_path):
    rows = np.zeros(len(TIME), dtype=[("t", "f8"), ("x", "f8"), ("y", "f8"), ("theta", "f8")])
    rows["t"], rows["x"], rows["y"], rows["theta"] = TIME, *POSE.T
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["pose"] = rows
    (tmp_path / "s.yaml").write_text(SETUP + "object_pose: {part: pose}\ntip_pose: null\n")
    (trial,) = import_dataset(tmp_path / "a.h5", tmp_path / "s.yaml").trials
    assert trial.object_pose.values == pytest.approx(POSE)


def test_zarr(tmp_path):
    zarr = pytest.importorskip("zarr", reason="zarr comes with the extra `import`")
    group = zarr.open_group(str(tmp_path / "a.zarr"), mode="w")
    log = group.create_group("log")
    for name, values in (("t", TIME), ("pose", POSE), ("tip", TIP)):
        log.create_array(name, data=values)
    check(tmp_path, tmp_path / "a.zarr")
    (tmp_path / "a.zarr" / "outside").symlink_to(tmp_path)
    with pytest.raises(DatasetError, match="leads out of the folder"):
        read_sources(tmp_path / "a.zarr", "a.zarr")


def test_zarr_with_pickles_is_refused(tmp_path):
    pytest.importorskip("zarr", reason="zarr comes with the extra `import`")
    folder = tmp_path / "a.zarr" / "x"
    folder.mkdir(parents=True)
    (tmp_path / "a.zarr" / ".zgroup").write_text('{"zarr_format": 2}')
    described = {
        "zarr_format": 2, "shape": [1], "chunks": [1], "dtype": "|O", "compressor": None, "order": "C",
        "fill_value": None, "filters": [{"id": "pickle", "protocol": 5}],
    }  # fmt: skip
    (folder / ".zarray").write_text(json.dumps(described).replace('"pickle"', '"p\\u0069ckle"'))
    (folder / "0").write_bytes(b"cos\nsystem\n(S'false'\ntR.")
    with pytest.raises(DatasetError, match="pickles"):
        read_sources(tmp_path / "a.zarr", "a.zarr")


def test_lerobot(tmp_path):
    pyarrow = pytest.importorskip("pyarrow", reason="pyarrow comes with the extra `import`")
    from pyarrow import parquet

    state = np.column_stack([POSE, TIP])
    twice = pyarrow.table(
        {
            "observation.state": [list(row) for row in np.vstack([state, state + 0.1])],
            "timestamp": np.concatenate([TIME, TIME]),
            "episode_index": np.repeat([0, 1], len(TIME)),
            "task": ["push"] * (2 * len(TIME)),
        }
    )
    parquet.write_table(twice, tmp_path / "file-000.parquet")
    (tmp_path / "s.yaml").write_text(
        SETUP + "object_pose: {position: [observation.state.0, observation.state.1],"
        " angle: observation.state.2}\ntip_pose: {position: [observation.state.3, observation.state.4]}\n"
    )
    first, second = import_dataset(tmp_path / "file-000.parquet", tmp_path / "s.yaml").trials
    assert first.object_pose.values == pytest.approx(POSE)
    assert second.tip_pose.values == pytest.approx(TIP + 0.1)


def test_files_that_explode_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(array_files, "MOST_NUMBERS", 10_000)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("x", shape=(10**9, 2), dtype="f8", chunks=(1000, 2), compression="gzip")
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    packed = zlib.compress(bytes(2**20))
    (tmp_path / "a.mat").write_bytes(
        head + (15).to_bytes(4, "little") + len(packed).to_bytes(4, "little") + packed
    )
    for name in ("a.h5", "a.mat"):
        with pytest.raises(DatasetError, match="at most 10000"):
            read_sources(tmp_path / name, name)


def test_pickles_are_never_loaded(tmp_path):
    for ending in ("pkl", "npy", "npz", "pt"):
        file = tmp_path / f"a.{ending}"
        file.write_bytes(b"cos\nsystem\n(S'false'\ntR.")
        with pytest.raises(DatasetError, match="never loaded"):
            find_files([file])


def test_a_link_out_of_a_folder_is_refused(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "secret.csv").write_text("t,x\n0,1\n")
    (tmp_path / "in" / "a.csv").symlink_to(tmp_path / "secret.csv")
    with pytest.raises(DatasetError, match="leads out of the folder"):
        find_files([tmp_path / "in"])
