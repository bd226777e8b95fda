"""Check trials against geometry, units and each other: unusable ones are refused, odd ones reported."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import shapely

from slipmap.models.geometry import placed
from slipmap.models.measurements import parsing
from slipmap.models.measurements.bad_rows import without_force_spikes
from slipmap.models.measurements.contact import (
    CALIBRATION_ERROR,
    FRAME_WRONG,
    Cause,
    ContactRows,
    common_cause,
    contact_rows,
    force_complaint,
)
from slipmap.models.measurements.foreign_frames import exchanged, frame_change
from slipmap.models.measurements.motion import row_noise, spread_rows, stamp_jitter
from slipmap.models.measurements.push_dataset import LEAST_PER_AREA, MOST_PER_AREA, Setup, gaps
from slipmap.models.measurements.rim_checks import beside_table, beyond_table
from slipmap.models.measurements.sessions import carried_text, carries
from slipmap.models.measurements.trial import Channel, DatasetError, Trial
from slipmap.models.measurements.trial_tables import seems_degrees
from slipmap.models.physics.cell_grid import FloatArray

_LARGEST_SPEED = 10.0  # m/s
_SPEED_WINDOW = 0.1  # s; time stamps jitter too much for row-by-row speeds
_SLOWEST_RATE = 2.0  # s between rows
_NOTABLE_MOTION = 5e-3  # m
_REST_ROWS = 3  # first rows of a track that show whether the object rests
_TOUCH_RADII = 3.0  # finger radii of air beyond which the finger did not touch
_EARLY_END = 0.1  # s
_SLOW_TIP = 5e-3  # m/s
_THROUGH = 0.01  # m
_FEWEST_FORCES = 3  # rows that show which way a force points
_MOST_ROWS = 500  # of a track, compared with the outline
_LONERS = 10  # one push in this many may be left out, at least one,
_FEWEST_TRIALS = 5  # if there are at least this many
_ALONE = 1.5  # times as deep, or as far away, as the other pushes
_NEVER_NEAR = 0.03  # m of air that no wrong outline, finger or clock explains
_UNSEEN = 0.15  # s between rows in which a finger may come and go
_MANY_LENGTHS = 5.0  # of the outline, travelled in a push; beyond, a unit of length is wrong
_FAR, _TIMES_FARTHER = 3.0, 50.0  # m, and times the others' median, that no object is pushed

_DENSE = 20  # rows of a push, from which their scatter and spacing are judged
_OVERSTATED = 10.0  # times the scatter of the rows, and more than
_WORST_TRACKER = (5e-3, 0.05)  # m and rad, which is no noise of a tracker

_LEAST_FRICTION, _MOST_FRICTION = 0.01, 10.0  # force of a push per weight; beyond, a unit is wrong
SELDOM_LESS, SELDOM_MORE = 0.05, 1.5  # the same; beyond, this is a doubt

_PULLS = (
    "the force points against the finger's motion, as if it pulled. ft_wrench must be the force of the finger"
    " on the object; is its sign reversed?"
)
_NOT_NEAR = (
    "a resting object begins to move, but no finger comes within 1 m of its outline; is the tip given in m?"
)
_FORCED = "to keep it, set `keep: true` beside its file in dataset.yaml, or keep_all=True in Python"


def check_trials(
    setup: Setup,
    trials: Sequence[Trial],
    where: str,
    keep: Callable[[Trial], bool | None] = lambda trial: None,
    imported: bool = False,
) -> tuple[list[Trial], list[str]]:
    """The trials that stay, and one warning per kind of fault, naming its trials.

    Faults common to all pushes are reported and kept, since an effect may explain them. Single faulty pushes
    are left out while the others are sound.

    Args:
        keep: True for a trial that stays whatever is found, False for one that goes, None to judge it.
        imported: whether an import wrote the trials, which refuses equal files but not equal pushes in one.

    Raises:
        DatasetError: two equal files, channels without a common time, or pushes in which the object is
            carried while the finger is away.
    """
    chosen = [trial for trial in trials if keep(trial) is not False]
    if not chosen:
        raise DatasetError(f"{where}: every trial says `keep: false`; at least one push is needed")
    warnings = _copies(chosen, where, imported)
    chosen, spikes = without_force_spikes(chosen)
    warnings += spikes
    doubts = [(trial.name, fault) for trial in chosen for fault in _faults(setup, trial, where)]
    # A frozen tracker or degrees for rad are reported already; do not report their consequences.
    sound = [
        one for one in chosen if not _stands_still(setup, one) and not seems_degrees(one.object_pose.values)
    ]
    seen = contact_rows(setup, sound)
    odd, told, frame_wrong = _judged(setup, chosen, seen, where, lambda trial: bool(keep(trial)))
    found: dict[str, list[str]] = {}  # what was left out concerns the dataset no longer
    for name, fault in doubts:
        if name not in odd:
            found.setdefault(fault, []).append(name)
    complaint = None if frame_wrong else force_complaint(setup, seen)
    if complaint is not None:
        found.pop(_PULLS, None)  # the complaint is its cause
        told.append(f"{where}: {complaint}")
    if (first := exchanged(setup, seen)) is not None:
        told.append(f"{where}: {first}")
    elif not frame_wrong and (change := frame_change(setup, seen)) is not None:
        told.append(f"{where}: {change.words}")
    if (away := never_near(setup, chosen)) is not None:
        found.pop(_NOT_NEAR, None)  # the same, push by push
        told.append(f"{where}: {'; '.join(away)}")
    odd_force = odd_for_weight(setup, chosen)
    if odd_force is not None and odd_force.wrong_force:
        told.append(f"{where}: ft_wrench is {odd_force.found}; {odd_force.advice}")
    doubted = too_strong(setup, chosen), jittering(chosen), _overstated_noise(setup, chosen), _counted(chosen)
    for doubt in doubted:
        told += [f"{where}: {'; '.join(doubt)}"] if doubt else []
    warnings += [f"{parsing.listed(names)}: {fault}" for fault, names in found.items()] + told
    chosen = [trial for trial in chosen if trial.name not in odd]
    if (off := beyond_table(setup, chosen)[0]) is not None:
        warnings.append(f"{where}: {off}")
    if not any(trial.role == "fit" for trial in chosen):
        warnings.append(f"{where}: every trial is heldout; there is nothing to learn from")
    return chosen, warnings


def contradicted_by_contact(setup: Setup, trials: Sequence[Trial]) -> bool:
    """Whether the measured force points where no finger friction allows, on most rows of these trials."""
    return force_complaint(setup, contact_rows(setup, trials)) is not None


def never_near(setup: Setup, trials: Sequence[Trial]) -> tuple[str, str] | None:
    """What is odd, and what to do, if objects and fingers move but no finger comes within 1 m; else None.

    Lengths in cm or inches look like this. A finger that does not move, or is not given, may be absent.
    """
    if any(trial.finger_near(setup.reach) for trial in trials):
        return None
    both = [
        trial
        for trial in trials
        if _moved(setup, trial) and np.ptp(trial.tip_pose.values, axis=0).max() > _NOTABLE_MOTION
    ]
    if len(both) <= len(trials) / 2:
        return None
    way = float(np.median([np.max(_ways(trial)) for trial in both]))
    lengths = way / float(np.hypot(*np.ptp(setup.grid.exterior, axis=0)))
    found = "no finger comes within 1 m of the object in any push, though both move"
    asked = "is the tip in m, and in the frame of object_pose?"
    if lengths > _MANY_LENGTHS:
        found += f", the object by a median of {_length_text(way)}, {lengths:.0f} lengths of its outline"
        asked = "are positions in m?"
    return found, f"{asked} If no finger pushed, import with `tip_pose: null`"


def nothing_pushed(setup: Setup, trials: Sequence[Trial]) -> bool:
    """Whether all objects rest, and all fingers, of which some come within 1 m, stay away from them."""
    near = [trial for trial in trials if trial.finger_near(setup.reach)]
    return (
        bool(near)
        and not any(_moved(setup, trial) for trial in trials)
        and all(_clearance(setup, trial) > _NEVER_NEAR for trial in near)
    )


def pushing_force(setup: Setup, trials: Sequence[Trial]) -> float | None:
    """Median over the pushes of the force in a typical strong row, N; None where none was measured."""
    sizes = [
        np.percentile(np.hypot(*trial.ft_wrench.values[:, :2].T), 80)
        for trial in trials
        if trial.ft_wrench is not None and trial.finger_near(setup.reach)
    ]
    return float(np.median(sizes)) if sizes else None


def too_strong(setup: Setup, trials: Sequence[Trial]) -> tuple[str, str] | None:
    """What is odd, and what to do, if an object that was not weighed is pushed with more than any object of
    its size weighs; else None."""
    pushing, heaviest = pushing_force(setup, trials), setup.heaviest * setup.gravity
    if setup.mass is not None or pushing is None or pushing <= heaviest:
        return None
    found = (
        f"ft_wrench is {parsing.rounded(pushing, 3)} N while pushing; hardly any object of this size weighs"
        f" {parsing.rounded(heaviest, 3)} N"
    )
    return found, "is the force in N, rather than in grams or mN?"


class OddForce(NamedTuple):
    """A force that is odd for the weight."""

    found: str
    advice: str
    far: bool  # whether it is so odd that a unit is wrong
    wrong_force: bool  # whether that is the unit of the force: it is too strong, and the mass may be right


def odd_for_weight(setup: Setup, trials: Sequence[Trial]) -> OddForce | None:
    """What is odd if an object that was weighed is pushed with far less or more than friction needs; else
    None."""
    pushing = pushing_force(setup, trials)
    if setup.mass is None or pushing is None or nothing_pushed(setup, trials):
        return None
    weight = setup.mass * setup.gravity
    forced = [trial.ft_wrench for trial in trials if trial.ft_wrench and trial.finger_near(setup.reach)]
    peak = float(np.median([np.hypot(*wrench.values[:, :2].T).max() for wrench in forced]))
    small = peak < SELDOM_LESS * weight  # of taps, most rows hold no force
    if not small and pushing <= SELDOM_MORE * weight:
        return None
    size = peak if small else pushing
    share = size / weight
    found = (
        f"{'at most ' if small else ''}{parsing.rounded(size, 3)} N while pushing,"
        f" {parsing.rounded(share, 2)} times the weight of {parsing.rounded(setup.mass, 3)} kg"
    )
    far = not _LEAST_FRICTION < share < _MOST_FRICTION
    may_be = LEAST_PER_AREA <= setup.mass / setup.grid.polygon.area <= MOST_PER_AREA
    advice = "is the force in N, and object.mass in kg and right?"
    return OddForce(found, advice, far, far and not small and may_be)


def jittering(trials: Sequence[Trial]) -> tuple[str, str] | None:
    """What is odd, and what to do, if stamps jitter in most pushes whose fingers show it; else None."""
    found = [stamp_jitter(trial.tip_pose.time, trial.tip_pose.values[:, :2]) for trial in trials]
    judged = [jitter for jitter in found if jitter is not None]
    if not judged or not (middle := float(np.median(judged))):
        return None
    return (
        f"the finger's stamps jitter by {1e3 * middle:.0f} ms, but its rows seem evenly spaced: it moves more"
        " smoothly from row to row than by its stamps",
        "space t evenly in each channel whose rows are even; slipmap import does so with `rate` in a"
        " setup.yaml",
    )


def _overstated_noise(setup: Setup, trials: Sequence[Trial]) -> tuple[str, str] | None:
    """What is odd, and what to do, if a declared noise is far above the scatter of the rows, and above any
    tracker's; else None."""
    poses = [trial.object_pose for trial in trials if not trial.ends_only]
    turning = [pose for pose in poses if np.ptp(pose.values[:, 2]) > 0.0]  # an angle may be held, if not seen
    for key, size, unit, channels, columns, least in (
        ("position", 1e-3, "mm", poses, slice(2), _WORST_TRACKER[0]),
        ("angle", np.radians(1.0), "°", turning, slice(2, 3), _WORST_TRACKER[1]),
        ("tip", 1e-3, "mm", [trial.tip_pose for trial in trials], slice(2), _WORST_TRACKER[0]),
    ):
        declared = getattr(setup.noise, key)
        dense = [channel for channel in channels if len(channel.time) >= _DENSE]
        if declared is None or declared <= least or not dense:
            continue
        seen = np.median([row_noise(one.time, one.values[:, columns]).max() for one in dense])
        if declared > _OVERSTATED * seen:
            space = "" if unit == "°" else " "
            return (
                f"noise.{key} says {declared / size:.3g}{space}{unit}, but rows scatter by"
                f" {seen / size:.2g}{space}{unit}",
                f"is it in {'rad' if unit == '°' else 'm'}? With this much noise, little can be learned",
            )
    return None


