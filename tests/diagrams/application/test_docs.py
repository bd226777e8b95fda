"""Pages of docs/ are legible as they are, quote what the laboratory's pages hold, and make a site."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
LAB = DOCS / "lab"
NO_CLAIMS = {LAB, DOCS / "changelog.md"}
"""Where numbers are measured, and where history tells of those of then."""

RESULT = re.compile(
    r"\b(ended|held (?=[\d,]+ )|came out|comes? out|(was|were) (off|found|learned)|in the median|on average"
    r"|beside (the|its) prediction|held out(?= \|)|held-out (error|ends|pushes)|lifts held|over twelve sets"
    r"|(is|are) (estimated as|accurate|exact|within)|were hidden|differ by|scatter by|stays within"
    r"|mistaken for a|misses one or more)\b"
)
"""Words by which a sentence tells what was measured."""

CITED = re.compile(r"et al\., \d{4}")
"""In a sentence on what others measured."""

NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?=(?: (?:to|and|or) \d+(?:\.\d+)?)* ?(?:mm|°|%))")
LEVEL = re.compile(r"\b(?:(?:50|90|95)(?:, | and )?)+ % (?:\w+ )?(?:region|interval)s?")


def named(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_lines_and_cells_are_short(page):
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        if line.startswith("|"):
            cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)]
            assert max(map(len, cells)) <= 200, f"{named(page)}:{number}: a cell of {max(map(len, cells))}"
        elif not line.startswith("$$"):
            assert len(line) <= 160, f"{named(page)}:{number}: {len(line)} characters"


def sentences(paragraph: str) -> list[str]:
    """Sentences of a paragraph; of a table its rows, each after the heads of the columns."""
    if paragraph.lstrip().startswith("|"):
        head, *rows = paragraph.strip().splitlines()
        return [f"{head} {row}" for row in rows]
    return re.split(r"(?<=[.:;]) ", " ".join(paragraph.split()))


def claims(text: str) -> list[tuple[str, set[str], list[str]]]:
    """Sentences that tell a result, each with its numbers and the lab pages that its section links to."""
    found = []
    for section in re.split(r"^#+ .*$", re.sub(r"```.*?```", "", text, flags=re.S), flags=re.M):
        linked = re.findall(r"\]\((?:docs/)?lab/([\w-]+\.md)", section)
        for paragraph in re.split(r"\n\s*\n|\n(?=- |\d+\. )", section):
            for sentence in sentences(paragraph):
                numbers = set(NUMBER.findall(LEVEL.sub("", sentence)))
                if numbers and RESULT.search(sentence) and not CITED.search(sentence):
                    found.append((sentence, numbers, linked))
    return found


@pytest.mark.parametrize("page", [page for page in PAGES if not NO_CLAIMS & {page, page.parent}], ids=named)
def test_a_result_that_is_quoted_stands_on_a_page_of_the_laboratory(page):
    for sentence, numbers, linked in claims(page.read_text(encoding="utf-8")):
        held = {number for name in linked for number in re.findall(r"[\d.]*\d", (LAB / name).read_text())}
        assert linked, f"its section links to no page of docs/lab: {sentence}"
        assert numbers <= held, f"{sorted(numbers - held)} is on none of {linked}: {sentence}"


@pytest.mark.skipif(
    importlib.util.find_spec("mkdocs") is None, reason="no mkdocs; pip install 'slipmap[docs]' brings it"
)
def test_the_site_can_be_built_and_leaves_no_page_out(tmp_path):
    """In strict mode, in which a link or an anchor that leads nowhere is an error."""
    command = [sys.executable, "-m", "mkdocs", "build", "-f", str(ROOT / "mkdocs.yml"), "-d", str(tmp_path)]
    variables = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=120)
    assert built.returncode == 0, built.stderr
    assert "not included in the" not in built.stderr and "was left as is" not in built.stderr, built.stderr
    assert "pyramid" in (tmp_path / "search" / "search_index.json").read_text(encoding="utf-8")
    assert {path.stem for path in DOCS.glob("*.md")} - {"README"} <= {
        path.name for path in tmp_path.iterdir()
    }
