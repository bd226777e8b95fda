"""What the commands say and write stays as it was recorded; `recording.py` says how to record anew."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.recorded.commands import CASES
from tests.recorded.recording import FOLDER, differences, prepare, recorded, said


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The working folder of all commands."""
    with pytest.MonkeyPatch.context() as patch:
        place = tmp_path_factory.mktemp("commands")
        prepare(place)
        patch.chdir(place)
        patch.setenv("COLUMNS", "80")
        yield place


@pytest.mark.parametrize("name", CASES)
def test_a_command_says_what_it_said(name: str, folder: Path) -> None:
    wanted, got = recorded(name), said(CASES[name])
    assert not list(differences(wanted, got)), f"slipmap {CASES[name]}"


def test_nothing_is_recorded_that_is_not_compared() -> None:
    assert {path.stem for path in FOLDER.glob("*.json")} == set(CASES)


@pytest.mark.parametrize(
    ("wanted", "got", "same"),
    [
        ("it ends 3.2 mm off", "it ends 3.3 mm off", True),
        ("it ends 3.2 mm off", "it ends 3.4 mm off", False),
        ("3 pushes", "4 pushes", False),
        (0.123456, 0.123457, True),
        (0.1234, 0.1236, False),
        ({"a": 1}, {"b": 1}, False),
    ],
)
def test_only_the_last_digit_may_differ(wanted: object, got: object, same: bool) -> None:
    assert (not list(differences(wanted, got))) == same
