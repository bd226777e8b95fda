"""The notice above the board: what the robot is doing, what surprised it, and how it repaired its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from textwrap import fill, shorten

import numpy as np
from matplotlib.figure import Figure

from slipmap.diagrams.systems.diagnosis import CLOSE, TRIED, Finding, Repair
from slipmap.diagrams.systems.look import INK, styled
from slipmap.diagrams.systems.loop_messages import LoopStatus
from slipmap.diagrams.systems.model_monitor import Judged, Watch
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.effect_words import effect_of_belief
from slipmap.models.inference.end_region import beyond_in_millimetres

NOTICE = (0.69, 0.17)  # size, m
ALARMING = (0.80, 0.10, 0.15)
INCH = 5.6  # of a figure per metre of a board
_HEADING, _LINE = 33, 41  # most characters in a line
_LINES = 2  # of the reason

_DID = {
    "adopts": "Added",
    "keeps": "Kept",
    "drops": "Dropped again",
    "pushes on": "Undecided: one more push",
    "goes on without": "Nothing to add to the model",
}
"""What the robot did about a `Finding`, by its action."""

_DOING = {
    "diagnosing": "Diagnosing what the model lacks",
    "grasping": "Grasping it at the edge",
    "lifting": "Lifting it",
    "holding": "Lifting it",
    "held": "Holding it",
    "finished": "Exploration finished",
}
"""What the robot is doing in a mode of the loop; in the others it makes, or prepares, a push."""


@dataclass(frozen=True)
class Words:
    """What a notice says."""

    doing: str  # what the robot is doing; empty where nobody says so
    heading: str  # what happened last, or what is known; may be empty
    reason: str  # why, or by how much; may be empty
    alarming: bool = False  # whether the last push surprised, and was not yet examined


def words_of(
    status: LoopStatus | None, watch: Watch | None, repair: Repair | None, belief: Belief | None
) -> Words | None:
    """What to say, or None if there is nothing."""
    doing = "" if status is None else _doing(status)
    judged = () if watch is None else watch.judged
    found = repair.findings[-1] if repair is not None and repair.findings else None
    if judged and judged[-1].surprising and (found is None or found.pushes <= judged[-1].trial):
        last = judged[-1]
        error, allowed = beyond_in_millimetres(last.error, last.allowed)
        expected = f"{allowed} mm at most were expected."
        asks = f"ALARM: {last.criterion}" if last.alarm else "Is the model missing something?"
        return Words(doing, f"Last push ended {error} mm off", f"{expected} {asks}", True)
    if found is not None:
        exploring = status is None or status.of > 0  # pushes towards the edge are not chosen to find out more
        return Words(doing, *_found(found, belief, asks=exploring))
    if judged and doing:
        return Words(doing, *_unexamined(judged, alarm=watch is not None and watch.alarm))
    return Words(doing, "", "") if doing else None


def _unexamined(judged: Sequence[Judged], *, alarm: bool) -> tuple[str, str]:
    """Heading and reason where the last push did not surprise and nothing was diagnosed."""
    surprising = sum(push.surprising for push in judged)
    if alarm or surprising:
        heading = "The alarm is still on" if alarm else "The last push did not surprise"
        return heading, f"{surprising} of {len(judged)} pushes ended outside what the belief allowed."
    count = "The last push" if len(judged) == 1 else f"{len(judged)} pushes"
    return "No surprise so far", f"{count} ended within what the belief allowed."


def _doing(status: LoopStatus) -> str:
    if status.mode == "failed":
        return shorten(f"Stopped: {status.reason}", _LINE, placeholder=" …")
    if status.mode in _DOING:
        return _DOING[status.mode]
    if status.of:
        return f"Exploring: push {status.push + 1} of {status.of}"
    return f"To the edge: push {status.push + 1}"


def _found(found: Finding, belief: Belief | None, *, asks: bool) -> tuple[str, str]:
    """Heading and reason of a finding, with the sizes of effects once the belief has them."""
    action = "goes on without" if found.action == "pushes on" and not asks else found.action
    did, sizes = _DID[action], []
    if action in ("adopts", "keeps") and found.effects:
        known = set() if belief is None else {effect.name for effect in belief.effects}
        if belief is not None and set(found.effects) <= known:
            sizes = [size for name in found.effects for size in effect_of_belief(name, belief)]
        alone = len(found.effects) == 1 and not found.rival
        short = alone and sizes and len(f"{did}: {sizes[0]}") <= _HEADING
        did = f"{did}: {sizes[0] if short else found.model}"
    told = f"{', '.join(sizes)}. " if sizes else ""
    if found.rival:
        told = "Pushes so far fit either of them. "
    if found.telling and asks:
        return did, f"The next push tells {found.telling}."
    if found.action == "adopts":
        return did, f"{told}The next pushes test it."
    if found.verdict in (TRIED, CLOSE):
        return did, found.sentence
    return did, told.strip() or found.sentence


@styled
def notice(words: Words, errors: Sequence[float]) -> bytes:
    """PNG of a notice with the prediction error of each push.

    Args:
        words: to show.
        errors: of the predicted pushes, in order, m.
    """
    color = ALARMING if words.alarming else INK
    figure = Figure(figsize=(NOTICE[0] * INCH, NOTICE[1] * INCH), dpi=220)
    figure.patch.set_edgecolor(color)
    figure.patch.set_linewidth(3.0)
    heading = shorten(words.heading, _HEADING, placeholder=" …")
    first, second = (words.doing, heading) if heading else ("", words.doing)
    figure.text(0.03, 0.85, first, fontsize=9.5, color=INK, va="center")
    figure.text(0.03, 0.59, second, fontsize=12.5, color=color, va="center", weight="bold")
    reason = fill(words.reason, _LINE, max_lines=_LINES, placeholder=" …")
    figure.text(0.03, 0.23, reason, fontsize=9.5, color=INK, va="center", linespacing=1.15)
    if errors:
        bars = figure.add_axes((0.80, 0.12, 0.17, 0.58))
        bars.bar(range(len(errors)), 1e3 * np.array(errors), color=color)
        bars.set_xlim(-0.6, max(len(errors), 5) - 0.4)
        bars.set_axis_off()
        top = f"errors to {1e3 * max(errors):.0f} mm"
        figure.text(0.97, 0.85, top, fontsize=9, color=INK, ha="right", va="center")
    stream = BytesIO()
    figure.savefig(stream, format="png", edgecolor=figure.get_edgecolor())
    return stream.getvalue()
