"""What the README shows works: its example, its commands, its links."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from diagrams.command_line import slipmap

ROOT = Path(__file__).resolve().parents[2]
PAGES = ("README.md", *sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").glob("*.md")))


def what_an_example_says(page, demo_folder, folder):
    """Output of a page's only example in Python, beside what the demo left."""
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), flags=re.S)
    (folder / "demo").symlink_to(demo_folder / "demo")
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True, text=True,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_python_example_runs_on_what_the_demo_leaves(demo_folder, tmp_path):
    said = what_an_example_says("README.md", demo_folder, tmp_path)
    assert re.match(r"pushes that were held out end \d+\.\d mm", said)
    assert "finger friction" in said
    assert (tmp_path / "maps.png").stat().st_size > 10_000


def test_the_slider_of_the_station_page_is_pushed(demo_folder, tmp_path):
    said = what_an_example_says("docs/station.md", demo_folder, tmp_path)
    found = re.match(r"it came to x = (-?\d+) mm, y = -?\d+ mm, turned by (-?\d+)°", said)
    # Pushed at the end of its handle, towards +x below its middle, the hammer turns counter-clockwise.
    assert found is not None and int(found[2]) > 10, said


@pytest.mark.parametrize("page", PAGES)
def test_commands_and_options_exist(page):
    text = (ROOT / page).read_text()
    shown = re.findall(r"`slipmap ([a-z][^`]+)`", text)
    shown += re.findall(r"^    (?:slipmap|python -m diagrams.command_line) (.+)$", text, flags=re.M)
    assert len(shown) > 3 or page != "README.md"
    for line in shown:
        name, *rest = shlex.split(line, comments=True)
        options = {option for parameter in slipmap.commands[name].params for option in parameter.opts}
        assert {word for word in rest if word.startswith("-")} <= {"--help", *options}


def test_make_targets_exist():
    targets = set(re.findall(r"^([a-z]+):.*## ", (ROOT / "Makefile").read_text(), flags=re.M))
    named = set(re.findall(r"\bmake ([a-z]+)\b", (ROOT / "README.md").read_text()))
    assert {"demo", "test"} <= named <= targets


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    text = (ROOT / page).read_text()
    for link, anchor in re.findall(r"\]\(([^)#:]+)(?:#([^)]+))?\)", text):
        target = (ROOT / page).parent / link
        assert target.exists(), link
        assert not anchor or anchor in anchors_of(target), f"{link}#{anchor}"
    for named in re.findall(r"`((?:models|planners|diagrams|tests|docs|notebooks)/[\w/.]*)`", text):
        assert (ROOT / named).exists(), named
    folders = re.findall(r"^\| `([a-z]+)/` ", text, flags=re.M) if page == "README.md" else []
    assert all((ROOT / folder).is_dir() for folder in folders)


def anchors_of(page):
    """What a link may name after #, as the usual hosts make it from headings."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_page_can_be_reached_from_the_readme():
    seen, waiting = set(), [ROOT / "README.md"]
    while waiting:
        page = waiting.pop().resolve()
        if page.suffix == ".md" and page not in seen:
            seen.add(page)
            waiting += [page.parent / link for link in re.findall(r"\]\(([^)#:]+)", page.read_text())]
    assert set((ROOT / "docs").glob("*.md")) <= seen


def test_the_citation_names_this_version_and_licence():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert [cited[key] for key in ("title", "version", "license")] == [
        project[key] for key in ("name", "version", "license")
    ]
