"""A command does not overwrite what it reads."""

import os

import pytest


def test_a_dataset_is_not_written_over(slipmap, tilted_folder, tmp_path):
    before = {path: path.read_bytes() for path in tilted_folder.rglob("*") if path.is_file()}
    a_trial = next(path for path in before if path.suffix == ".json")
    (tmp_path / "link.json").symlink_to(a_trial)
    for said in (
        slipmap("identify", tilted_folder, "-o", tilted_folder / "dataset.yaml"),
        slipmap("identify", tilted_folder, "-o", tmp_path / "b.npz", "--json", a_trial),
        slipmap("identify", tilted_folder, "-o", tmp_path / "b.npz", "--json", tmp_path / "link.json"),
        slipmap(
            "compare", tilted_folder, "-o", tmp_path / "r.html", "--json", tilted_folder / "dataset.yaml"
        ),
    ):
        assert said.code == 2, said.err
    assert "would overwrite what the command reads" in " ".join(said.err.split())
    assert {path: path.read_bytes() for path in tilted_folder.rglob("*") if path.is_file()} == before
    assert not (tmp_path / "b.npz").exists()


def test_a_belief_and_a_result_are_not_written_over_each_other(slipmap, tilted_folder, tmp_path):
    belief = tmp_path / "belief.npz"
    belief.write_bytes(b"learned")
    said = slipmap("predict", tilted_folder, "--belief", belief, "-o", tmp_path / "p.png", "--json", belief)
    assert said.code == 2 and "--json" in said.err and belief.read_bytes() == b"learned"
    said = slipmap("identify", tilted_folder, "-o", tmp_path / "new.npz", "--json", tmp_path / "new.npz")
    assert said.code == 2 and "give each its own file" in " ".join(said.err.split())
    assert not (tmp_path / "new.npz").exists()
    for folder, more in ((tmp_path, ()), (tmp_path / "drawn", ("--pictures", tmp_path / "drawn"))):
        folder.mkdir(exist_ok=True)
        json = folder / "new.maps.png"
        said = slipmap("identify", tilted_folder, "-o", tmp_path / "new.npz", *more, "--json", json)
        assert said.code == 2 and "a picture of --output" in " ".join(said.err.split()), said.err
        assert not json.exists()


def test_a_belief_has_its_ending(slipmap, tilted_folder, tmp_path):
    said = slipmap("identify", tilted_folder, "-o", tmp_path / "belief.txt")
    assert said.code == 2 and ".npz" in said.err


def test_a_pipe_is_no_file(slipmap, tilted_folder, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    said = slipmap("identify", tilted_folder, "-o", tmp_path / "b.npz", "--json", tmp_path / "pipe")
    assert said.code == 2 and "a device or a pipe" in " ".join(said.err.split())


@pytest.mark.parametrize("there", [True, False])
def test_a_link_stays_one(slipmap, tmp_path, there):
    target, link = tmp_path / "target.json", tmp_path / "link.json"
    if there:
        target.write_text("old")
    link.symlink_to(target)
    assert slipmap("effects", "--json", link).code == 0
    assert link.is_symlink() and target.read_text().startswith("{")