def _counted(trials: Sequence[Trial]) -> tuple[str, str] | None:
    """What is odd, and what to do, if the stamps count rows; else None."""
    times = [
        channel.time
        for trial in trials
        for channel in (trial.object_pose, trial.tip_pose)
        if len(channel.time) >= _DENSE
    ]
    if not times or not all((np.diff(time) == 1.0).all() for time in times):
        return None
    return (
        "the stamps of object and finger are 1 s apart",
        "do they count frames? Times must be in s; slipmap import makes them with `rate` in a setup.yaml",
    )


def fault_of_frame(setup: Setup, trials: Sequence[Trial]) -> str | None:
    """Evidence, as a clause, that theta has the wrong sign or is off by a quarter or half turn, that the
    outline is mirrored, that no finger comes near, or that object and finger are exchanged or have different
    frames; else None.

    In the first cases the finger goes into the object in at least half of the pushes, and would not if this
    were corrected. No effect explains this.
    """
    if (away := never_near(setup, trials)) is not None:
        return "; ".join(away)
    seen = contact_rows(setup, trials)
    if (first := exchanged(setup, seen)) is not None:
        return first
    deep = [rows for rows in seen if _too_deep(rows)]
    cause = common_cause(setup, seen, len(deep)) if len(deep) >= len(seen) / 2 > 0 else None
    if cause is None:
        change = frame_change(setup, seen)
        return None if change is None or change.explained else change.words
    if cause.kind not in FRAME_WRONG:
        return None
    fixed = [replace(rows, gap=cause.applied(setup, rows)) for rows in seen]
    if sum(rows.depth > rows.allowed for rows in fixed) > len(deep) / 2:
        return None
    return _explained(deep, fixed, cause)


