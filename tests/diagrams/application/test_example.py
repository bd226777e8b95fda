"""`slipmap example`: what ships is what slipmap's simulation makes, and what the README says of it is so."""

from __future__ import annotations

import re
from contextlib import chdir, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from make_tilted_block import DIGITS, FOLDER, TILT, simulated

from slipmap import read_dataset, tilted_block
from slipmap.diagrams.application.command_line import run

ROOT = Path(__file__).resolve().parents[3]
README = (ROOT / "README.md").read_text(encoding="utf-8")
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


@dataclass(frozen=True)
class Typed:
    """The README's commands, as a reader would type them."""

    remarks: dict[str, str]  # what the README says beside each
    said: dict[str, str]  # what each printed, with single spaces


@pytest.fixture(scope="module")
def typed(tmp_path_factory):
    """identify, compare, diagnose, fit and predict, run in a folder of their own."""
    lines = re.findall(r"^    slipmap (\w+ tilted.*?)(?: +# (.*))?$", README, flags=re.M)
    assert [line.split()[0] for line, _ in lines] == ["identify", "compare", "diagnose", "fit", "predict"]
    remarks, said = {}, {}
    with chdir(tmp_path_factory.mktemp("example")):
        assert run(["example"]) == 0
        for line, remark in lines:
            command, *_ = words = line.split()
            with redirect_stdout(StringIO()) as out:
                assert run(words) == 0
            remarks[command], said[command] = remark, " ".join(out.getvalue().split())
    return Typed(remarks, said)


def test_the_readme_tells_what_comes_out(typed):
    assert "SURPRISING" in typed.said["identify"] and "SURPRISING" not in typed.said["fit"]
    assert "Every other effect that was tried is ruled out" in typed.said["diagnose"]
    assert typed.remarks["diagnose"] in typed.said["diagnose"]
    low, high = re.search(r"tilt \S+° \((\S+) to (\S+)\)", typed.said["fit"]).groups()
    hidden = np.degrees(np.arctan(np.hypot(*TILT)))
    assert float(low) < hidden < float(high) and f"{hidden:.2f}° were hidden" in README


def agree(written: object, printed: object) -> bool:
    """Whether two texts, or lists of them, are equal but for one unit in the last digit of each number."""
    number = re.compile(r"-?\d+(?:\.(\d+))?")
    texts = str(written), str(printed)
    if number.sub("0", texts[0]) != number.sub("0", texts[1]):
        return False
    pairs = zip(*(number.finditer(text) for text in texts), strict=True)
    return all(
        abs(float(one[0]) - float(other[0])) < 1.5 * 0.1 ** len(other[1] or "") for one, other in pairs
    )


def test_numbers_of_readme_and_laboratory_are_those_that_the_commands_print(typed):
    """Where they have changed, the failure lists both; copy those that are printed into the two pages.

    Another processor may round the last digit differently.
    """
    page = (ROOT / "docs/lab/tilted-block.md").read_text(encoding="utf-8")
    identified, fitted = typed.said["identify"], typed.said["fit"]
    rows = dict(re.findall(r"^\| `slipmap (\w+) [^|]*\| (.*) \|$", page, flags=re.M))
    written = {
        "README, identify": re.findall(r"end (\S+) mm off", typed.remarks["identify"]),
        "README, fit": re.findall(r"end (\S+) mm off", typed.remarks["fit"]),
        "README, tilt": re.findall(r"estimated as (.*?);", README),
        "page, identify": re.findall(r"(\S+) \| two of four", rows["identify"]),
        "page, fit": re.findall(r"(\S+) \| tilt (.*)", rows["fit"]),
        "page, others": re.findall(r"(\S+) mm, that of one that does not move (\S+) mm", page),
    }
    ((without, *others),) = re.findall(r"4 held out mean (\S+) (\S+) (\S+)", identified)
    ((whole, tilt),) = re.findall(r"table_tilt: tilt ((.*?), downhill .*?\))\.", fitted)
    error = re.findall(r"Held-out pushes end (\S+) mm", fitted)
    printed = {
        "README, identify": [without],
        "README, fit": error,
        "README, tilt": [tilt],
        "page, identify": [without],
        "page, fit": [(*error, whole)],
        "page, others": [tuple(others)],
    }
    apart = [where for where in printed if not agree(written[where], printed[where])]
    assert not apart, f"written {written}, printed {printed}"
    assert identified.count("SURPRISING: at most") == 2
