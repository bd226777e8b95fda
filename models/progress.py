"""How work that takes long says how far it has come."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called with (stage, done, total)."""

StageProgress = Callable[[int, int], None]
"""The same for one stage: called with (done, total)."""


def silent(stage: str, done: int, total: int) -> None:
    """The progress that nobody asked for."""


def about(what: str, progress: Progress) -> Progress:
    """Progress of stages that say what they are about: `fitting, without effects`."""
    return lambda stage, done, total: progress(f"{stage}, {what}", done, total)


def part_of(progress: StageProgress, place: int, parts: int) -> StageProgress:
    """Progress of one of several parts that take about equally long, counted over all of them."""
    return lambda done, total: progress(place * total + done, parts * total)
