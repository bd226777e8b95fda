"""Bars of progress on a terminal, each in one line however narrow it is."""

from __future__ import annotations

from datetime import timedelta
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Column
from rich.text import Text

if TYPE_CHECKING:
    from slipmap.diagrams.application.terminal import Pace

LONGEST = 34
"""Letters of a stage and of what is being done; what is longer is cut."""

BAR = 16
"""Columns of a bar where there is room: with the numbers, 80 columns hold all."""


class Bars:
    """One bar for each stage, those that have ended above the present one."""

    def __init__(self) -> None:
        self._bars = Progress(
            TextColumn(f"{{task.description:<{LONGEST}}}", markup=False),
            BarColumn(BAR),
            _Count(_line()),
            TimeElapsedColumn(_line()),
            _TimeLeft(_line()),
            console=Console(stderr=True),
        )
        self._task = TaskID(0)

    def start(self) -> None:
        """Begin to draw."""
        self._bars.start()

    def stop(self) -> None:
        """Leave what is drawn as it is."""
        self._bars.stop()

    def begin(self, stage: str, pace: Pace) -> None:
        """Add a bar; it has no end until one is shown."""
        self._task = self._bars.add_task(_cut(stage), total=None, pace=pace)

    def show(self, text: str, done: int, total: int) -> None:
        """How far the last bar is; one part, or 0 where their number is not known, cannot be counted."""
        task = self._bars.tasks[self._task]
        shown, whole = _cut(text), total if total > 1 else None
        if (task.description, task.completed, task.total) != (shown, done, whole):
            self._bars.update(self._task, description=shown, completed=done, total=whole)

    def end(self, stage: str) -> None:
        """Fill the last bar and stop its clock."""
        whole = self._bars.tasks[self._task].total or 1
        self._bars.update(self._task, description=_cut(stage), completed=whole, total=whole)
        self._bars.stop_task(self._task)


def _line() -> Column:
    """A column that gives way to none: where the terminal is narrow, the bar becomes shorter."""
    return Column(no_wrap=True)


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"


class _Count(ProgressColumn):
    """Parts done of all, where there are several."""

    def render(self, task: Task) -> Text:
        counted = task.total is not None and task.total > 1
        text = f"{task.completed:.0f}/{task.total:.0f}" if counted else ""
        return Text(text, style="progress.download", justify="right")


class _TimeLeft(ProgressColumn):
    """The time left, once a part is done and until all are."""

    def render(self, task: Task) -> Text:
        pace: Pace = task.fields["pace"]
        left = None if task.total is None or task.finished else pace.left(int(task.total))
        text = "" if left is None else f"{timedelta(seconds=round(left))} left"
        return Text(text, style="progress.remaining")
