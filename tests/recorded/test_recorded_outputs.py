"""What the commands say and write stays as it was recorded; `recording.py` says how to record anew."""

from __future__ import annotations

import platform

import pytest
from threadpoolctl import threadpool_info

from tests.recorded.cases import CASES
from tests.recorded.comparing import differences, same_line
from tests.recorded.recording import OUTPUTS, Recorder, recorded

SHOWN = 20
"""Differences of one command that are shown."""

KERNELS = {one.get("architecture") for one in threadpool_info() if one["user_api"] == "blas"}
"""Of BLAS, by processor: `tests.any_processor` chooses those for Haswell if numpy was not loaded before."""


@pytest.fixture(scope="module")
def recorder(tmp_path_factory: pytest.TempPathFactory) -> Recorder:
    """The folder in which all commands run."""
    return Recorder(tmp_path_factory.mktemp("recorded"))


@pytest.mark.skipif(
    {"Haswell"} != KERNELS,
    reason=f"numbers were recorded with BLAS kernels for Haswell; {platform.machine()} has {KERNELS}",
)
@pytest.mark.parametrize("name", CASES)
def test_a_command_does_what_it_did(name: str, recorder: Recorder, request: pytest.FixtureRequest) -> None:
    if CASES[name].renders:
        request.getfixturevalue("renderer")  # skips where there is none
    found = list(differences(recorded(name), recorder.of(name)))
    if found:
        more = f"\n  and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
        lines = "\n  ".join(found[:SHOWN])
        pytest.fail(f"slipmap {CASES[name].line}\n  {lines}{more}", pytrace=False)


def test_every_recording_belongs_to_a_case() -> None:
    assert sorted(path.stem for path in OUTPUTS.glob("*.json")) == sorted(CASES)


def test_recordings_are_small() -> None:
    sizes = [path.stat().st_size for path in OUTPUTS.glob("*.json")]
    assert max(sizes) < 200 * 1024 and sum(sizes) < 1024 * 1024


@pytest.mark.parametrize(
    ("wanted", "got", "same"),
    [
        ("it ends 3.2 mm off", "it ends 3.3 mm off", True),
        ("it ends 3.2 mm off", "it ends 3.4 mm off", False),
        ("it ends 9 mm off", "it ends 10 mm off", True),
        ("a   9.9   b", "a  10.0   b", True),
        ("a   9.8   b", "a  9.8   b", False),
        ("3 pushes", "4 pushes", False),
        ("3 grams", "4 grams", False),
        ("the belief", "the beliefs", False),
        ("-0.0", "0.0", True),
    ],
)
def test_lines_may_differ_in_the_last_digit(wanted: str, got: str, same: bool) -> None:
    assert same_line(wanted, got) is same


@pytest.mark.parametrize(
    ("wanted", "got", "said"),
    [
        (0.5, 0.5000001, []),
        (0.5, 0.50005, ["x: wanted 0.5, got 0.50005"]),
        (3, 4, ["x: wanted 3, got 4"]),
        (0, False, ["x: wanted 0, got False"]),
        ({"a": 1}, {"b": 1}, ["x.a: is missing, wanted 1", "x.b: is new, got 1"]),
        (["one", "two"], ["one"], ["x: wanted 2 lines, got 1", "x, line 2: wanted 'two', got None"]),
    ],
)
def test_a_difference_is_told_with_its_place(wanted: object, got: object, said: list[str]) -> None:
    assert list(differences(wanted, got, "x")) == said