def _too_deep(rows: ContactRows) -> bool:
    """Whether the finger goes deeper than calibration and noise allow."""
    return max(rows.depth, -float(rows.gap[0])) > rows.allowed


def _explained(deep: Sequence[ContactRows], fixed: Sequence[ContactRows], cause: Cause) -> str:
    """How deep the finger goes, and the correction that would fix it."""
    return f"{_deep_text(deep, len(fixed))}; one correction would make it {_depth_text(fixed)}: {cause.text}"


def _judged(
    setup: Setup,
    trials: Sequence[Trial],
    pushes: Sequence[ContactRows],
    where: str,
    stays: Callable[[Trial], bool],
) -> tuple[set[str], list[str], bool]:
    """Names of trials to leave out, warnings, and whether the object's frame is wrong.

    A push is left out if its finger goes deeper than calibration errors allow after the common cause is
    corrected, if the object is carried, or if it moves as no push moves it (`_no_pushes`), as long as this
    holds for at most a tenth of the pushes.
    """
    carried = {trial.name: found[0] for trial in trials if (found := carries(setup, trial))}
    few = _few(len(trials))
    fit = {trial.name for trial in trials if trial.role == "fit"}
    faults = {name: carried_text(carry) for name, carry in carried.items()}
    deep = [rows for rows in pushes if _too_deep(rows)]
    warnings = []
    frame_wrong = False
    if faults and (len(faults) > few or (fit and fit <= set(faults))):
        refused = [trial.name for trial in trials if trial.name in faults and not stays(trial)]
        # If the finger also goes into the object, the frames are wrong, and it may not be away.
        if refused and not deep:
            raise DatasetError(
                f"{where}: {refused[0]}: {faults[refused[0]]}; cut the recording into its pushes"
            )
        first, *others = faults
        more = f" (and {len(others)} more pushes)" if others else ""
        warnings.append(
            f"{first}{more}: {faults[first]}; is this a recording of several pushes, or is a frame wrong?"
        )
        faults = {}
    none = {name: fault for name, fault in _no_pushes(setup, trials, pushes).items() if name not in faults}
    if len(none) + len(faults) <= few and not (fit and fit <= none.keys() | faults):
        faults |= none
        pushes = [rows for rows in pushes if rows.trial.name not in none]
        deep = [rows for rows in deep if rows.trial.name not in none]
    if deep:
        cause = common_cause(setup, pushes, len(deep))
        fixed = (
            pushes if cause is None else [replace(rows, gap=cause.applied(setup, rows)) for rows in pushes]
        )
        left = [rows for rows in fixed if rows.depth > rows.allowed]
        if cause is not None and len(left) <= len(deep) / 2:
            frame_wrong = cause.kind in FRAME_WRONG
            whose = parsing.listed([rows.trial.name for rows in deep])
            warnings.append(f"{whose}: {_explained(deep, fixed, cause)}")
            pushes, deep = fixed, left
        else:
            cause = None
        usual = max((rows.depth for rows in pushes if rows not in deep), default=0.0)
        alone = [rows for rows in deep if max(rows.depth, -rows.gap[0]) > _ALONE * usual]
        alone = [rows for rows in alone if rows.trial.name not in faults]
        gone = {rows.trial.name for rows in alone} | set(faults)
        if len(deep) + len(faults) <= _few(len(pushes)) and not (fit and fit <= gone):
            for rows in alone:
                verb, where_ = ("starts", "inside") if _from_start(rows) else ("goes", "into")
                faults[rows.trial.name] = (
                    f"the finger {verb} {_depth_text(alone)} {where_} the object, but contact fits in"
                    f" {len(pushes) - len(deep)} of {len(pushes)} pushes"
                )
            deep = [rows for rows in deep if rows not in alone]
        if deep and cause is None:
            warnings.append(
                f"{parsing.listed([rows.trial.name for rows in deep])}: {_deep_text(deep, len(pushes))};"
                " check theta's sign, the frames, the clocks, which point of the finger was recorded,"
                " finger.radius and the outline"
            )
    odd = {trial.name for trial in trials if trial.name in faults and not stays(trial)}
    warnings += _by_fault(
        {name: fault for name, fault in faults.items() if name in odd}, f"left out; {_FORCED}"
    )
    warnings += _by_fault(
        {name: fault for name, fault in faults.items() if name not in odd}, "kept as requested"
    )
    return odd, warnings, frame_wrong


