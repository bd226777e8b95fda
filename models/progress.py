"""Progress callbacks of long computations."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]  # called with (stage, done, total)
StageProgress = Callable[[int, int], None]  # the same for one stage: called with (done, total)


def silent(stage: str, done: int, total: int) -> None:
    """Ignore the progress."""


def about(what: str, progress: Progress) -> Progress:
    """Progress whose stages name their subject: `fitting, without effects`."""
    return lambda stage, done, total: progress(f"{stage}, {what}", done, total)


def part_of(progress: StageProgress, place: int, parts: int) -> StageProgress:
    """Progress of one of several equally long parts, counted over all of them."""
    return lambda done, total: progress(place * total + done, parts * total)
