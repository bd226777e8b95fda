"""What the README and the pages of docs show works: their examples, their commands, their links."""

from __future__ import annotations

import inspect
import json
import re
import shlex
import tomllib
from dataclasses import replace
from pathlib import Path

import click
import pytest
import yaml
from page_examples import Example, examples_of, read_closely

from slipmap.diagrams.application.command_line import slipmap
from slipmap.diagrams.application.demonstration import tilted_block
from slipmap.diagrams.hardware.network import LCM_URL
from slipmap.diagrams.testing import Cell, Faults
from slipmap.models.effects import Effect
from slipmap.models.effects.effect_checks import check_effect
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements import PushDataset, read_dataset, write_dataset

ROOT = Path(__file__).resolve().parents[3]
PAGES = ("README.md", *sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md")))
NOTEBOOKS = tuple(sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "notebooks").glob("*.ipynb")))
GIVEN = {"cell": Cell, "faults": Faults, "dataset": PushDataset}
EXAMPLES = [example for page in PAGES for example in examples_of(ROOT, page)]


@pytest.fixture
def beside_the_demo(demo_folder, tmp_path, monkeypatch):
    """A folder to be in, with what the demo left, and the example."""
    (tmp_path / "demo").symlink_to(demo_folder / "demo")
    write_dataset(tilted_block(), tmp_path / "tilted")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run_example(example):
    """Run an example where pushes and a belief are at hand, as its page says."""
    if f'DrakeLcm("{LCM_URL}")' in example.code:  # a real arm would stop
        example = replace(example, code=example.code.replace(LCM_URL, "memq://"))
    given = {"dataset": read_dataset("demo/pushes"), "belief": Belief.load("demo/belief.npz")}
    exec(example.compiled(), given)
    return given


@pytest.mark.parametrize("example", [example for example in EXAMPLES if example.runs], ids=str)
def test_an_example_runs(example, beside_the_demo, capsys):
    given = run_example(example)
    said = capsys.readouterr().out
    if "maps_figure" in example.code:
        assert re.match(r"held-out pushes end \d+\.\d mm", said)
        assert "finger friction" in said
        assert (beside_the_demo / "maps.png").stat().st_size > 10_000
    elif "start_pose=np.zeros(3)" in example.code:
        turned, differ = map(float, re.findall(r"([-\d.]+)°", said))
        # Pushed near the end of its handle along +x, the hammer turns counter-clockwise.
        assert 10 < turned < 90 and 0 < differ < 30
    elif "slider_of_hypothesis" in example.code:
        found = re.match(r"it came to x = (-?\d+) mm, y = -?\d+ mm, turned by (-?\d+)°", said)
        # Pushed at the end of its handle, towards +x below its middle, the hammer turns counter-clockwise.
        assert found is not None and int(found[2]) > 10, said
    elif "choose_push" in example.code:
        assert re.match(r"push from \[.*\] to \[.*\] at \d\.\d\d m/s", said)
        assert given["choice"].push.end[0] < 0.4
    elif "(Effect)" in example.code:
        (effect,) = [kind for kind in given.values() if inspect.isclass(kind) and kind.__base__ is Effect]
        check_effect(effect(), str(example))


@pytest.mark.parametrize("example", [example for example in EXAMPLES if not example.runs], ids=str)
def test_an_example_that_takes_too_long_names_what_there_is(example):
    example.compiled()
    read_closely(example, GIVEN)


def test_most_examples_run():
    assert sum(not example.runs for example in EXAMPLES) <= 4 < sum(example.runs for example in EXAMPLES)


def test_a_wrong_example_is_noticed():
    for code in (
        "from slipmap import diagnosed",
        "from slipmap import diagnose\ndiagnose(dataset, speed=0)",
        "from slipmap import diagnose\nresult = diagnose(dataset)\nresult.culprit",
        "faults.when('pushing')",
        "cells.explore(pushes=3)",
    ):
        with pytest.raises((AssertionError, AttributeError)):
            read_closely(
                Example("page", 1, code, False), {"cell": Cell, "faults": Faults, "dataset": PushDataset}
            )


def shown_on(page):
    """Text of a page, or of a notebook's cells that are no code."""
    text = (ROOT / page).read_text(encoding="utf-8")
    if not page.endswith(".ipynb"):
        return text
    cells = [cell for cell in json.loads(text)["cells"] if cell["cell_type"] == "markdown"]
    return "\n\n".join("".join(cell["source"]) for cell in cells)


@pytest.mark.parametrize("page", (*PAGES, *NOTEBOOKS))
def test_commands_and_options_exist(page):
    text = shown_on(page)
    shown = re.findall(r"`slipmap ([a-z][^`]+)`", text)
    shown += re.findall(r"^    (?:slipmap|python -m slipmap) ([a-z-]+(?: .+)?)$", text, flags=re.M)
    assert len(shown) > 3 or page != "README.md"
    for line in shown:
        name, *rest = shlex.split(line, comments=True)
        command = slipmap.commands[name]
        options = {option: parameter for parameter in command.params for option in parameter.opts}
        if rest and rest[-1] in options:
            rest.pop()  # named without its value
        # Beneath the group: a command without it would keep another name of its option for help.
        group = slipmap.make_context("slipmap", [], resilient_parsing=True)
        with command.make_context(name, [], parent=group, resilient_parsing=True) as context:
            values, left, _ = command.make_parser(context).parse_args(rest)
        assert not left, f"{line}: {left} is too much"
        for parameter in command.params:
            given = values.get(parameter.name)
            if isinstance(parameter.type, click.Choice) and isinstance(given, str | list):
                assert set([given] if isinstance(given, str) else given) <= set(parameter.type.choices), line


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
    assert set((ROOT / "docs").rglob("*.md")) <= seen


def test_the_citation_names_this_version_and_licence():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert [cited[key] for key in ("title", "version", "license")] == [
        project[key] for key in ("name", "version", "license")
    ]
