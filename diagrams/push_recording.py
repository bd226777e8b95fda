"""Pushes of a cell that somebody else drives, written down one by one as they are heard of."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, BinaryIO

from diagrams.hardware.message_log import Event
from diagrams.hardware.message_stream import TICK
from diagrams.outputs import writing
from diagrams.push_listener import HEARD, PushListener
from diagrams.systems.push_finder import Descent
from models.measurements.recording import PushRecorder

Tell = Callable[[str], None]

TOLD_EVERY = 10.0
"""s between two lines about what is heard."""


def record_pushes(
    events: Iterable[Event],
    listener: PushListener,
    recorder: PushRecorder,
    tell: Tell,
    *,
    log: BinaryIO | None = None,
    most: int | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> None:
    """Listen until the events end, enough pushes are recorded, or somebody stops it.

    Args:
        events: what comes.
        listener: makes out pushes.
        recorder: where each push goes as soon as it is over.
        tell: called with a line when the object is first seen, when the finger was down, and now and then.
        log: where all events go as they came, if anywhere.
        most: pushes.
        stopped: whether it is to end; asked at every event.

    Raises:
        BadLog, HardwareError: of the events.
        BadInput: the disk is full or the place not writable; names the file.
    """
    seen, told, spoke, logged, expected = False, 0, None, 0, 0
    for event in events:
        if stopped():
            return
        spoke = event.utime if spoke is None else spoke
        if event.utime - spoke > 1e6 * TOLD_EVERY:
            spoke = event.utime
            tell(hearing(listener))
        if event.channel == TICK:
            continue
        if event.number > expected > 0:
            missing = event.number - expected
            tell(f"{listener.time:.1f} s: {missing} messages were left out: this computer is too slow")
        expected = event.number + 1
        if log is not None:
            with writing(Path(log.name)):
                log.write(Event(logged, event.utime, event.channel, event.data).encode())
            logged += 1
        listener.hear(event)
        if not seen and listener.pose.valid:
            seen = True
            tell(f"{listener.time:.1f} s: the object is seen")
        for descent in listener.descents[told:]:
            tell(f"{listener.time:.1f} s: {_words(descent, listener.pushes)}")
            told += 1
            if descent.kept:
                _keep(recorder, listener)
                if listener.pushes == most:
                    return


def _keep(recorder: PushRecorder, listener: PushListener) -> None:
    try:
        recorder.keep(listener.dataset())
    except OSError as error:
        with writing(Path(error.filename)):
            raise


def _words(descent: Descent, pushes: int) -> str:
    when = f"the finger was down from {descent.begin:.1f} to {descent.end:.1f} s"
    return f"{when}; push {pushes} is kept" if descent.kept else f"{when}; no push: {descent.reason}"


def hearing(listener: PushListener) -> str:
    """What is heard, in a line."""
    heard = listener.heard()
    rates = ", ".join(f"{name} {heard[name].rate:.3g} Hz" for name in HEARD if heard[name].count > 1)
    parts = [rates or "nothing"]
    parts += [f"dropped {sum(h.dropped.values())} of {name}" for name, h in heard.items() if h.dropped]
    silent = listener.silent()
    if silent:
        parts.append(f"nothing good on {', '.join(silent)}")
    else:
        pose = listener.pose
        parts.append("the object is seen" if pose.valid else f"the object is not seen ({pose.reason})")
    return f"{listener.time:.1f} s: {'; '.join(parts)}; pushes: {listener.pushes}"


def listened_json(listener: PushListener) -> dict[str, Any]:
    """What was heard and found, for a JSON file."""
    return {
        "seconds": listener.time,
        "pushes": listener.pushes,
        "descents": [
            {"begin": d.begin, "end": d.end, "kept": d.kept, "reason": d.reason} for d in listener.descents
        ],
        "unfinished": listener.given_up or None,
        "channels": {
            name: {"messages": h.count, "rate": h.rate, "dropped": h.dropped}
            for name, h in listener.heard().items()
        },
    }


def why_none(listener: PushListener) -> str:
    """Why no push was recorded, and what to do."""
    silent = listener.silent()
    if silent:
        heard = [name for name, h in listener.heard().items() if h.count]
        came = f"; what came is {', '.join(heard)}" if heard else ""
        return f"no good message came on {', '.join(silent)}{came}; see that the cell's drivers run there"
    reasons = [descent.reason for descent in listener.descents] + [listener.given_up]
    found = ", ".join(dict.fromkeys(reason for reason in reasons if reason))
    if found:
        return f"the finger was down, but no push was recorded: {found}"
    if not listener.pose.valid:
        return (
            f"the object was not seen ({listener.pose.reason}); see that the scenario's camera is that of the"
            " cell, and let the object rest for two seconds with the arm out of the camera's way"
        )
    return "the finger never came down beside the object"
