"""Whatever stands in a file or a setup, importing gives a dataset or a DatasetError."""

import random
from contextlib import suppress

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings, strategies as st
from lab_session import _write_motive
from scipy.io import savemat
from tables import POSE, SETUP, TIME, TIP, written

from slipmap.models.measurements import DatasetError
from slipmap.models.measurements.importing import guess_setup, import_dataset

SETTINGS = settings(max_examples=30, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))
SAID = {
    **yaml.safe_load(SETUP),
    "object_pose": {"position": ["x", "y"], "angle": "theta", "frame": [0, 0, 0], "clock": 0.0},
    "tip_pose": {"position": ["a", "b"], "unit": {"position": "m"}, "offset": [0, 0]},
}
STRANGE = st.sampled_from(
    [None, True, 0, -1, 10**400, float("nan"), float("inf"), "", "contact", "../x", "*", "\0", [], [1], {},
     [[]], {"a": 1}, ["x", "x"], "t", 1e308]
)  # fmt: skip


def folder_of(tmp_path):
    written(tmp_path / "p.csv", ["t", "x", "y", "theta", "a", "b"], [TIME, POSE, TIP])
    return tmp_path


def tried(folder, file):
    try:
        import_dataset(folder / file, folder / "s.yaml", tell=lambda text: None)
    except DatasetError as error:
        assert "\n" not in str(error)
    with suppress(DatasetError):
        guess_setup(folder / file)


@SETTINGS
@given(data=st.data())
def test_strange_setups(tmp_path_factory, data):
    folder = folder_of(tmp_path_factory.mktemp("s"))
    said = yaml.safe_load(yaml.safe_dump(SAID))
    key = data.draw(
        st.sampled_from(["object_pose", "tip_pose", "object", "finger", "ft_wrench", "unit", "time"])
    )
    value = data.draw(STRANGE)
    inner = said.get(key)
    if isinstance(inner, dict) and data.draw(st.booleans()):
        places = [*inner, "up", "part", "source", "rate", "quaternion", "push", "sign", "time"]
        inner[data.draw(st.sampled_from(places))] = value
    else:
        said[key] = value
    (folder / "s.yaml").write_text(yaml.safe_dump(said))
    tried(folder, "p.csv")


@pytest.mark.parametrize("kind", ["csv", "motive", "mat", "h5", "bag", "mcap", "parquet"])
def test_damaged_files(tmp_path, kind):
    rng = random.Random(kind)
    (tmp_path / "s.yaml").write_text(SETUP + "object_pose: {position: [x, y], angle: theta}\n")
    file = tmp_path / f"a.{'csv' if kind == 'motive' else kind}"
    if kind == "csv":
        written(file, ["t", "x", "y", "theta", "a", "b"], [TIME, POSE, TIP])
    elif kind == "motive":
        _write_motive(file, TIME, lambda t, v: v, POSE, np.random.default_rng(0))
    elif kind == "mat":
        savemat(file, {"t": TIME, "x": POSE[:, 0], "y": POSE[:, 1], "theta": POSE[:, 2]}, do_compression=True)
    elif kind == "h5":
        h5py = pytest.importorskip("h5py")
        with h5py.File(file, "w") as opened:
            for name, column in zip(("x", "y", "theta"), POSE.T, strict=True):
                opened[name] = column
    elif kind == "parquet":
        pyarrow = pytest.importorskip("pyarrow", reason="pyarrow comes with the extra `import`")
        from pyarrow import parquet

        parquet.write_table(pyarrow.table({"timestamp": TIME, "x": POSE[:, 0], "y": POSE[:, 1]}), file)
    else:
        from test_bags import bag_of, test_mcap_in_json

        if kind == "bag":
            bag_of(tmp_path, first=True)
        else:
            test_mcap_in_json(tmp_path)
            (tmp_path / "s.yaml").write_text(SETUP)
    whole = file.read_bytes()
    for _ in range(8):
        content = bytearray(whole)
        for _ in range(rng.randrange(1, 6)):
            content[rng.randrange(len(content))] = rng.randrange(256)
        if rng.random() < 0.3:
            content = content[: rng.randrange(len(content))]
        file.write_bytes(bytes(content))
        tried(tmp_path, file.name)