def _by_fault(faults: Mapping[str, str], end: str) -> list[str]:
    """A warning for each fault, with the names of the trials that have it."""
    kinds: dict[str, list[str]] = {}
    for name, fault in faults.items():
        kinds.setdefault(fault, []).append(name)
    return [f"{parsing.listed(alike)}: {fault}; {end}" for fault, alike in kinds.items()]


def _no_pushes(setup: Setup, trials: Sequence[Trial], pushes: Sequence[ContactRows]) -> dict[str, str]:
    """Why single trials cannot be pushes, by name: the object moves with the finger far away all the time, or
    incomparably farther than in the others. Empty if too few can be judged."""
    trials = [trial for trial in trials if not seems_degrees(trial.object_pose.values)]
    noise = [float(np.hypot(rows.noise.position, setup.reach * rows.noise.angle)) for rows in pushes]
    least = _least_motion(setup, max(_NOTABLE_MOTION, 5.0 * float(np.median(noise or [0.0]))))
    moved = {trial.name: float(np.max(_shifts(setup, trial))) for trial in trials}
    away = {
        trial.name: gap
        for trial in trials
        if moved[trial.name] > least and (gap := _least_gap(setup, trial, least)) is not None
    }
    far = [name for name, gap in away.items() if gap > _NEVER_NEAR]
    # A wrong frame also leaves the finger away in some pushes; then it goes deep, or is not near, in others.
    deep = sum(map(_too_deep, pushes))
    near = [gap for name, gap in away.items() if name not in far] or [np.inf]
    fits = np.median(near) < 2.0 * CALIBRATION_ERROR and len(far) + deep <= _few(len(away))
    found = {}
    for name in far:
        if fits and away[name] > _ALONE * max(near):
            found[name] = (
                f"the object moves {_length_text(moved[name])}, but the finger stays"
                f" {_length_text(away[name])} or more away from it"
            )
    went = {trial.name: float(np.max(_ways(trial))) for trial in trials}
    for name, distance in went.items():
        others = float(np.median([one for other, one in went.items() if other != name] or [distance]))
        if distance > max(_FAR, _TIMES_FARTHER * others):
            found[name] = (
                f"the object moves {_length_text(distance)} (are positions in m?), but in the other pushes a"
                f" median of {_length_text(others)}"
            )
    return found


