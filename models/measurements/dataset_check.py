"""Check a push dataset before any learning: whether the measurements are consistent, and what the pushes
could show."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import Any, Literal

import numpy as np

from slipmap.models.files import plain
from slipmap.models.geometry import angle_between
from slipmap.models.measurements import parsing
from slipmap.models.measurements.bad_rows import sound_rows
from slipmap.models.measurements.contact import (
    CALIBRATION_ERROR,
    FRAME_WRONG,
    ContactRows,
    common_cause,
    contact_rows,
    force_complaint,
    normals_and_forces,
)
from slipmap.models.measurements.importing.clocks import (
    Lag,
    Rise,
    lag_by_rises,
    lag_left,
    middle_of,
    rises_after_touch,
)
from slipmap.models.measurements.importing.force_bias import bias_matters, free_force
from slipmap.models.measurements.motion import rounding_steps, row_noise
from slipmap.models.measurements.push_dataset import PushDataset
from slipmap.models.measurements.reading import was_imported
from slipmap.models.measurements.rim_checks import beyond_table
from slipmap.models.measurements.trial import Channel, Trial
from slipmap.models.measurements.trial_checks import (
    impossible,
    jittering,
    never_near,
    nothing_pushed,
    odd_for_weight,
    pushing_force,
    too_strong,
)
from slipmap.models.measurements.trial_tables import IN_DEGREES, seems_degrees, turns_like_degrees
from slipmap.models.measurements.what_pushes_show import (
    EFFECT_NEEDS,
    Coverage,
    Told,
    coverage_of,
    fast_speed,
    pushes_to_add,
    quantities_shown,
)
from slipmap.models.physics.cell_grid import FloatArray

Verdict = Literal["good", "note", "wrong"]

_MENDED = ("left out", "was cut there into")
"""Words of warnings about what no longer concerns the dataset."""
_KEY = re.compile(r": ((?:object|finger|table|noise|known|gravity)(?:\.\w+)*)\b")
_SUBJECTS = (("the finger goes", "contact"), ("the finger starts", "contact"), ("the force", "force"))
_SLOW_RATE = 20.0  # Hz below which contact is hard to see
_GAP = 0.25  # s without a pose of a moving object
_WRONG_SHARE = 0.25  # share of wrong pushes above which the dataset is wrong
_NOTABLE_LAG = 1e-3  # m between object and finger because of a lag
_LARGEST_SPREAD = 0.5  # of the lags relative to their median, up to which they agree,
_CLOSE_SPREAD = 0.1  # and below which no size in mm explains them
_FEWEST_LAGS = 3  # pushes without which no clock is called wrong,
_LEAST_SHARE = 0.2  # and share of the pushes
_FORCE_LATE = 0.01  # s
_EXPLAINED = 0.25  # share of a force's delay by wrong geometry, from which this is told too
_NO_GEOMETRY = ("force", "noise", "rounding")  # starts of findings that do not shift touches
_NO_COMMON_LAG = "is a frame, the outline or finger.radius wrong, rather than a clock?"
_SHIFT = "add "  # start of advice to correct a clock
_TAKEN = "taken off"  # an import's words about a force's bias
_BIASED = 0.05  # of the force while pushing
_NOISIER = 3.0  # times the declared noise
_FEWEST_NOISY = 30  # rows of a track that show its noise
_MOST_MOTION = 1.5  # times the scatter of every second row, of which more is motion
_COARSE_STEPS = (5e-4, np.radians(0.5))  # m and rad
_OFF_NORMAL = np.radians(25.0)  # median; beyond the friction of most fingers
_NEAR = 0.02  # m of air that a wrong outline or finger may explain


@dataclass(frozen=True)
class Finding:
    """Result of one check."""

    what: str
    found: str  # with numbers and units
    verdict: Verdict  # `wrong` means that anything learned would be wrong
    advice: str = ""  # what to do, if anything


@dataclass(frozen=True)
class DatasetCheck:
    """What `check_dataset` found."""

    dataset: str
    findings: tuple[Finding, ...]
    coverage: Coverage
    quantities: tuple[Told, ...]
    effects: tuple[Told, ...]
    advice: tuple[str, ...]  # which pushes to add, and how
    provenance: tuple[str, ...]

    @property
    def wrong(self) -> bool:
        """Whether anything learned from these pushes would be wrong."""
        return any(finding.verdict == "wrong" for finding in self.findings)

    @property
    def headline(self) -> str:
        """What the findings come to, in a sentence."""
        doubted = dict.fromkeys(one.what for one in self.findings if one.advice)
        if self.wrong:
            wrong = dict.fromkeys(one.what for one in self.findings if one.verdict == "wrong")
            return f"Wrong: {', '.join(wrong)}."
        if doubted:
            return f"The recording is usable, with a doubt about: {', '.join(doubted)}."
        return "The recording is sound."

    def to_json(self) -> dict[str, Any]:
        """For `--json`."""
        return plain({**vars(self), "wrong": self.wrong})


def check_dataset(dataset: PushDataset) -> DatasetCheck:
    """Check whether the measurements are consistent, and what they could show, before any fit.

    Example:
        >>> import slipmap
        >>> from slipmap.models.measurements.dataset_check import check_dataset
        >>> dataset, _ = slipmap.simulated_hammer(seed=1)
        >>> check = check_dataset(dataset)
        >>> check.wrong, check.coverage.pushes
        (False, 10)
    """
    rows = contact_rows(dataset, dataset.trials)
    turned = _in_degrees(dataset, rows)
    findings = [
        *_rates(dataset),
        *_jitter(dataset),
        *_rows_left_out(dataset),
        *_jumps(dataset, turned),
        *_noises(dataset),
    ]
    place = len(findings)
    findings += [*_impossible(dataset), *_table(dataset)]
    # Of pushes in degrees, contact tells nothing but that.
    if right := tuple(trial for trial in dataset.trials if trial.name not in turned):
        judged = replace(dataset, trials=right)
        touching = [one for one in rows if one.trial.name not in turned]
        findings[place:place] = clock = _clock_of_finger(judged, touching)
        place += len(clock)
        findings += [*_depth(judged, touching), *_turning_finger(judged), *_forces(judged, touching)]
    else:
        findings.append(Finding("contact", "not judged, since angles seem to be in degrees", "note"))
    findings += _from_reading(dataset.warnings, findings)
    if right:
        findings[place:place] = _clock_of_force(judged, findings)
    coverage = coverage_of(dataset, rows)
    effects = tuple(
        Told(name, could := shows(coverage), words if could else f"needs {words}")
        for name, (shows, words) in EFFECT_NEEDS.items()
    )
    return DatasetCheck(
        dataset.name, tuple(findings), coverage, tuple(quantities_shown(coverage)), effects,
        tuple(pushes_to_add(coverage)), dataset.provenance,
    )  # fmt: skip


# Consistency of the measurements.


def _from_reading(warnings: Sequence[str], findings: Sequence[Finding]) -> list[Finding]:
    """What the dataset's reading warned of and no other finding says.

    What was left out or cut is mended and a note; anything else is a doubt about its subject.
    """
    found = []
    for text in warnings:
        if _mended(text):
            if not any(text in one.found or text in one.advice for one in findings):
                found.append(Finding("reading", text, "note"))
        elif not any(
            text in (one.found, one.advice) or one.advice.lower() in text.lower()
            for one in findings
            if one.advice
        ):
            places, colon, rest = text.partition(": ")  # several places are parted by "; " too
            fault, _, advice = rest.partition("; ")
            found.append(Finding(_subject(text), places + colon + fault, "note", advice or "is this right?"))
    return found


def _mended(warning: str) -> bool:
    """Whether what a warning is about no longer concerns the dataset."""
    return any(words in warning for words in _MENDED)


def _subject(warning: str) -> str:
    """The key of a dataset.yaml that a warning is about, or else what was recorded."""
    if key := _KEY.search(warning):
        return key[1]
    return next((subject for words, subject in _SUBJECTS if words in warning), "reading")


def _turning_finger(dataset: PushDataset) -> list[Finding]:
    turns = [np.ptp(trial.tip_angle.values) for trial in dataset.trials if trial.tip_angle is not None]
    if not turns:
        return []
    text = f"turns by up to {np.degrees(max(turns)):.0f}° in {len(turns)} of {len(dataset.trials)} pushes"
    return [Finding("finger", f"{text}, and so rolls along the object", "note", "is that its angle?")]


def _rates(dataset: PushDataset) -> list[Finding]:
    findings = []
    for name, words in (("object_pose", "poses"), ("tip_pose", "finger"), ("ft_wrench", "force")):
        steps = [
            np.diff(channel.time)
            for trial in dataset.trials
            if (channel := trial.channels.get(name)) is not None and len(channel.time) > 2
            and not (name == "object_pose" and trial.ends_only)
        ]  # fmt: skip
        if not steps:
            if name == "ft_wrench":
                findings.append(Finding("force", "was not measured", "note"))
            continue
        all_steps = np.concatenate(steps)
        rate = 1.0 / float(np.median(all_steps))
        text = f"{rate:.0f} Hz, longest gap {1e3 * all_steps.max():.0f} ms"
        blind = [
            trial.name
            for trial in dataset.trials
            if name == "object_pose" and not trial.ends_only and _longest_blind_motion(trial) > _GAP
        ]
        advice = ""
        if round(rate) < _SLOW_RATE:  # as it is told; stamps are rounded
            advice = f"below {_SLOW_RATE:g} Hz, touch and release are hard to see; record at a higher rate"
        elif blind:
            advice = f"no pose for more than {1e3 * _GAP:.0f} ms of motion in {parsing.listed(blind)}"
        findings.append(Finding(f"rate of {words}", text, "note" if advice else "good", advice))
    return findings


def _jitter(dataset: PushDataset) -> list[Finding]:
    """A finding if stamps jitter though rows are evenly spaced."""
    found = jittering(dataset.trials)
    return [] if found is None else [Finding("jitter of stamps", found[0], "wrong", found[1])]


def _longest_blind_motion(trial: Trial) -> float:
    """The longest time between poses in which the object moves, s."""
    pose = trial.object_pose
    moved = np.hypot(*np.diff(pose.values[:, :2], axis=0).T) > 1e-3
    return float(np.max(np.diff(pose.time)[moved], initial=0.0))


def _rows_left_out(dataset: PushDataset) -> list[Finding]:
    """Flips, zeros and stamps that go back, as found on reading and importing."""
    texts = dict.fromkeys((*filter(_mended, dataset.warnings), *dataset.provenance))
    found = []
    for what, words in (
        ("flips", ("theta turns", "jumps")),
        ("zeros", ("is exactly", "stands at one place", "repeats the pose")),
        ("stamps", ("go back", "have the stamp of the row before", "are far from those")),
    ):
        named = [text for text in texts if any(word in text for word in words)]
        more = f"; {len(named) - 1} more" if len(named) > 1 else ""
        found.append(Finding(what, named[0] + more, "note") if named else Finding(what, "none", "good"))
    return found


def _in_degrees(dataset: PushDataset, rows: Sequence[ContactRows]) -> set[str]:
    """Names of pushes that turn like degrees, or exceed two turns, if contact of these does not fit."""
    large = {trial.name for trial in dataset.trials if seems_degrees(trial.object_pose.values)}
    if any(one.depth > one.allowed for one in rows if one.trial.name in large):
        return large
    return {trial.name for trial in dataset.trials if turns_like_degrees(trial.object_pose.values)}


def _jumps(dataset: PushDataset, turned: set[str]) -> list[Finding]:
    """A finding if more than a quarter of the tracks jump to another place, or are in degrees (`turned`).

    An object that was spun and let go may turn like that, so only pushes with a finger are wrong.
    """
    found = []
    if_so = next((text.partition(IN_DEGREES)[2] for text in dataset.warnings if IN_DEGREES in text), "")
    for what, told, advice in (
        (
            "jumps",
            lambda trial: sound_rows(trial.object_pose.time, trial.object_pose.values)[2],
            "did the tracker's frame jump?",
        ),
        (
            "angles",
            lambda trial: trial.name in turned and seems_degrees(trial.object_pose.values),
            f"{IN_DEGREES[0].lower()}{IN_DEGREES[1:]}{if_so}",
        ),
    ):
        pushed = [trial for trial in dataset.trials if what == "jumps" or trial.finger_near(dataset.reach)]
        verdicts: tuple[tuple[Verdict, Sequence[Trial]], ...] = (("wrong", pushed), ("note", dataset.trials))
        for verdict, trials in verdicts:
            texts = [text for trial in trials if (text := told(trial))]
            if len(texts) > _WRONG_SHARE * len(trials):
                text = f"{texts[0]}; in {len(texts)} of {len(trials)} pushes"
                found.append(Finding(what, text, verdict, advice))
                break
    return found


def _noises(dataset: PushDataset) -> list[Finding]:
    """Rounding of the poses, and scatter of rows that contradicts the declared noise."""
    dense = [one.object_pose for one in dataset.trials if len(one.object_pose.time) >= _FEWEST_NOISY]
    steps = rounding_steps([pose.values for pose in dense])
    scatters = [row_noise(pose.time, pose.values) for pose in dense]
    # Motion between rows grows with their distance, noise does not.
    every_second = [row_noise(pose.time[::2], pose.values[::2]) for pose in dense]
    scatter = np.median(scatters or np.zeros((1, 3)), axis=0)
    motion = np.median(every_second or np.zeros((1, 3)), axis=0) > _MOST_MOTION * scatter
    scatter = np.where(motion, 0.0, scatter)
    free = [
        float(np.max(error)) * np.sqrt(max(count / 10.0, 1.0))
        for _, (_, error, count) in _free_forces(dataset)
    ]
    # Contact chatters; and with wrong frames, contact may seem free.
    wrenches = [one.ft_wrench for one in dataset.trials if one.ft_wrench is not None]
    rough = [row_noise(wrench.time, wrench.values[:, :2]).max() for wrench in wrenches]
    force = min(np.median(free or [0.0]), np.median(rough or [0.0]))
    noise, degree = dataset.noise, float(np.radians(1.0))
    findings = []
    for what, key, si, unit, size, declared, seen, step, coarse in (
        ("positions", "position", "m", "mm", 1e-3, noise.position, max(scatter[:2]), max(steps[:2]), 0),
        ("angles", "angle", "rad", "°", degree, noise.angle, scatter[2], steps[2], 1),
        ("forces without contact", "force", "N", "N", 1.0, noise.force, force, 0.0, 0),
    ):
        space = "" if unit == "°" else " "
        if step:
            text = f"{what} come in steps of {step / size:.2g}{space}{unit}"
            least = step / np.sqrt(12.0)
            advice = ""
            if declared is not None and declared < least:
                advice = f"noise.{key} must be {least:.2g} {si} or more: rounding alone makes as much"
            elif step > _COARSE_STEPS[coarse]:
                advice = "were they rounded on export? Keep all digits"
            findings.append(Finding("rounding", text, "note", advice))
        elif declared is not None and seen > _NOISIER * declared:
            text = (
                f"{what} scatter by {seen / size:.2g}{space}{unit} from row to row, but noise.{key} says"
                f" {declared / size:.2g}{space}{unit}"
            )
            findings.append(
                Finding("noise", text, "note", f"should noise.{key} be {seen:.2g} {si}, or is a unit wrong?")
            )
    return findings


def _tracked(dataset: PushDataset) -> list[Trial]:
    """Pushes whose object was seen on the way, with a finger near it."""
    return [one for one in dataset.trials if not one.ends_only and one.finger_near(dataset.reach)]


def _clock_of_finger(dataset: PushDataset, rows: Sequence[ContactRows]) -> list[Finding]:
    """Clock of the finger relative to the object, from contact; empty if it does not show."""
    pushes = _tracked(dataset)
    found = [(one, lag_left(dataset, one.object_pose, one.tip_pose)) for one in pushes]
    shown = [(trial, lag) for trial, lag in found if lag is not None]
    if not shown:
        return []
    speed = float(np.median([fast_speed(trial) for trial, _ in shown]))
    return [_lag_of_finger(dataset, rows, [lag for _, lag in shown], speed, len(pushes))]


def _free_forces(dataset: PushDataset) -> list[tuple[Channel, tuple[FloatArray, FloatArray, int]]]:
    """The force of each push that shows what its sensor reads without contact, and that (`free_force`)."""
    return [
        (one.ft_wrench, free)
        for one in _tracked(dataset)
        if one.ft_wrench is not None
        and (free := free_force(dataset, one.object_pose, one.tip_pose, one.ft_wrench)) is not None
    ]


def _clock_of_force(dataset: PushDataset, findings: Sequence[Finding]) -> list[Finding]:
    """Clock of the force relative to object and finger, from touches; empty if there are none.

    A wrong outline, radius or frame also shifts the times of touch, so that a delay calls for advice only if
    no other finding doubts these. If the gap left while pushing would explain it too, both are told.
    """
    rises: list[Rise] = []
    for trial in _tracked(dataset):
        if trial.ft_wrench is not None:
            rises += rises_after_touch(dataset, trial.object_pose, trial.tip_pose, trial.ft_wrench)
    if not rises:
        return []
    what = "clock of the force"
    force = next(trial.ft_wrench for trial in dataset.trials if trial.ft_wrench is not None)
    lag = lag_by_rises([one.delay for one in rises], force)
    touches = f"{len(rises)} touch{'es' if len(rises) > 1 else ''}"
    text = f"force {_late(lag.value)} relative to the touch, ± {1e3 * lag.error:.1f} ms, {touches}"
    if not lag.sure or abs(lag.value) <= _FORCE_LATE:
        return [Finding(what, text, "good")]
    if len(rises) < _FEWEST_LAGS:
        return [Finding(what, f"{text}, too few to judge by", "note")]
    explained = -float(np.median([one.explained for one in rises]))
    looks_so = explained / lag.value > _EXPLAINED
    doubted = [one.what for one in findings if _doubts_geometry(one)]
    if looks_so:
        doubted += [one.what for one in findings if one.what == "clock of the finger" and one.advice]
    if doubted:
        return [Finding(what, f"{text}, which may come from what is wrong with: {doubted[0]}", "note")]
    if looks_so:
        gap = float(np.median([one.gap for one in rises]))
        apart = f"{1e3 * abs(gap):.1f} mm of {'air' if gap > 0.0 else 'depth'} while pushing"
        size = "large" if gap < 0.0 else "small"
        advice = (
            f"is the outline, or finger.radius, about {1e3 * abs(gap):.1f} mm too {size}, is a frame wrong,"
            f" or is the force {_late(lag.value)}? See which before you change the force's clock"
        )
        return [Finding(what, f"{text}; {apart} would look {_late(explained)}", "note", advice)]
    return [Finding(what, text, "note", _shifted(dataset, ("ft_wrench", lag.value)))]


def _doubts_geometry(finding: Finding) -> bool:
    """Whether a finding doubts the outline, the finger or a frame."""
    of_clock = finding.what.startswith("clock") and finding.advice.startswith(_SHIFT)
    if not finding.advice or of_clock or finding.what.startswith(_NO_GEOMETRY):
        return False
    return finding.what != "reading" or "frame" in finding.advice


def _lag_of_finger(
    dataset: PushDataset, rows: Sequence[ContactRows], lags: Sequence[Lag], speed: float, pushes: int
) -> Finding:
    """What the lags of some of the pushes come to.

    A wrong frame, outline or radius also looks like lags, but these differ from push to push.

    Args:
        speed: of the object, m/s.
        pushes: number of pushes that could have shown a lag.
    """
    what, values = "clock of the finger", [lag.value for lag in lags]
    middle, error = middle_of(values)
    several = len(lags) >= _FEWEST_LAGS
    spread = error * np.sqrt(len(lags)) / max(abs(middle), 1e-9)
    error = max(error, float(np.median([lag.error for lag in lags])))
    apart = abs(middle) * speed
    apart_in_time = f"finger {_late(middle)} relative to the object"
    if _late(middle) != _late(0.0):
        apart_in_time = f"finger {_late(middle)}, or equally the tracker {_late(-middle)}"
    text = f"{apart_in_time}, ± {1e3 * error:.1f} ms"
    if abs(middle) <= 3.0 * error or apart <= _NOTABLE_LAG:
        return Finding(what, text, "good")
    size = "large" if middle > 0.0 else "small"
    found = f"{text}, or finger.radius or the outline {1e3 * apart:.1f} mm too {size}"
    advice = _shifted(dataset, ("object_pose", -middle), ("tip_pose", middle))
    cause = common_cause(dataset, rows, len(rows))
    close = several and spread < _CLOSE_SPREAD
    if cause is not None and (cause.kind in FRAME_WRONG or (cause.kind != "lag" and not close)):
        return Finding(what, found if cause.kind == "radius" else text, "note", cause.text)
    air = [float(np.median(one.gap[one.pressed])) for one in rows if one.pressed.any()]
    most_air = 2.0 * (apart + CALIBRATION_ERROR)  # a lag leaves as much air as the finger moves in it
    if air and float(np.median(air)) > most_air:
        return Finding(what, text, "note", _NO_COMMON_LAG)
    if cause is None and len(lags) < _LEAST_SHARE * pushes:
        return Finding(what, f"{text}, from only {len(lags)} of {pushes} pushes", "note")
    if cause is None and spread > _LARGEST_SPREAD:
        span = f"{_late(min(values))} to {_late(max(values))}"
        return Finding(what, f"{text}, but the finger {span} in single pushes", "note", _NO_COMMON_LAG)
    return Finding(what, found, "wrong" if several and apart > CALIBRATION_ERROR else "note", advice)


def _shifted(dataset: PushDataset, *shifts: tuple[str, float]) -> str:
    """Advice to correct a clock by one of these shifts (channel, s), with the key to change."""
    edited = _files_to_edit(dataset)
    key = "t of each row" if edited else "`clock`"
    keys = [f"{shift:.3f} s to {key} of {channel}" for channel, shift in shifts]
    return f"{_SHIFT}{', or '.join(keys)}, {edited or _by_import(dataset)}"


def _files_to_edit(dataset: PushDataset) -> str:
    """Where each channel has stamps of its own that can be edited, as words; empty if only an import can.

    An import would be undone by editing its result, the channels of a CSV file share one column of stamps,
    and HDF5 is not text.
    """
    names = [PurePosixPath(trial.name) for trial in dataset.trials]
    if was_imported(dataset.provenance) or any(name.suffix.lower() != ".json" for name in names):
        return ""
    return f"in every push ({parsing.listed(sorted({str(name.with_name('*.json')) for name in names}))})"


def _by_import(dataset: PushDataset) -> str:
    """How a key of a setup.yaml comes into effect, for pushes that are not to be edited."""
    if was_imported(dataset.provenance):
        return "in the setup.yaml, and import again"
    return "in a setup.yaml, and read the files with slipmap import"


def _late(lag: float) -> str:
    """A lag in words, given what has to be added to the stamps."""
    if abs(lag) < 5e-4:
        return "0 ms"
    return f"{1e3 * abs(lag):.0f} ms {'early' if lag > 0 else 'late'}"


def _impossible(dataset: PushDataset) -> list[Finding]:
    """A finding if more than a quarter of the records cannot be those of pushes."""
    found = [fault for trial in dataset.trials for fault in [*impossible(dataset, trial)][:1]]
    if len(found) <= _WRONG_SHARE * len(dataset.trials):
        return []
    text = f"not possible in {len(found)} of {len(dataset.trials)} pushes"
    return [Finding("units and frames", text, "wrong", max(found, key=found.count))]


def _table(dataset: PushDataset) -> list[Finding]:
    """A finding if the declared table could not carry the object, or if it fell."""
    said, share = beyond_table(dataset, dataset.trials)
    if said is None:
        return []
    found, _, advice = said.partition("; ")
    return [Finding("table", found, "wrong" if share > _WRONG_SHARE else "note", advice)]


def _depth(dataset: PushDataset, rows: Sequence[ContactRows]) -> list[Finding]:
    if (away := never_near(dataset, dataset.trials)) is not None:
        return [Finding("contact", away[0], "wrong", away[1])]
    if not rows:
        return [Finding("contact", "no finger comes within 1 m of the object", "note")]
    if nothing_pushed(dataset, dataset.trials):
        found = "no object moves, and no finger reaches one in any push"
        asked = "are the units and frames of object_pose and tip_pose right?"
        return [Finding("contact", found, "wrong", asked)]
    depth = np.array([one.depth for one in rows])
    air = [float(np.median(one.gap[one.pressed])) for one in rows if one.pressed.any()]
    deep = depth > [one.allowed for one in rows]
    text = f"finger at most {1e3 * max(0.0, float(depth.max())):.1f} mm inside the outline"
    middle = float(np.median(air)) if air else 0.0
    if air:
        text += f", {1e3 * abs(middle):.1f} mm of {'depth' if middle < -5e-5 else 'air'} while pushing"
    if deep.any():
        said = (text for text in dataset.warnings if not _mended(text) and _subject(text) == "contact")
        advice = next(said, None) or (
            "check theta's sign, the frames, the clocks, which point of the finger was recorded, and"
            " finger.radius"
        )
        text += f"; too deep in {deep.sum()} of {len(rows)} pushes"
        return [Finding("contact", text, "wrong" if deep.mean() > _WRONG_SHARE else "note", advice)]
    if middle > 2.0 * CALIBRATION_ERROR:
        near = middle < _NEAR
        advice = "is finger.radius, or the outline, too small?" if near else "is a frame or a clock wrong?"
        return [Finding("contact", text, "note", advice)]
    return [Finding("contact", text, "good")]


def _forces(dataset: PushDataset, rows: Sequence[ContactRows]) -> list[Finding]:
    forced = [one for one in dataset.trials if one.ft_wrench is not None and one.finger_near(dataset.reach)]
    if not forced:
        return []
    findings = []
    rest = _free_forces(dataset)
    pushing = pushing_force(dataset, forced) or 0.0
    if (strong := too_strong(dataset, forced)) is not None:
        findings.append(Finding("force and size", strong[0], "wrong", strong[1]))
    if (odd := odd_for_weight(dataset, forced)) is not None:
        findings.append(Finding("force and mass", odd.found, "wrong" if odd.far else "note", odd.advice))
    if rest:
        bias = np.median([value for _, (value, _, _) in rest], axis=0)
        error = np.median([error for _, (_, error, _) in rest], axis=0) / np.sqrt(len(rest))
        size = float(np.hypot(*bias))
        matters = size > _BIASED * pushing and bias_matters(bias, error, rest[0][0])
        text = f"({bias[0]:.3f}, {bias[1]:.3f}) N, {size:.2f} N, compared with {pushing:.2g} N while pushing"
        gone = [
            text.partition("ft_wrench: ")[2]
            for text in dataset.provenance
            if _TAKEN in text and "bias" in text
        ]
        if gone:
            text += f"; on import: {gone[0]}{f', and {len(gone) - 1} more' if len(gone) > 1 else ''}"
        edited = _files_to_edit(dataset)
        advice = (
            f"remove it from fx and fy of each row of ft_wrench, {edited}"
            if edited
            else f"subtract it with ft_wrench.offset {_by_import(dataset)}; slipmap import subtracts it by"
            " itself if there are rows before the touch"
        )
        verdict: Verdict = "wrong" if matters else "note" if gone else "good"
        findings.append(Finding("force at rest", text, verdict, advice if matters else ""))
    normal, force, _ = normals_and_forces(dataset, rows)
    if len(force) >= 10:
        off = angle_between(force, normal)
        middle = float(np.median(np.abs(off)))
        text = f"median {np.degrees(middle):.0f}° off the contact normal over {len(force)} rows"
        turned = "is its frame rotated? Fingers seldom have this much friction"
        complaint = force_complaint(dataset, rows)
        advice = complaint or (turned if middle > _OFF_NORMAL else "")
        verdict = "wrong" if complaint else "note" if advice else "good"
        findings.append(Finding("force's direction", text, verdict, advice))
    return findings
