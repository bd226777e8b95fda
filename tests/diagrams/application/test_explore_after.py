"""`slipmap explore --after`: another run begins with the pushes of one before, and with other effects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from slipmap.diagrams.application.command_line import run
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements import read_dataset

pytestmark = pytest.mark.usefixtures("renderer")


@pytest.fixture(scope="module")
def before(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the box on a tilted table, of one push to learn from and one to judge."""
    folder = tmp_path_factory.mktemp("before")
    (folder / "cell.yaml").write_text(
        "simulation: {time_step: 0.005}\ncamera: {rate: 5.0}\nhidden: {table_tilt: {down_x: 0.15}}\n",
        encoding="utf-8",
    )
    words = ["explore", "--scenario", folder / "cell.yaml", "--object", "box", "--pushes", 1, "--checks", 1]
    assert run([str(word) for word in [*words, "--out", folder / "run"]]) == 0
    return folder / "run"


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_its_pushes_are_all_learned_from_with_the_effect_and_the_object_lies_where_they_left_it(
    before, slipmap, tmp_path
):
    kept, out = contents(before), tmp_path / "further"
    words = ["--after", before, "--effect", "table_tilt", "--pushes", 0, "--checks", 1, "--seed", 5]
    said = slipmap("explore", *words, "--out", out)
    assert said.code == 0, said.err
    old, new = read_dataset(before / "pushes").trials, read_dataset(out / "pushes").trials
    assert [trial.role for trial in old] == ["fit", "heldout"]
    assert [trial.role for trial in new] == ["fit", "fit", "heldout"]
    for trial, same in zip(new, old, strict=False):
        assert np.array_equal(trial.object_pose.values, same.object_pose.values)
    assert new[-1].object_pose.values[0] == pytest.approx(old[-1].object_pose.values[-1], abs=2e-3)
    belief = Belief.load(out / "belief.npz")
    assert belief.settings["fit_trials"] == [trial.name for trial in old]
    assert [effect.name for effect in belief.effects] == ["table_tilt"]
    assert contents(before) == kept


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--object", "book"], "leave out --object"),
        (["--pushes", 0, "--checks", 0], "slipmap fit"),
        (["--hardware"], "in simulation; leave out --hardware"),
        (["--resume", "BEFORE"], "leave out --after"),
        (["--out", "BEFORE"], "name another folder with --out"),
    ],
)
def test_what_makes_no_sense_beside_it_is_refused(before, slipmap, tmp_path, words, named):
    kept = contents(before)
    out = [] if {"--resume", "--out"} & {*map(str, words)} else ["--out", tmp_path / "out"]
    words = [before if word == "BEFORE" else word for word in words]
    said = slipmap("explore", *out, "--after", before, *words)
    assert said.code == 2 and named in said.err
    assert contents(before) == kept and not list(tmp_path.iterdir())


def test_there_must_be_pushes_to_begin_with(slipmap, tmp_path):
    for words, named in ((["--after", tmp_path], "holds no run"), (["--pushes", 0], "nothing to learn from")):
        said = slipmap("explore", "--out", tmp_path / "out", *words)
        assert said.code == 2 and named in said.err
    assert not list(tmp_path.iterdir())
