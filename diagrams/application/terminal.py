"""Terminal output of the commands: notes, progress, tables. Results go to stdout, all else to stderr.

Progress is a bar for each stage on a terminal, and an occasional line in a log file. `rich`, which draws bars
and tables, is loaded only when it is needed.
"""

from __future__ import annotations

import re
import sys
import textwrap
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta

import click

from slipmap.models.files import BadInput

WIDTH = 80  # columns of output that does not go to a terminal
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
_WIDEST = 100  # columns, largest width of a table
_GAP = 3  # characters between the columns of a table
_HEARTBEAT = 15.0  # s after which a long stage reports again in a log file
_LONG = 3.0  # s of compiling that are announced
_LONGEST_STAGE = 34  # characters beside a bar; longer names are cut
_ENOUGH, _ALWAYS_ENOUGH = 0.02, 20  # parts, as a share of all and in number, that tell the pace
_BAR = 16  # columns of a bar where there is room; with the numbers, the line fits 80 columns


def printable(text: str) -> str:
    """Text with control characters spelled out; in names of files and datasets, they could move the cursor or
    forge output."""
    return _CONTROL.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def note(text: str) -> None:
    """Print a line on stderr."""
    click.echo(printable(text), err=True)


def wrapped(text: str, indent: str) -> str:
    """Text wrapped to 80 columns, with all lines but the first indented; no word is broken."""
    return textwrap.fill(
        printable(text), WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def paragraph(text: str) -> None:
    """Print a text on stdout, wrapped to 80 columns; nothing if it is empty."""
    if text:
        click.echo(wrapped(text, ""))


def status(text: str) -> None:
    """Print a remark on stderr, wrapped to 80 columns, with all lines but the first indented."""
    note(wrapped(text, "    "))


@contextmanager
def warnings_noted(worded: Callable[[str], str] = str) -> Iterator[None]:
    """Print what the block warns of, each warning, as `worded`, as a line on stderr, and not again."""
    with warnings.catch_warnings(record=True) as found:
        yield
    for text in dict.fromkeys(str(one.message) for one in found if one.category is UserWarning):
        note(f"warning: {worded(text)}")
        warnings.filterwarnings("ignore", re.escape(text), UserWarning)


def counted(count: int, what: str = "push") -> str:
    """A number of things, such as `1 push` or `3 pushes`."""
    ending = "es" if what.endswith("sh") else "s"
    return f"{count} {what}{'' if count == 1 else ending}"


def wait_for_enter() -> None:
    """Wait until Enter is pressed or the input ends."""
    sys.stdin.readline()


def prepare_kernels() -> None:
    """Check that compiled kernels can be stored, and announce the wait for compiling them.

    Call it before anything is simulated.

    Raises:
        BadInput: their folder cannot be made.
    """
    from slipmap.models.physics.compiled import CACHE_FOLDER, needs_compiling

    if not _compiling:
        from numba.core import event

        class Watch(_Compiling, event.Listener):
            pass

        _compiling.append(Watch())
        event.register("numba:compiler_lock", _compiling[0])
    try:
        CACHE_FOLDER.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(
            f"compiled kernels cannot be stored in {CACHE_FOLDER} ({error.strerror}); set the environment"
            " variable SLIPMAP_CACHE to a folder that you may write to"
        ) from error
    if needs_compiling():
        note("Compiling the kernels for this machine, once (up to two minutes)…")
        _compiling[0].told = True


class Progress:
    """Progress and remaining time on stderr: bars on a terminal, occasional lines elsewhere.

    Use as a context manager, and call with (stage, done, total). Text after a colon in a stage names the
    current activity: it is shown beside the bar and does not start a new one. A stage with one part, or with
    0 for an unknown number, shows no count and no remaining time, only the elapsed time.
    """

    def __init__(self) -> None:
        self._stage = self._doing = ""
        self._began = self._spoke = time.monotonic()
        self._pace = _Pace(0)
        self._bars: _Bars | None = None

    def __enter__(self) -> Progress:
        if sys.stderr.isatty():
            self._bars = _Bars()
        return self

    def __exit__(self, kind: type[BaseException] | None, *details: object) -> None:
        self._finish(complete=kind is None)
        if self._bars is not None:
            self._bars.stop()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Report that `done` of `total` parts of a stage are done."""
        stage, _, doing = stage.partition(": ")
        if stage != self._stage:
            self._finish(complete=True)
            self._stage, self._pace = stage, _Pace(done)
            self._began = self._spoke = time.monotonic()
            if self._bars is not None:
                self._bars.begin(stage, self._pace)
            else:
                note(f"{stage} …")
        self._doing = doing
        more = self._pace.note(done, total)
        if self._bars is not None:
            self._bars.show(f"{stage}: {doing}" if doing else stage, done, total)
        elif time.monotonic() - self._spoke > _HEARTBEAT or (more and doing):
            self._speak(done, total)

    @contextmanager
    def step(self, stage: str) -> Iterator[None]:
        """A stage of one part, done when the block ends without an exception."""
        self(stage, 0, 1)
        yield
        self(stage, 1, 1)

    def _speak(self, done: int, total: int) -> None:
        """Report in a log file how far the stage is."""
        if total and done >= total:
            return  # reported when it ends
        self._spoke = time.monotonic()
        if total > 1:
            text = f"{done} of {total}{_about(self._pace.left())}"
        else:
            text = f"{time.monotonic() - self._began:.0f} s so far"
        note("; ".join(filter(None, (f"{self._stage}: {text}", self._doing))))

    def _finish(self, *, complete: bool) -> None:
        """Close the current stage; it may end before its total, as when it has converged."""
        if not self._stage or not complete:
            return
        if self._bars is not None:
            self._bars.end(self._stage)
        else:
            note(f"{self._stage}: done in {time.monotonic() - self._began:.1f} s")
        self._stage = ""


class _Compiling:
    """A watch of the time spent compiling, kernels or formulas of effects; numba tells it."""

    _depth, _began, _spent = 0, 0.0, 0.0
    told = False  # whether the wait was announced

    def on_start(self, event: object) -> None:
        if not self._depth:
            self._began = time.monotonic()
        self._depth += 1
        if not self.told and self.seconds > _LONG:  # as with the first table or the first effect
            self.told = True
            note("Compiling what these pushes need for the first time (up to a minute)…")

    def on_end(self, event: object) -> None:
        self._depth -= 1
        if not self._depth:
            self._spent += time.monotonic() - self._began

    @property
    def seconds(self) -> float:
        """Including what is being compiled now."""
        return self._spent + (time.monotonic() - self._began if self._depth else 0.0)


_compiling: list[_Compiling] = []  # once kernels are prepared


def _clock() -> float:
    """Seconds, like `time.monotonic`, but without compiling, which says nothing about the pace."""
    return time.monotonic() - sum(watch.seconds for watch in _compiling)


class _Pace:
    """Remaining time of a stage, from the mean duration of the finished parts.

    Args:
        done: parts that were already done at the start.
    """

    def __init__(self, done: int) -> None:
        self._first = self._done = done
        self._total = 0
        self._began = self._last = _clock()

    def note(self, done: int, total: int) -> bool:
        """Update the number of finished parts; returns whether it has grown."""
        self._total = total
        more = done > self._done
        if more:
            self._done, self._last = done, _clock()
        return more

    def left(self) -> float | None:
        """Seconds until all parts are done; None until enough are. Counts down while a part is running."""
        made = self._done - self._first
        if self._total <= 1 or made < min(max(1, _ENOUGH * self._total), _ALWAYS_ENOUGH):
            return None
        now = _clock()
        # Parts read from files finish at once and say nothing about the others: the running part counts too.
        each = max((self._last - self._began) / made, (now - self._began) / (made + 1))
        at_work = min(now - self._last, each)
        return max(each * (self._total - self._done) - at_work, 0.0)

    def __str__(self) -> str:
        """The remaining time beside a bar, which queries it repeatedly."""
        left = self.left()
        return "" if left is None else f"{timedelta(seconds=round(left))} left"


def _about(seconds: float | None) -> str:
    """The remaining time in words, after a comma; empty if unknown."""
    if seconds is None:
        return ""
    for unit, length in (("h", 3600.0), ("min", 60.0)):
        if seconds > 2 * length:
            return f", about {seconds / length:.0f} {unit} left"
    return f", about {seconds:.0f} s left"


class _Bars:
    """One bar for each stage, finished ones above the current one. Each takes one line; on narrow terminals,
    the bar is shorter.
    """

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
        from rich.table import Column

        self._bars = Progress(
            TextColumn(f"{{task.description:<{_LONGEST_STAGE}}}", markup=False),
            BarColumn(_BAR),
            TextColumn("{task.fields[count]}", style="progress.download", justify="right", markup=False),
            TimeElapsedColumn(Column(no_wrap=True)),
            TextColumn("{task.fields[left]}", style="progress.remaining", markup=False),
            console=Console(stderr=True),
        )
        self._bars.start()

    def begin(self, stage: str, pace: _Pace) -> None:
        """Add a bar, without a total until one is shown."""
        self._task = self._bars.add_task(_cut(stage), total=None, count="", left=pace)

    def show(self, text: str, done: int, total: int) -> None:
        """Update the last bar; a total of one part, or 0 for an unknown number, has no count."""
        task = self._bars.tasks[self._task]
        shown, whole = _cut(text), total if total > 1 else None
        if (task.description, task.completed, task.total) != (shown, done, whole):
            count = f"{done}/{total}" if total > 1 else ""
            self._bars.update(self._task, description=shown, completed=done, total=whole, count=count)
            if task.finished:
                self._bars.update(self._task, left="")

    def end(self, stage: str) -> None:
        """Fill the last bar and stop its clock."""
        whole = int(self._bars.tasks[self._task].total or 1)
        count = f"{whole}/{whole}" if whole > 1 else ""
        self._bars.update(
            self._task, description=_cut(stage), completed=whole, total=whole, count=count, left=""
        )
        self._bars.stop_task(self._task)

    def stop(self) -> None:
        """Stop updating, and leave the bars as drawn."""
        self._bars.stop()


def _cut(text: str) -> str:
    text = printable(text)
    return text if len(text) <= _LONGEST_STAGE else text[: _LONGEST_STAGE - 1] + "…"


def table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], *, numbers: Sequence[int] = ()
) -> None:
    """Print a table on stdout, within the terminal's width or 80 columns, then an empty line.

    Args:
        numbers: columns to align on the right and not to wrap.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(width=None if sys.stdout.isatty() else WIDTH, highlight=False)
    console.width = min(console.width, _WIDEST)
    texts = [list(column) for column in zip(columns, *rows, strict=True)]
    least = [
        max(len(part) for text in column for part in ([text] if index in numbers else text.split() or [""]))
        for index, column in enumerate(texts)
    ]
    crowded = sum(least) + _GAP * (len(columns) - 1) > console.width
    grid = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
    for index, name in enumerate(columns):
        is_number = index in numbers
        heading = _broken(*texts[index]) if is_number and crowded else name
        grid.add_column(heading, justify="right" if is_number else "left", no_wrap=is_number, overflow="fold")
    for row in rows:
        grid.add_row(*(Text(printable(cell)) for cell in row))
    console.print(Text(printable(title), style="bold"))
    console.print(grid)
    console.print()


def _broken(heading: str, *cells: str) -> str:
    """The heading wrapped to the width that its words and the cells below need."""
    width = max(len(text) for text in (*heading.split(), *cells))
    return textwrap.fill(heading, width, break_on_hyphens=False)
