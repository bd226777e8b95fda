"""`slipmap example`: what ships is what slipmap's simulation makes, and what the README says of it is so."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from make_tilted_block import DIGITS, FOLDER, TILT, simulated

from slipmap import read_dataset, tilted_block
from slipmap.diagrams.application.command_line import run

ROOT = Path(__file__).resolve().parents[3]
LARGEST = 100_000  # bytes of all files


@pytest.fixture
def written(tmp_path, monkeypatch):
    """The example, in the folder that one is in."""
    monkeypatch.chdir(tmp_path)
    assert run(["example"]) == 0
    return tmp_path / "tilted"


def test_what_ships_is_what_the_simulation_makes():
    made, kept = simulated(), tilted_block()
    assert [(t.name, t.role) for t in made.trials] == [(t.name, t.role) for t in kept.trials]
    for one, other in zip(made.trials, kept.trials, strict=True):
        for name, channel in one.channels.items():
            # Another processor may round the last digit otherwise.
            last = 1.5 * 10.0 ** -np.array(DIGITS[name])
            assert np.all(np.abs(channel.values - other.channels[name].values) <= last), (one.name, name)
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < LARGEST


def test_the_command_writes_it_and_replaces_nothing(written, capsys):
    read, shipped = read_dataset(written), tilted_block()
    assert read.warnings == () and len(read.trials) == len(shipped.trials) == 12
    assert np.array_equal(read.trials[3].object_pose.values, shipped.trials[3].object_pose.values)
    assert run(["example"]) == 2
    assert "holds pushes already" in capsys.readouterr().err


def test_the_readme_tells_what_comes_out(written, capsys):
    """identify, compare, diagnose, fit and predict, as a reader would type them."""
    told = (ROOT / "README.md").read_text(encoding="utf-8")
    lines = re.findall(r"^    slipmap (\w+ tilted.*?)(?: +# (.*))?$", told, flags=re.M)
    assert [line.split()[0] for line, _ in lines] == ["identify", "compare", "diagnose", "fit", "predict"]
    said = {}
    for line, _ in lines:
        words = line.split()
        extra = ["--json", f"{words[0]}.json"] if words[0] in ("identify", "fit") else []
        assert run([*words, *extra]) == 0
        said[words[0]] = " ".join(capsys.readouterr().out.split())
    remarks = {line.split()[0]: remark for line, remark in lines}
    for command in ("identify", "fit"):
        (quoted,) = re.findall(r"end ([\d.]+) mm off", remarks[command])
        held = json.loads(Path(f"{command}.json").read_text())["heldout_error_mean"]
        assert 1e3 * held == pytest.approx(float(quoted), rel=0.1), command
    assert "SURPRISING" in said["identify"] and "SURPRISING" not in said["fit"]
    assert "Every other effect that was tried is ruled out" in said["diagnose"]
    assert remarks["diagnose"] in said["diagnose"]
    quoted = re.search(r"as ([\d.]+)° \(([\d.]+) to ([\d.]+)\); ([\d.]+)° were hidden", told)
    found = re.search(r"tilt ([\d.]+)° \(([\d.]+) to ([\d.]+)\)", said["fit"])
    assert quoted is not None and found is not None
    assert np.allclose([float(n) for n in found.groups()], [float(n) for n in quoted.groups()[:3]], atol=0.1)
    assert np.degrees(np.arctan(np.hypot(*TILT))) == pytest.approx(float(quoted[4]), abs=0.01)
    assert float(quoted[2]) < float(quoted[4]) < float(quoted[3])
