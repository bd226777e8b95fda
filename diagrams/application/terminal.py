"""What the commands show on a terminal: notes, progress, tables. Results go to stdout, all else to stderr."""

from __future__ import annotations

import sys
import textwrap
import time
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING

import click

from slipmap.models.files import BadInput

if TYPE_CHECKING:
    from slipmap.diagrams.application.progress_bars import Bars

WIDTH = 80
"""Columns of everything that is not shown on a terminal."""

WIDEST = 100
GAP = 3  # columns between those of a table
HEARTBEAT = 15.0
"""Seconds after which a long stage reports again in a log file."""


def note(text: str) -> None:
    """A line on stderr."""
    click.echo(text, err=True)


def paragraph(text: str) -> None:
    """A text on stdout, broken into lines of 80 columns; nothing where it is empty."""
    if text:
        click.echo(textwrap.fill(text, WIDTH))


def status(text: str) -> None:
    """A remark on stderr, broken into lines of 80 columns of which those after the first are indented."""
    note(textwrap.fill(text, WIDTH, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False))


def wait_for_enter() -> None:
    """Wait until Enter is pressed or the input ends."""
    sys.stdin.readline()


def prepare_kernels() -> None:
    """Before anything is simulated: see that compiled kernels can be kept, and tell of the wait for new ones.

    Raises:
        BadInput: their folder cannot be made.
    """
    from slipmap.models.physics.compiled import CACHE_FOLDER, needs_compiling

    try:
        CACHE_FOLDER.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(
            f"compiled kernels cannot be kept in {CACHE_FOLDER} ({error.strerror}); set the environment"
            " variable SLIPMAP_CACHE to a folder that you may write to"
        ) from error
    if needs_compiling():
        note("Compiling the kernels for this machine, once (about half a minute)…")


class Pace:
    """How fast a stage goes: the time left, at the mean pace of the parts that were seen to be done.

    Args:
        done: parts that were done before it began, and took no time.
    """

    def __init__(self, done: int) -> None:
        self._first = self._done = done
        self._began = self._last = time.monotonic()

    def note(self, done: int) -> bool:
        """Note how many parts are done; returns whether these are more than before."""
        more = done > self._done
        if more:
            self._done, self._last = done, time.monotonic()
        return more

    def left(self, total: int) -> float | None:
        """Seconds until all parts are done; None until one is. It runs down while a part is at work."""
        made = self._done - self._first
        if made <= 0:
            return None
        each = (self._last - self._began) / made
        at_work = min(time.monotonic() - self._last, each)
        return max(each * (total - self._done) - at_work, 0.0)


class Progress:
    """Shows progress and the time left on stderr: bars on a terminal, elsewhere a line now and then.

    Use as a context manager, and call with (stage, done, total). What follows a colon in a stage is what is
    being done at present: it is shown beside the bar, and does not begin a new one. A stage of one part, or
    of 0 where nobody knows how many there are, has no count and no time left, only the time that it takes.
    """

    def __init__(self) -> None:
        self._stage = self._doing = ""
        self._began = self._spoke = time.monotonic()
        self._pace = Pace(0)
        self._bars: Bars | None = None

    def __enter__(self) -> Progress:
        if sys.stderr.isatty():
            from slipmap.diagrams.application.progress_bars import Bars

            self._bars = Bars()
            self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._finish(complete=kind is None)
        if self._bars is not None:
            self._bars.stop()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Report that `done` of `total` parts of a stage are done."""
        stage, _, doing = stage.partition(": ")
        if stage != self._stage:
            self._finish(complete=True)
            self._stage, self._pace = stage, Pace(done)
            self._began = self._spoke = time.monotonic()
            if self._bars is not None:
                self._bars.begin(stage, self._pace)
            else:
                note(f"{stage} …")
        self._doing = doing
        more = self._pace.note(done)
        if self._bars is not None:
            self._bars.show(f"{stage}: {doing}" if doing else stage, done, total)
        elif time.monotonic() - self._spoke > HEARTBEAT or (more and doing):
            self._speak(done, total)

    def _speak(self, done: int, total: int) -> None:
        """Say in a log file how far the stage is."""
        if total and done >= total:
            return  # its end is told when it ends
        self._spoke = time.monotonic()
        if total > 1:
            text = f"{done} of {total}{_about(self._pace.left(total))}"
        else:
            text = f"{time.monotonic() - self._began:.0f} s so far"
        note("; ".join(filter(None, (f"{self._stage}: {text}", self._doing))))

    def _finish(self, *, complete: bool) -> None:
        """Close the present stage; a stage may end before its total, when it has converged."""
        if not self._stage or not complete:
            return
        if self._bars is not None:
            self._bars.end(self._stage)
        else:
            note(f"{self._stage}: done in {time.monotonic() - self._began:.1f} s")
        self._stage = ""


def _about(seconds: float | None) -> str:
    """The time left in words, after a comma; nothing where it is not known."""
    if seconds is None:
        return ""
    for unit, length in (("h", 3600.0), ("min", 60.0)):
        if seconds > 2 * length:
            return f", about {seconds / length:.0f} {unit} left"
    return f", about {seconds:.0f} s left"


def table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], *, numbers: Sequence[int] = ()
) -> None:
    """Print a table on stdout, within the terminal's width or 80 columns, and an empty line.

    Args:
        title: line above it.
        columns: headings.
        rows: cells.
        numbers: columns to align on the right and never to wrap.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(width=None if sys.stdout.isatty() else WIDTH, highlight=False)
    console.width = min(console.width, WIDEST)
    texts = [list(column) for column in zip(columns, *rows, strict=True)]
    least = [
        max(len(part) for text in column for part in ([text] if index in numbers else text.split() or [""]))
        for index, column in enumerate(texts)
    ]
    crowded = sum(least) + GAP * (len(columns) - 1) > console.width
    grid = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
    for index, name in enumerate(columns):
        is_number = index in numbers
        heading = _broken(*texts[index]) if is_number and crowded else name
        grid.add_column(heading, justify="right" if is_number else "left", no_wrap=is_number, overflow="fold")
    for row in rows:
        grid.add_row(*map(Text, row))
    console.print(Text(title, style="bold"))
    console.print(grid)
    console.print()


def _broken(heading: str, *cells: str) -> str:
    """The heading in several lines, none longer than it must be for its words and the cells below."""
    width = max(len(text) for text in (*heading.split(), *cells))
    return textwrap.fill(heading, width, break_on_hyphens=False)
