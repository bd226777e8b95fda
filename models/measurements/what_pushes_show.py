"""What pushes could show before any fit: which quantities and effects, and which pushes would add most."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from slipmap.models.geometry import rotated, seen_from
from slipmap.models.measurements import parsing
from slipmap.models.measurements.contact import CALIBRATION_ERROR, ContactRows
from slipmap.models.measurements.push_dataset import PushDataset, gaps
from slipmap.models.measurements.trial import Trial
from slipmap.models.physics.cell_grid import FloatArray

_ARCS = 8  # equal parts of the outline's length
_OCTANTS = 8
_COASTS = 5e-3  # m that an object moves without the finger
_AWAY = 2e-3  # m
_STILL = 5.0  # standard deviations of a position that are no motion
_FAST = 0.1  # m/s above which total inertia shows beside a measured force,
_THROWN = 0.2  # and its distribution, though the object does not coast
_TURNS, _TURNS_FAR = float(np.radians(10.0)), float(np.radians(30.0))
_SPEEDS = 2.0  # ratio from which speeds count as different


@dataclass(frozen=True)
class Told:
    """Whether these pushes could show a quantity or an effect, before any fit."""

    name: str
    could: bool
    reason: str


@dataclass(frozen=True)
class Coverage:
    """What the pushes cover."""

    pushes: int  # number in which the object moves
    arcs: int  # number of eight equal lengths of the outline that were touched
    table_octants: int  # number of eight directions on the table in which the object moved
    object_octants: int  # the same in the object frame
    slowest: float  # smallest of the pushes' highest speeds, m/s
    fastest: float  # largest of them
    turned: float  # largest rotation from start to end, rad
    spread: float  # extent of the positions of the object, m
    size: float  # of the object, m
    coasting: int  # number of pushes in which the object slides freely
    forces: bool
    mass_known: bool

    @property
    def speeds_differ(self) -> bool:
        """Whether the fastest push is more than twice as fast as the slowest."""
        return self.fastest > _SPEEDS * self.slowest


def coverage_of(dataset: PushDataset, rows: Sequence[ContactRows]) -> Coverage:
    """What the pushes of a dataset cover; `rows` are the contact rows of those that have a finger."""
    boundary = dataset.grid.polygon.exterior
    arcs: set[int] = set()
    for one in rows:
        telling = one.pressed & (np.abs(one.gap) < 2.0 * CALIBRATION_ERROR)
        if telling.any():
            local = seen_from(one.tips[telling], one.poses[telling])
            along = shapely.line_locate_point(boundary, shapely.points(local), normalized=True)
            arcs |= set(np.minimum(_ARCS - 1, (_ARCS * along).astype(int)).tolist())
    noise = {one.trial.name: one.noise.position for one in rows}
    on_table: set[int] = set()
    on_object: set[int] = set()
    speeds, turns, places, coasting, moved = [], [], [], 0, 0
    for trial in dataset.trials:
        pose = trial.object_pose
        way = pose.values[-1, :2] - pose.values[0, :2]
        turn = float(pose.values[-1, 2] - pose.values[0, 2])
        if np.hypot(*way) + dataset.reach * abs(turn) < _COASTS:
            continue
        moved += 1
        turns.append(abs(turn))
        places += [pose.values[0, :2], pose.values[-1, :2]]
        on_table.add(_octant(way))
        on_object.add(_octant(rotated(way, -pose.values[0, 2])))
        if not trial.ends_only:
            speeds.append(fast_speed(trial))
            coasting += _coasted(dataset, trial, noise.get(trial.name))
    place = np.array(places).reshape(-1, 2)
    spread = float(np.max(np.hypot(*np.ptp(place, axis=0)), initial=0.0)) if len(place) else 0.0
    return Coverage(
        pushes=moved, arcs=len(arcs), table_octants=len(on_table), object_octants=len(on_object),
        slowest=min(speeds, default=0.0), fastest=max(speeds, default=0.0), turned=max(turns, default=0.0),
        spread=spread, size=float(np.hypot(*np.ptp(dataset.grid.exterior, axis=0))), coasting=coasting,
        forces=any(trial.ft_wrench is not None for trial in dataset.trials),
        mass_known=dataset.mass is not None,
    )  # fmt: skip


def fast_speed(trial: Trial) -> float:
    """90th percentile of the object's speed, m/s."""
    begin, end = trial.object_pose.time[[0, -1]]
    time = np.linspace(begin, end, 200)
    place = trial.object_pose.at(time)[:, :2]
    return float(np.percentile(np.hypot(*np.gradient(place, time, axis=0).T), 90))


def _octant(way: FloatArray) -> int:
    return int(np.floor((np.arctan2(way[1], way[0]) % (2.0 * np.pi)) / (2.0 * np.pi) * _OCTANTS)) % _OCTANTS


def _coasted(dataset: PushDataset, trial: Trial, noise: float | None) -> bool:
    """Whether the object slides freely: from its first row on, or after the finger has left it.

    Args:
        noise: standard deviation of a position, m; None without a finger.
    """
    if trial.initial_velocity().any():
        return True
    if noise is None:
        return False
    pose = trial.object_pose
    free = gaps(dataset, trial.tip_pose.at(pose.time), pose.values) > _AWAY
    touched = np.flatnonzero(~free)
    if not len(touched):
        return False
    free[: touched[0]] = False
    edges = np.flatnonzero(np.diff(free.astype(int), prepend=0, append=0))
    first, last = edges[::2], edges[1::2] - 1  # of each time without the finger
    way = np.hypot(*(pose.values[last, :2] - pose.values[first, :2]).T)
    # Noise of a resting object is no way, however long it lasts.
    return bool(way[way > max(_AWAY, _STILL * noise)].sum() > _COASTS)