def _least_gap(setup: Setup, trial: Trial, least: float) -> float | None:
    """Least air between finger and object from rest until the object stands still again, m.

    Less what either moves between rows, since it may lie off a straight line by as much. None if the object
    may slide already at first, or if rows are so far apart that a finger may come and go between them.
    """
    if trial.ends_only or not _begins_at_rest(setup, trial) or trial.initial_velocity().any():
        return None
    pose, tip, shift = trial.object_pose, trial.tip_pose, _shifts(setup, trial)
    begin = pose.time[max(int(np.argmax(shift > 0.2 * least)) - 1, 0)]
    end = pose.time[int(np.argmax(shift > 0.9 * shift.max()))]
    air = np.inf
    for channel in (pose, tip):
        rows = channel.time[(channel.time > begin) & (channel.time < end)]
        rows = np.concatenate([[begin], rows, [end]])
        if np.max(np.diff(rows)) > _UNSEEN:
            return None
        step = float(np.max(np.hypot(*np.diff(channel.at(rows)[:, :2], axis=0).T)))
        air = min(air, float(np.min(gaps(setup, tip.at(rows), pose.at(rows)))) - step)
    return air


def _length_text(length: float) -> str:
    return f"{length:.3g} m" if length > 1.0 else f"{1e3 * length:.3g} mm"


