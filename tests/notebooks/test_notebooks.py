"""The notebooks run from top to bottom, and their files keep small but complete outputs."""

import base64
import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
RUNNER = FOLDER / "run.py"
LARGEST = 300_000  # bytes
LONGEST_CELL = 15  # lines
MOST_IMPORTS = 8  # lines

MACHINE_PATH = re.compile(r"(?<![\w.])/(home|root|tmp|work|Users|usr|opt|var)/")

each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def run(paths: list[Path], folder: Path, *options: str) -> "subprocess.CompletedProcess[str]":
    """Run notebooks in a folder laid out like the project."""
    here = folder / "notebooks"
    here.mkdir(exist_ok=True)
    if not (folder / "docs").exists():
        (folder / "docs").symlink_to(ROOT / "docs")
    command = [sys.executable, str(RUNNER), *map(str, paths), *options]
    # A twin cannot keep up with real time while other tests run.
    environment = {**os.environ, "SLIPMAP_CELL": "lockstep"}
    return subprocess.run(command, cwd=here, env=environment, capture_output=True, text=True, timeout=600)


def texts(notebook: dict) -> list[str]:
    """All outputs of a notebook except pictures."""
    found = []
    for cell in notebook["cells"]:
        for output in cell.get("outputs", []):
            found += ["".join(output["text"])] if "text" in output else []
            kinds = output.get("data", {})
            found += ["".join(kinds[kind]) for kind in kinds if kind != "image/png"]
    return found


def small_notebook(path: Path, *sources: str) -> Path:
    """A notebook with a few code cells."""
    cells = [
        {"cell_type": "code", "metadata": {"collapsed": True}, "source": text, "outputs": []}
        for text in sources
    ]
    path.write_text(
        json.dumps({"cells": cells, "metadata": {"noise": 1}, "nbformat": 4, "nbformat_minor": 4})
    )
    return path


def test_there_are_notebooks():
    assert len(NOTEBOOKS) >= 7


@each_notebook
def test_a_notebook_runs_from_top_to_bottom(path, tmp_path):
    """Each in a process of its own, as in Jupyter."""
    ended = run([path], tmp_path, "--check")
    assert ended.returncode == 0, ended.stderr


@each_notebook
def test_what_a_notebook_shows_is_kept(path):
    notebook = json.loads(path.read_text())
    pictures = [
        output["data"]["image/png"]
        for cell in notebook["cells"]
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]
    assert len(pictures) >= 3
    for picture in pictures:
        assert base64.b64decode(picture).startswith(b"\x89PNG")
    kinds = {output["output_type"] for cell in notebook["cells"] for output in cell.get("outputs", [])}
    assert "error" not in kinds
    for text in texts(notebook):
        assert "Traceback" not in text
        assert not MACHINE_PATH.search(text), text
        assert "object at 0x" not in text
    assert path.stat().st_size < LARGEST


@each_notebook
def test_notebook_is_written_as_the_runner_writes_it(path):
    spec = importlib.util.spec_from_file_location("notebook_runner", RUNNER)
    runner = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(runner)
    assert path.read_text() == runner.as_text(json.loads(path.read_text())), "run `make notebooks`"


@each_notebook
def test_a_notebook_is_easy_to_read(path):
    """It states how long it runs, has short cells and few imports, and asserts what it says."""
    cells = json.loads(path.read_text())["cells"]
    text, code = (
        ["".join(cell["source"]) for cell in cells if cell["cell_type"] == kind]
        for kind in ("markdown", "code")
    )
    assert re.search(r"^\*Runs in ", text[0], flags=re.M)
    assert max(len(cell.splitlines()) for cell in code) <= LONGEST_CELL
    assert len(re.findall(r"^(?:import|from) ", "\n".join(code), flags=re.M)) <= MOST_IMPORTS
    assert len(re.findall(r"^ *(?:testing\.assert_|assert )", "\n".join(code), flags=re.M)) >= 3


@each_notebook
def test_links_of_a_notebook_lead_somewhere(path):
    for cell in json.loads(path.read_text())["cells"]:
        if cell["cell_type"] == "markdown":
            for target in re.findall(r"\]\(([^)#:]+)\)", "".join(cell["source"])):
                assert (FOLDER / target).exists(), target


def test_runner_keeps_text_expressions_and_figures_and_leaves_noise_out(tmp_path):
    figure = "%matplotlib inline\nimport matplotlib.pyplot as plt\nplt.plot([1, 2]);"
    path = small_notebook(tmp_path / "some.ipynb", "print('said')\n40 + 2", "1 + 1;", figure)
    assert run([path], tmp_path).returncode == 0
    notebook = json.loads(path.read_text())
    said, silent, drawn = (cell["outputs"] for cell in notebook["cells"])
    assert said[0]["text"] == ["said\n"]
    assert said[1]["data"] == {"text/plain": ["42"]}
    assert silent == []
    assert [list(output["data"]) for output in drawn] == [["image/png"]]
    assert "noise" not in path.read_text() and "collapsed" not in path.read_text()
    before = path.read_text()
    assert run([path], tmp_path).returncode == 0
    assert path.read_text() == before


def test_runner_keeps_no_frame_of_a_file_that_is_not_kept(tmp_path):
    frame = "from IPython.display import IFrame, display\ndisplay(IFrame('results/run.html', 9, 9))\n1"
    path = small_notebook(tmp_path / "some.ipynb", frame)
    assert run([path], tmp_path).returncode == 0
    (cell,) = json.loads(path.read_text())["cells"]
    assert [output["data"] for output in cell["outputs"]] == [{"text/plain": ["1"]}]


def test_a_notebook_knows_nothing_of_the_one_before(tmp_path):
    one, other = (
        small_notebook(tmp_path / "one.ipynb", "x = 1"),
        small_notebook(tmp_path / "other.ipynb", "x"),
    )
    ended = run([one, other], tmp_path)
    assert ended.returncode == 1
    assert "other.ipynb, code cell 1" in ended.stderr and "'x' is not defined" in ended.stderr


def test_runner_names_the_cell_that_fails_and_leaves_the_file_alone(tmp_path):
    path = small_notebook(tmp_path / "some.ipynb", "x = 1", "x / 0")
    before = path.read_text()
    ended = run([path], tmp_path)
    assert ended.returncode == 1
    assert "some.ipynb, code cell 2" in ended.stderr and "ZeroDivisionError" in ended.stderr
    assert path.read_text() == before
