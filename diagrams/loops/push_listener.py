"""Records pushes from the messages of a cell that somebody else drives, in the order of their stamps.

`PushListener` reads messages and finds the pushes; `record_pushes` writes them one by one.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from slipmap.diagrams.hardware import network
from slipmap.diagrams.hardware.checked_messages import BadMessage, Received, check_stamp, rules
from slipmap.diagrams.hardware.interface import HeardCell
from slipmap.diagrams.hardware.mcap_log import McapLog
from slipmap.diagrams.hardware.message_stream import TICK, Event, LcmLog
from slipmap.diagrams.hardware.network import ARM, CAMERA, NEEDED
from slipmap.diagrams.loops.exploration_loop import connect, recorded_dataset
from slipmap.diagrams.loops.run_folder import keep_trials
from slipmap.diagrams.perception.cell_perception import CellPerception
from slipmap.diagrams.perception.sight import ArmAside
from slipmap.diagrams.station.arm import arm_model
from slipmap.diagrams.station.scenario import Scenario
from slipmap.diagrams.systems.finger import FingerSense
from slipmap.diagrams.systems.measurement_logger import PERIOD, MeasurementLogger
from slipmap.diagrams.systems.push_finder import Descent, PushFinder
from slipmap.models.files import writing
from slipmap.models.measurements import PushDataset
from slipmap.models.measurements.writing import PushRecorder
from slipmap.models.perception.seen_object import ObservedPose

HEARD = (*ARM, *CAMERA)  # channels from which pushes are detected
EVERY = 4  # every 4th push is held out for judging; the others are for learning

# Most that the clock advances between two messages of the arm, s: what precedes a longer silence is unrelated
# to what follows it.
_LONGEST_SILENCE = 2.0


@dataclass(frozen=True)
class Heard:
    """Statistics of a channel."""

    count: int  # messages, good and bad
    rate: float  # messages per second while they came; 0 for fewer than two
    dropped: Mapping[str, int]  # bad messages, by cause


class PushListener:
    """Reads messages and finds the pushes in them.

    Its diagram has the exploration loop's blocks for perception and recording (`CellPerception`,
    `MeasurementLogger`), with a `PushFinder` in place of executor and supervisor. Its clock follows the arm's
    stamps: nothing depends on when a message arrived or how long its processing took, so the same messages in
    the same order give bit-identical pushes. It sends nothing.

    Args:
        scenario: of the cell; its object is not used.
        cells: wanted number of cells.
    """

    def __init__(self, scenario: Scenario, name: str, cells: int = 60) -> None:
        self._scenario, self._name = scenario, name
        camera = scenario.camera
        self._status = rules(camera.width, camera.height_pixels)[network.IIWA_STATUS]
        builder = DiagramBuilder()
        self._cell = cell = builder.AddSystem(HeardCell(scenario))
        self._perception = see = builder.AddSystem(CellPerception(camera, cells, cell.arm_hulls))
        sense = builder.AddSystem(FingerSense(arm_model(models=scenario.arm.models)))
        aside = builder.AddSystem(ArmAside(camera.intrinsics, cell.arm_hulls))
        self._finder = finder = builder.AddSystem(PushFinder(scenario.execution.finger_radius))
        self._logger = logger = builder.AddSystem(MeasurementLogger(fit=10**9))
        connect(
            builder,
            [
                (cell, "camera.depth_image", (see, "depth_image")),
                (cell, "camera.X_WC", (see, "X_WC"), (aside, "X_WC")),
                (cell, "camera.age", (see, "image_age")),
                (cell, "iiwa.position_measured", (see, "arm_position"), sense, (aside, "arm_position")),
                (cell, "iiwa.torque_external", sense),
                (cell, "iiwa.age", (finder, "tip_age"), (logger, "tip_age")),
                (cell, "gripper.state_measured", finder),
                (see, "object_pose", aside, finder, logger),
                (see, "seen_object", aside, finder),
                (aside, "aside", finder),
                (sense, "tip_pose", finder, logger),
                (sense, "tip_force", logger),
                (finder, "execution", logger),
                (finder, "status", logger),
                (logger, "trials", finder),
            ],
        )
        self._simulator = Simulator(builder.Build())
        self._root = self._simulator.get_mutable_context()
        self._begin = self._last = np.nan  # stamps of the arm: of time 0, and the newest
        self._came: Counter[str] = Counter()
        self._times: dict[str, tuple[int, int]] = {}

    def hear(self, event: Event) -> None:
        """Process a message; those of channels outside `HEARD` are only counted."""
        self._came[event.channel] += 1
        first, _ = self._times.get(event.channel, (event.utime, 0))
        self._times[event.channel] = (first, event.utime)
        if event.channel == network.IIWA_STATUS and not self._go_on(event.data):
            return
        if event.channel in HEARD:
            checked = self._cell.checked[event.channel]
            checked.hear(event.data)
            checked.take(checked.GetMyMutableContextFromRoot(self._root))

    def _go_on(self, data: bytes) -> bool:
        """Advance time to when the arm's message was sent; returns whether to process it: if it is `PERIOD`
        later than the last one processed, or bad."""
        try:
            _, stamp = self._status.read(data)
            check_stamp(stamp, self._last)
        except BadMessage:
            return True
        if not np.isfinite(self._last):
            # Half a period away from the blocks' updates, so that there is one between two messages.
            self._begin, self._last = stamp - 0.5 * PERIOD, stamp
        self._begin += max(stamp - self._last - _LONGEST_SILENCE, 0.0)
        self._last = stamp
        if self.time > 0.0 and stamp - self._begin < self.time + PERIOD - 1e-6:
            return False
        self._simulator.AdvanceTo(stamp - self._begin)
        return True

    @property
    def time(self) -> float:
        """Time of the arm's clock since its first message, without long silences, s."""
        return float(self._root.get_time())

    @property
    def pose(self) -> ObservedPose:
        """Pose of the object as the camera sees it."""
        return self._said(self._perception, "object_pose")

    @property
    def descents(self) -> tuple[Descent, ...]:
        """Periods during which the finger was down, with their outcomes."""
        return self._said(self._finder, "descents")

    @property
    def given_up(self) -> str:
        """Why the finger's present motion is not a push yet; empty if it is up."""
        return self._finder.given_up(self._finder.GetMyContextFromRoot(self._root))

    @property
    def pushes(self) -> int:
        """Number of recorded pushes."""
        return len(self._said(self._logger, "trials"))

    def dataset(self) -> PushDataset:
        """The recorded pushes.

        Raises:
            DatasetError: there are none.
        """
        trials = [
            replace(trial, role="heldout" if (number + 1) % EVERY == 0 else "fit")
            for number, trial in enumerate(self._said(self._logger, "trials"))
        ]
        grid = self._said(self._perception, "cell_grid")
        return replace(recorded_dataset(trials, grid, self._scenario), name=self._name)

    def heard(self) -> dict[str, Heard]:
        """Statistics of every channel so far."""
        received: Mapping[str, Received] = self._cell.checked.received(self._root)
        result = {}
        for channel in (*HEARD, *sorted(self._came.keys() - set(HEARD))):
            count = self._came[channel]
            first, last = self._times.get(channel, (0, 0))
            rate = (count - 1) / (1e-6 * (last - first)) if last > first else 0.0
            dropped = received[channel].dropped if channel in received else {}
            result[channel] = Heard(count, rate, dict(dropped))
        return result

    def silent(self) -> list[str]:
        """Required channels on which no valid message has come."""
        received = self._cell.checked.received(self._root)
        return [channel for channel in NEEDED if not received[channel].good]

    def _said(self, block: Any, port: str) -> Any:
        return block.GetOutputPort(port).Eval(block.GetMyContextFromRoot(self._root))


