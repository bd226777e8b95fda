"""A small demo and pushes on a tilted table, made once, and a browser."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import Browser, chromium
from hidden_effects import tilted_pushes

from slipmap.diagrams.application.command_line import run
from slipmap.models.measurements import write_dataset


@pytest.fixture(scope="session")
def demo_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `slipmap demo` leaves behind with three pushes to learn from and one held out."""
    folder = tmp_path_factory.mktemp("demo")
    arguments = [
        "demo",
        "-o",
        folder / "demo",
        "--fit-pushes",
        3,
        "--heldout-pushes",
        1,
        "--json",
        folder / "demo.json",
    ]
    assert run([str(argument) for argument in arguments]) == 0
    return folder


@pytest.fixture(scope="session")
def tilted_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The pushes on a tilted table as a folder."""
    return write_dataset(tilted_pushes(), tmp_path_factory.mktemp("tilted") / "tilted")


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """A browser for all pages; tests that need one skip where there is none, and say what is missing."""
    if chromium() is None:
        pytest.skip("no chromium to open pages in; on Debian: apt-get install chromium")
    with Browser() as started:
        yield started