def quantities_shown(seen: Coverage) -> list[Told]:
    """Whether the pushes could show each quantity of the object."""
    inertia = seen.fastest > _FAST or seen.coasting > 0
    around = seen.arcs >= 3 and seen.turned > _TURNS
    return [
        Told("total friction", seen.forces or (seen.coasting > 0 and seen.mass_known),
             "force in steady sliding" if seen.forces else "needs force, or a weighed object that coasts"),
        Told("centre of friction", around,
             f"{seen.arcs} of 8 parts of the outline touched, turned {np.degrees(seen.turned):.0f}° at most"),
        Told("friction arm", seen.turned > _TURNS, "how far the object turns"),
        Told("total mass", seen.mass_known or (inertia and seen.forces),
             "weighed beforehand" if seen.mass_known else "needs force, and fast pushes or coasting"),
        Told("centre of mass, moment of inertia",
             (seen.coasting > 0 or seen.fastest > _THROWN) and seen.turned > _TURNS,
             f"{_fastest_in_words(seen)}, pushes that coast: {seen.coasting}"),
        Told("finger friction", seen.forces or seen.arcs >= 3, "sliding contacts, or force off the normal"),
        Told("shares of parts of the object", seen.arcs >= 5 and around, "contact all around the outline"),
    ]  # fmt: skip


def _fastest_in_words(seen: Coverage) -> str:
    """The highest speed of the object, which poses before and after pushes alone do not tell."""
    measured = seen.fastest or not seen.pushes
    return f"fastest {parsing.rounded(1e3 * seen.fastest, 3)} mm/s" if measured else "no poses while it moves"


_Needs = Callable[[Coverage], bool]
EFFECT_NEEDS: Mapping[str, tuple[_Needs, str]] = {
    "viscous_friction": (lambda c: c.speeds_differ and c.forces, "force at speeds a factor of two apart"),
    "stribeck_friction": (lambda c: c.speeds_differ and c.forces, "force at speeds a factor of two apart"),
    "anisotropic_table": (lambda c: c.table_octants >= 4, "four directions on the table"),
    "anisotropic_object": (lambda c: c.object_octants >= 4, "four directions in the object frame"),
    "table_tilt": (lambda c: c.table_octants >= 4, "opposite directions on the table"),
    "table_friction_field": (lambda c: c.spread > 1.5 * c.size, "positions 1.5 object lengths apart"),
    "tether": (lambda c: c.spread > 1.5 * c.size, "positions 1.5 object lengths apart"),
    "sensor_latency": (lambda c: c.speeds_differ or c.fastest > _FAST, "fast pushes, or two speeds"),
    "tracker_offset": (lambda c: c.turned > _TURNS_FAR or c.arcs >= 3, "three sides, or large turns"),
    "tracker_scale": (lambda c: c.arcs >= 2 and c.spread > c.size, "two sides, and long travel"),
    "friction_drift": (lambda c: c.pushes >= 8, "eight pushes in the order of the experiment"),
    "finger_compliance": (lambda c: c.forces, "force"),
    "loose_mass": (lambda c: c.fastest > _FAST or c.coasting > 0, "fast starts and stops"),
    "load_transfer": (lambda c: c.fastest > _FAST or c.coasting > 0 or c.arcs >= 4, "four sides, or braking"),
    "skate": (lambda c: c.object_octants >= 4, "four directions in the object frame"),
    "impulse_friction": (lambda c: c.table_octants >= 4, "four headings on the table"),
    "friction_diamond": (lambda c: c.table_octants >= 4, "four directions on the table"),
    "friction_square": (lambda c: c.table_octants >= 4, "four directions on the table"),
    "slip_load": (lambda c: c.turned > _TURNS and c.arcs >= 3, "three sides, and turning"),
    "torsional_friction": (lambda c: c.turned > _TURNS and c.arcs >= 3, "three sides, and turning"),
    "tracker_shift": (lambda c: c.arcs >= 3, "three sides"),
    "force_frame": (lambda c: c.forces and c.arcs >= 2, "force on two sides"),
    "force_bias": (lambda c: c.forces and c.table_octants >= 2, "force in two directions on the table"),
    "force_gains": (lambda c: c.forces and c.table_octants >= 2, "force in two directions on the table"),
    "force_latency": (lambda c: c.forces and c.pushes > 0, "force"),
}
"""Condition on the pushes for each effect of the library to show, and the same in words."""


def pushes_to_add(seen: Coverage) -> list[str]:
    """Which pushes to add, the most useful first."""
    wanted = []
    if seen.pushes < 6:
        more = 6 - seen.pushes
        wanted.append(
            f"{more} more push{'es that move' if more > 1 else ' that moves'} the object by 5 mm or more:"
            " with six or more, some can be held out"
        )
    if seen.arcs < 5:
        wanted.append(f"pushes on parts of the outline not touched yet ({_ARCS - seen.arcs} of {_ARCS})")
    if seen.turned < _TURNS:
        wanted.append("off-centre pushes that turn the object by 30° or more")
    if seen.table_octants < 4:
        wanted.append("pushes in other directions on the table, including opposite ones")
    if not seen.speeds_differ:
        wanted.append("two pushes twice as fast as the others")
    if seen.fastest < _FAST and not seen.coasting and not seen.mass_known:
        wanted.append("a fast push that lets the object coast, or object.mass from a scale")
    if not seen.forces:
        wanted.append("force, if you have a sensor: without it the total friction stays open")
    return wanted