Tell = Callable[[str], None]
_TOLD_EVERY = 10.0  # s between two status lines


def record_pushes(
    events: Iterable[Event],
    listener: PushListener,
    recorder: PushRecorder,
    tell: Tell,
    *,
    log: LcmLog | McapLog | None = None,
    most: int | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> None:
    """Listen until the events end, enough pushes are recorded, or it is stopped.

    Args:
        recorder: where each push goes as soon as it is over.
        tell: called with a line when the object is first seen, after each descent of the finger, and
            regularly.
        log: where all events go unchanged, if anywhere.
        most: number of pushes after which to end, if any.
        stopped: whether to end; called at every event.

    Raises:
        BadLog, HardwareError: from the events.
        BadInput: the disk is full or the place not writable; names the file.
    """
    seen, described, spoke, expected = False, 0, None, 0
    for event in events:
        if stopped():
            return
        spoke = event.utime if spoke is None else spoke
        if event.utime - spoke > 1e6 * _TOLD_EVERY:
            spoke = event.utime
            tell(hearing(listener))
        if event.channel == TICK:
            continue
        if event.number > expected > 0:
            missing = event.number - expected
            tell(f"{listener.time:.1f} s: {missing} messages were dropped, because this computer is too slow")
        expected = event.number + 1
        if log is not None:
            with writing(Path(log.name)):
                log.write(event)
        listener.hear(event)
        if not seen and listener.pose.valid:
            seen = True
            tell(f"{listener.time:.1f} s: the object is seen")
        for descent in listener.descents[described:]:
            tell(f"{listener.time:.1f} s: {_words(descent, listener.pushes)}")
            described += 1
            if descent.kept:
                keep_trials(recorder, listener.dataset())
                if listener.pushes == most:
                    return


def _words(descent: Descent, pushes: int) -> str:
    when = f"the finger was down from {descent.begin:.1f} to {descent.end:.1f} s"
    return f"{when}; push {pushes} is kept" if descent.kept else f"{when}; not a push: {descent.reason}"


def hearing(listener: PushListener) -> str:
    """One line about the messages received."""
    heard = listener.heard()
    rates = ", ".join(f"{name} {heard[name].rate:.3g} Hz" for name in HEARD if heard[name].count > 1)
    parts = [rates or "nothing"]
    parts += [f"dropped {sum(h.dropped.values())} of {name}" for name, h in heard.items() if h.dropped]
    silent = listener.silent()
    if silent:
        parts.append(f"no valid message on {', '.join(silent)}")
    else:
        pose = listener.pose
        parts.append("the object is seen" if pose.valid else f"the object is not seen ({pose.reason})")
    return f"{listener.time:.1f} s: {'; '.join(parts)}; pushes: {listener.pushes}"


def listened_json(listener: PushListener) -> dict[str, Any]:
    """Messages received and pushes found, for a JSON file."""
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
        came = f" (messages came on {', '.join(heard)})" if heard else ""
        return f"no valid message came on {', '.join(silent)}{came}; check that the cell's drivers run"
    reasons = [descent.reason for descent in listener.descents] + [listener.given_up]
    found = ", ".join(dict.fromkeys(reason for reason in reasons if reason))
    if found:
        return f"the finger was down, but no push was recorded: {found}"
    if not listener.pose.valid:
        return (
            f"the object was not seen ({listener.pose.reason}); check that the scenario's camera is the"
            " cell's, and let the object rest for two seconds with the arm out of the camera's view"
        )
    return "the finger never came down beside the object"