def _few(count: int) -> int:
    """Largest number of odd ones among so many that may be left out."""
    return max(1, count // _LONERS) if count >= _FEWEST_TRIALS else 0


def _deep_text(deep: Sequence[ContactRows], count: int) -> str:
    at_start = sum(_from_start(rows) for rows in deep) > len(deep) / 2
    of_all = f"{len(deep)} of {count} pushes"
    if at_start:
        return f"the finger starts {_depth_text(deep)} inside the object in {of_all}"
    return f"the finger goes {_depth_text(deep)} into the object during {of_all}"


def _from_start(rows: ContactRows) -> bool:
    return bool(-rows.gap[0] > 0.8 * rows.deepest)


def _depth_text(pushes: Sequence[ContactRows]) -> str:
    depth = 1e3 * max(0.0, float(np.median([rows.deepest for rows in pushes])))
    return f"{depth:.0f} mm" if depth > 9.5 else f"{depth:.1f} mm"


def impossible(setup: Setup, trial: Trial) -> Iterator[str]:
    """Reasons why a record cannot be that of a push, so that a unit or a frame must be wrong."""
    if _fastest(trial.object_pose) > _LARGEST_SPEED:
        yield f"the object moves faster than {_LARGEST_SPEED:g} m/s; are positions in m and times in s?"
    if (off := beside_table(setup, trial)) is not None:
        yield off
    if len(trial.object_pose.time) > 10 and np.median(np.diff(trial.object_pose.time)) > _SLOWEST_RATE:
        yield f"object poses are more than {_SLOWEST_RATE:g} s apart; are times in s?"
    if _begins_at_rest(setup, trial) and (untouched := _untouched(setup, trial)) is not None:
        yield untouched
    if trial.finger_near(setup.reach):
        if _fastest(trial.tip_pose) > _LARGEST_SPEED:
            yield f"the tip moves faster than {_LARGEST_SPEED:g} m/s; are positions in m and times in s?"
        if _stands_still(setup, trial):
            yield "the object's pose never changes though the finger goes through it; was the tracker frozen?"


def _untouched(setup: Setup, trial: Trial) -> str | None:
    """What is odd about an object that moves without a touch and does not slide already; None if nothing."""
    if not _moved(setup, trial) or trial.initial_velocity().any():
        return None
    if not trial.finger_near(setup.reach):
        return _NOT_NEAR
    if len(trial.tip_pose.time) == 1:
        return (
            "a resting object begins to move, but tip_pose has only one row, and a finger that does not move"
            " pushes nothing"
        )
    if _clearance(setup, trial) > _TOUCH_RADII * setup.finger_radius + CALIBRATION_ERROR:
        return "the object moves, but the tip never touches its outline; is one of them in the wrong frame?"
    return None


def _begins_at_rest(setup: Setup, trial: Trial) -> bool:
    """Whether the first rows show that the object rests; two rows, or a short track, cannot."""
    if len(trial.object_pose.time) < 2 * _REST_ROWS:
        return False
    return float(np.max(_shifts(setup, trial)[:_REST_ROWS])) < _least_motion(setup, 1e-3)


def _faults(setup: Setup, trial: Trial, where: str) -> Iterator[str]:
    yield from impossible(setup, trial)
    # Of two poses alone, which do not tell whether the object was already sliding, this is a doubt.
    if trial.ends_only and (untouched := _untouched(setup, trial)) is not None:
        yield untouched
    if not trial.finger_near(setup.reach):
        return
    if _moved(setup, trial) and _pulls(setup, trial):
        yield _PULLS
    _refuse_foreign_clocks(trial, where)
    if _ends_early(trial):
        yield "the tip's rows end while it is still moving; it is held at its last position from there on"


def _stands_still(setup: Setup, trial: Trial) -> bool:
    """Whether the pose never changes while the finger's rim goes 10 mm or more into the object."""
    if len(trial.object_pose.time) < 3 or np.ptp(trial.object_pose.values, axis=0).any():
        return False
    return bool(np.min(gaps(setup, trial.tip_pose.values, trial.object_pose.values[0])) < -_THROUGH)


def _pulls(setup: Setup, trial: Trial) -> bool:
    """Whether the force opposes the finger's motion along most of its path."""
    if trial.ft_wrench is None or len(trial.ft_wrench.time) < _FEWEST_FORCES or len(trial.tip_pose.time) < 2:
        return False
    times, force = trial.ft_wrench.time, trial.ft_wrench.values[:, :2]
    size = np.hypot(*force.T)
    step = np.diff(trial.tip_pose.at(times), axis=0)
    pushing = size[1:] > max(0.3 * float(size.max(initial=0.0)), 3.0 * (setup.noise.force or 0.0))
    work = (force[1:] * step).sum(axis=1)[pushing]
    return bool(work.sum() < -0.5 * (size[1:] * np.hypot(*step.T))[pushing].sum()) if len(work) else False


def _copies(trials: Sequence[Trial], where: str, one_file: bool) -> list[str]:
    """Warnings about equal pushes in one file; equal pushes in two files are refused, unless these were
    written from one file."""
    seen: dict[bytes, str] = {}
    warnings = []
    for trial in trials:
        digest = hashlib.sha256()
        for channel in trial.channels.values():
            digest.update(np.round(channel.time - trial.start, 6).tobytes())
            digest.update(channel.values.tobytes())
        first = seen.setdefault(digest.digest(), trial.name)
        if first == trial.name:
            continue
        fault = f"{where}: {trial.name} holds the same measurement as {first}"
        cut_apart = "#" in first and first.rpartition("#")[0] == trial.name.rpartition("#")[0]
        if not one_file and not cut_apart:
            raise DatasetError(f"{fault}; remove one of them")
        warnings.append(f"{fault}; is one a copy?")
    return warnings


def _refuse_foreign_clocks(trial: Trial, where: str) -> None:
    first, last = trial.object_pose.time[[0, -1]]
    for what, channel in trial.channels.items():
        apart = channel.time[-1] < first or channel.time[0] > last
        if apart and len(channel.time) > 1:
            raise DatasetError(
                f"{where}: {trial.name}, {what}, row 0: its times run from {channel.time[0]:.3f} to"
                f" {channel.time[-1]:.3f} s, those of object_pose from {first:.3f} to {last:.3f} s; stamp all"
                " channels with one clock"
            )


def _moved(setup: Setup, trial: Trial) -> bool:
    """Whether a point of the outline moves by more than 5 mm and five standard deviations."""
    return bool(np.max(_shifts(setup, trial)) > _least_motion(setup, _NOTABLE_MOTION))


def _shifts(setup: Setup, trial: Trial) -> FloatArray:
    """(T,) largest displacement of a point of the outline since the first pose, m."""
    angle = trial.object_pose.values[:, 2]
    return np.asarray(_ways(trial) + setup.reach * np.abs(angle - angle[0]))


def _ways(trial: Trial) -> FloatArray:
    """(T,) distance of the object frame from its first place, m."""
    place = trial.object_pose.values[:, :2]
    return np.asarray(np.hypot(*(place - place[0]).T))


def _least_motion(setup: Setup, least: float) -> float:
    """Displacement, m, that is no noise: the least, or five standard deviations."""
    return max(least, 5.0 * setup.noise_of_motion)


def _clearance(setup: Setup, trial: Trial) -> float:
    """Least distance between the finger's rim and the outline over a trial, m; negative where it overlaps."""
    if trial.ends_only:  # take a straight finger path and the object at either end
        track = shapely.LineString(trial.tip_pose.values[[0, *range(len(trial.tip_pose.time))]])
        outlines = [
            shapely.transform(setup.grid.polygon, partial(placed, pose=pose))
            for pose in trial.object_pose.values
        ]
        return float(min(track.distance(outline) for outline in outlines)) - setup.finger_radius
    chosen = spread_rows(len(trial.tip_pose.time), _MOST_ROWS)
    tips = trial.tip_pose.values[chosen]
    return float(np.min(gaps(setup, tips, trial.object_pose.at(trial.tip_pose.time[chosen]))))


def _fastest(channel: Channel) -> float:
    """Greatest speed over windows of 0.1 s or, in shorter tracks, over the whole, m/s."""
    span = float(channel.time[-1] - channel.time[0])
    if span <= 0.0:
        return 0.0
    window = min(_SPEED_WINDOW, span)
    starts = channel.time[channel.time <= channel.time[-1] - window]
    step = channel.at(starts + window) - channel.at(starts)
    return float(np.max(np.hypot(step[:, 0], step[:, 1]), initial=0.0)) / window


def _ends_early(trial: Trial) -> bool:
    end = float(trial.tip_pose.time[-1])
    if end > trial.object_pose.time[-1] - _EARLY_END or len(trial.tip_pose.time) < 2:
        return False
    step = trial.tip_pose.values[-1] - trial.tip_pose.at(end - _EARLY_END)
    return bool(np.hypot(*step) > _SLOW_TIP * _EARLY_END)
