"""From files to a dataset, its check, and models for simulators, by command; and the page that says how."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from page_examples import NOT_RUN
from schemas import FOLDER, assert_as_described

from slipmap.models import measurements
from slipmap.models.measurements import DatasetError, read_dataset, write_dataset
from slipmap.models.measurements.importing.import_setup import parse_import_setup
from tests.models.measurements.importing.lab_session import lab_session

PAGE = FOLDER.parents[0] / "import.md"
SETUPS = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S)
TIME = 0.01 * np.arange(150)
WAY = 0.06 * np.clip(TIME - 0.3, 0.0, 0.9)


@pytest.fixture
def lab(tmp_path):
    """A bar that is pushed along x, recorded in mm, and its setup."""
    rows = np.column_stack(
        [TIME, 1e3 * np.maximum(WAY - 0.01, 0.0), 0 * TIME, 0 * TIME, 1e3 * WAY - 45, 0 * TIME]
    )
    text = "t,x,y,theta,a,b\n" + "\n".join(",".join(f"{cell:.4f}" for cell in row) for row in rows)
    (tmp_path / "push.csv").write_text(text)
    (tmp_path / "setup.yaml").write_text(
        "object: {outline: [[-0.03, -0.02], [0.03, -0.02], [0.03, 0.02], [-0.03, 0.02]]}\n"
        "finger: {radius: 0.005}\nunit: mm\nobject_pose: {position: [x, y], angle: theta}\n"
        "tip_pose: {position: [a, b]}\n"
    )
    return tmp_path


def test_import_and_check(slipmap, lab, monkeypatch):
    monkeypatch.chdir(lab)
    said = slipmap("import", "push.csv", "-o", "pushes")
    assert said.code == 0, said.err
    assert "pushes: 1 push, 0 of them held out" in said.out
    assert (lab / "pushes.png").stat().st_size > 10_000
    assert "\npicture: pushes.png\n" in said.err
    dataset = read_dataset(lab / "pushes")
    assert dataset.trials[0].object_pose.values[-1, 0] == pytest.approx(WAY[-1] - 0.01, abs=1e-6)
    assert "imported from push.csv" in dataset.provenance[0]
    assert_as_described("push-dataset", yaml.safe_load((lab / "pushes/dataset.yaml").read_text()))
    said = slipmap("check", lab / "pushes", "-o", lab / "c.html", "--json", lab / "c.json")
    assert said.code == 0, said.err
    document = json.loads((lab / "c.json").read_text())
    assert_as_described("check", document)
    assert not document["wrong"] and "recording is sound" in said.out
    page = (lab / "c.html").read_text()
    assert "<svg" in page or "data:image/svg" in page
    assert "imported from push.csv" in page


def test_a_picture_that_is_not_an_imports_own_is_kept(slipmap, lab):
    (lab / "pushes.png").write_bytes(b"a photograph")
    words = ("import", lab / "push.csv", "--setup", lab / "setup.yaml", "-o", lab / "pushes")
    said = slipmap(*words)
    assert said.code == 2 and "pushes.png: exists already" in said.err and "reading" not in said.err
    assert (lab / "pushes.png").read_bytes() == b"a photograph" and not (lab / "pushes").exists()
    (lab / "pushes.png").unlink()
    assert [slipmap(*words).code for _ in range(2)] == [0, 0]  # the second replaces what the first wrote


def test_an_import_that_is_stopped_leaves_neither_dataset_nor_picture(slipmap, lab, monkeypatch):
    def stopped(dataset, folder, **how):
        write_dataset(dataset, folder, **how)
        raise KeyboardInterrupt

    monkeypatch.setattr(measurements, "write_dataset", stopped)
    said = slipmap("import", lab / "push.csv", "--setup", lab / "setup.yaml", "-o", lab / "pushes")
    assert said.code == 130
    assert {path.name for path in lab.iterdir()} == {"push.csv", "setup.yaml"}


def test_raw_files_to_a_diagnosis_in_three_commands(slipmap, tmp_path):
    session = lab_session(tmp_path, seed=0)
    (tmp_path / "setup.yaml").write_text(session.setup)
    assert len(session.setup.splitlines()) <= 25
    pushes, said = tmp_path / "pushes", tmp_path / "said.json"
    commands = (
        ("import", *session.sources, "--setup", tmp_path / "setup.yaml", "-o", pushes),
        ("identify", pushes, "-o", tmp_path / "belief.npz", "--json", tmp_path / "belief.json"),
        ("diagnose", pushes, "--draws", 99, "-o", tmp_path / "diagnosis.html", "--json", said),
    )
    for command in commands:
        done = slipmap(*command)
        assert done.code == 0 and "warning" not in done.err, done.err
    shown = json.loads((tmp_path / "belief.json").read_text())["identifiable"]
    found = {one["name"]: one["value"] for one in shown}
    load = (session.maps.mass * session.maps.mu)[0]
    middle = load @ session.grid.centers / load.sum()
    assert found["total friction"] == pytest.approx(9.81 * load.sum(), rel=0.03)
    assert np.hypot(*(middle - [found[f"centre of friction, {axis}"] for axis in "xy"])) < 1e-3
    assert json.loads(said.read_text())["verdict"] == "adequate"
    assert (tmp_path / "diagnosis.html").stat().st_size > 10_000


def test_a_finding_that_matters_ends_in_1(slipmap, lab):
    setup = (lab / "setup.yaml").read_text().replace("[a, b]", "[a, b], offset: [0.02, 0]")
    (lab / "setup.yaml").write_text(setup)
    said = slipmap("import", lab / "push.csv", "--setup", lab / "setup.yaml", "-o", lab / "pushes")
    assert said.code == 0 and "warning" in said.err
    said = slipmap("check", lab / "pushes")
    assert said.code == 1 and "WRONG" in said.out


def test_a_guess_is_written_once(slipmap, lab):
    where = lab / "guess.yaml"
    assert slipmap("import", lab / "push.csv", "--setup", where, "--guess").code == 0
    written = where.read_text()
    assert yaml.safe_load(written)["object_pose"]["unit"] == {"position": "mm"}
    said = slipmap("import", lab / "push.csv", "--setup", where, "--guess")
    assert said.code == 2 and "exists already" in " ".join(said.err.split())
    assert where.read_text() == written
    said = slipmap("import", lab / "push.csv", "--setup", where, "-o", lab / "pushes")
    assert said.code == 2 and "outline" in said.err and not (lab / "pushes").exists()


def test_only_an_imported_dataset_is_replaced(slipmap, lab):
    again = ("import", lab / "push.csv", "--setup", lab / "setup.yaml", "-o", lab / "pushes")
    assert slipmap(*again).code == 0 and slipmap(*again).code == 0
    imported = read_dataset(lab / "pushes")
    write_dataset(replace(imported, provenance=()), lab / "pushes", overwrite=True)
    before = (lab / "pushes" / "dataset.yaml").read_bytes()
    said = slipmap(*again)
    assert said.code == 2 and "not made by an import" in " ".join(said.err.split())
    assert (lab / "pushes" / "dataset.yaml").read_bytes() == before


def test_what_is_missing_is_said(slipmap, lab):
    said = slipmap("import", lab / "push.csv", "--setup", lab / "setup.yaml")
    assert said.code == 2 and "-o DATASET" in said.err
    said = slipmap("import", lab / "nothing.csv", "--setup", lab / "setup.yaml", "-o", lab / "pushes")
    assert said.code == 2 and "no such file" in said.err
    assert not (lab / "pushes").exists()
    said = slipmap("import", lab / "push.csv", "--setup", lab / "none.yaml", "-o", lab / "pushes")
    assert said.code == 2 and "--guess" in said.err
    (lab / "thesis").mkdir()
    (lab / "thesis" / "chapter.tex").write_text("")
    said = slipmap("import", lab / "push.csv", "--setup", lab / "setup.yaml", "-o", lab / "thesis")
    assert said.code == 2 and "contains other files" in " ".join(said.err.split())


def test_export(slipmap, demo_folder, tmp_path):
    belief = demo_folder / "demo" / "belief.npz"
    said = slipmap("export", belief, "--to", "mjcf", "-o", tmp_path / "models", "--hypotheses")
    assert said.code == 0, said.err
    assert "not in the models" in said.err and "height" in said.err
    assert "elliptic" in said.err and "Gazebo" not in said.err
    files = sorted(path.name for path in (tmp_path / "models").iterdir())
    assert files[0] == "hammer_00.xml" and len(files) == 20
    assert "probability" in (tmp_path / "models" / files[0]).read_text()


@pytest.mark.parametrize("setup", SETUPS)
def test_each_setup_of_the_page_is_one(setup):
    assert len(setup.splitlines()) <= 20
    parsed = parse_import_setup(yaml.safe_load(setup), "setup.yaml", "page")
    assert parsed.setup.finger_radius == 0.006


def test_the_page_names_every_key():
    page = PAGE.read_text(encoding="utf-8")
    with pytest.raises(DatasetError) as told:
        parse_import_setup({**yaml.safe_load(SETUPS[0]), "object_pose": {"?": 1}}, "s", "n")
    unfilled = {"position": ["a", "b"], "angle": None}
    with pytest.raises(DatasetError, match=r"object_pose\.angle: fill in the column"):
        parse_import_setup({**yaml.safe_load(SETUPS[0]), "object_pose": unfilled}, "s", "n")
    known = re.search(r"known: (.*?)\)", str(told.value))[1].split(", ")
    assert len(known) > 10 and all(f"`{key}`" in page for key in known), known
    assert NOT_RUN not in page and len(SETUPS) > 8
