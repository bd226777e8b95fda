"""A made-up session in a laboratory: eight pushes of a hammer in one recording of each device.

OptiTrack Motive exports at 120 Hz with y up, mm and quaternions; the robot logs in seconds since 1970 in its
own frame and lifts the finger between pushes; a force sensor at 1 kHz is turned by 45° and biased; each has a
clock of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slipmap.models.geometry import rotated, seen_from
from slipmap.models.measurements import Noise
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects.benchmark_objects import hammer
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.planners.exploration import Candidate, candidate_pushes

RADIUS = 0.008
ROBOT_CLOCK = 1.7e9 + 123.4567  # what the robot's clock shows when Motive's shows 0
FORCE_CLOCK = 3.2104  # the same of the force sensor
ROBOT_FRAME = np.array([0.4, -0.25, np.radians(30.0)])  # of the robot's base on the table
BIAS = np.array([0.8, -0.35])  # N, in the sensor's axes
SENSOR_TURN = np.radians(45.0)
_FINE = 1000.0  # Hz
_DRAWN = 120  # pushes to choose from
_TRAVEL, _LIFT = 2.0, 0.2  # s between two pushes, and the share of it for going up, and down
_NOISE_FREE = Noise(None, None, None, None)


@dataclass(frozen=True)
class LabSession:
    folder: Path
    grid: CellGrid
    maps: Maps
    setup: str  # the setup.yaml

    @property
    def sources(self) -> list[Path]:
        return [self.folder / name for name in ("take_001.csv", "robot.log", "force.csv")]


def lab_session(folder: Path, seed: int = 3) -> LabSession:
    rng = np.random.default_rng(seed)
    grid, maps = hammer()
    slider = Slider(grid, RADIUS)
    time, pose, tip, force, up = [], [], [], [], []
    start, now = np.zeros(3), 0.0
    for candidate in _from_four_sides(grid, rng):
        push = candidate.push(start, rest=0.6)
        dataset = record_pushes(slider, maps, [push], rng, noise=_NOISE_FREE, rate=_FINE)
        trial = dataset.trials[0]
        rows = trial.object_pose.time
        if time:  # the finger goes up, over and down
            steps = np.arange(0.0, _TRAVEL, 1.0 / _FINE)
            share = steps[:, None] / _TRAVEL
            over = np.clip((share - _LIFT) / (1.0 - 2.0 * _LIFT), 0.0, 1.0)
            time.append(now + steps)
            pose.append(np.tile(start, (len(steps), 1)))
            tip.append((1.0 - over) * tip[-1][-1] + over * trial.tip_pose.values[0])
            force.append(np.zeros((len(steps), 2)))
            up.append(0.05 * np.minimum(1.0, np.minimum(share[:, 0], 1.0 - share[:, 0]) / _LIFT))
            now += _TRAVEL
        time.append(now + rows)
        pose.append(trial.object_pose.values)
        tip.append(trial.tip_pose.at(rows))
        force.append(trial.ft_wrench.at(rows)[:, :2])
        up.append(np.zeros(len(rows)))
        start, now = trial.object_pose.values[-1], now + rows[-1] + 1.0 / _FINE
    clock = np.concatenate(time)
    truth = [np.concatenate(one) for one in (pose, tip, force, up)]

    def at(times, values):
        return np.column_stack([np.interp(times, clock, column) for column in np.atleast_2d(values.T)])

    _write_motive(folder / "take_001.csv", np.arange(0.0, now, 1.0 / 120.0), at, truth[0], rng)
    _write_robot(folder / "robot.log", np.arange(0.0, now, 1.0 / 125.0) + 0.0013, at, truth[1], truth[3], rng)
    _write_force(folder / "force.csv", np.arange(0.0, now, 1e-3) + 0.0004, at, truth[2], rng)
    corners = [[round(float(x), 5) for x in corner] for corner in grid.exterior]
    x, y, turn = ROBOT_FRAME
    setup = f"""\
name: lab session
object: {{outline: {corners}}}
finger: {{radius: {RADIUS}}}
noise: {{position: 0.0002, angle: 0.002, tip: 0.00005, force: 0.05}}
object_pose: {{source: take_*.csv, part: hammer}}
tip_pose:
  source: robot.log
  position: actual_TCP_pose
  frame: [{x}, {y}, {np.degrees(turn):.1f} deg]
ft_wrench:
  source: force.csv
  force: [Fx, Fy, Fz]
  unit: {{time: ms}}
  frame: [0, 0, 45 deg]
"""
    return LabSession(folder, grid, maps, setup)


def _from_four_sides(grid: CellGrid, rng: np.random.Generator) -> list[Candidate]:
    """Eight pushes that teach how an object slides: against each of its four sides, near both ends.

    Whatever lies between the ends, the centre of friction does; long arms to both sides of it locate it. The
    first six, which are learned from, come from all sides.
    """
    drawn = candidate_pushes(grid, RADIUS, rng, _DRAWN)
    chosen = []
    for quarter, last in ((2, 0), (0, 1), (3, 0), (1, 1), (0, 0), (2, 1), (3, 1), (1, 0)):
        way = rotated(np.array([1.0, 0.0]), 0.5 * np.pi * quarter)
        side = [push for push in drawn if push.direction @ way > np.cos(np.pi / 4)]
        place = np.array([push.touch for push in side]) @ [-way[1], way[0]]
        share = (place - place.min()) / np.ptp(place)
        near = [push for push, at in zip(side, share, strict=True) if abs(at - last) <= 1 / 3]
        chosen.append(near[rng.integers(len(near))])
    return chosen


def _write_motive(path, times, at, pose, rng):
    rows = at(times, pose) + rng.normal(size=(len(times), 3)) * [2e-4, 2e-4, 2e-3]
    x, y, z = 1e3 * rows[:, 0], np.full(len(rows), 31.0), -1e3 * rows[:, 1]
    half = 0.5 * rows[:, 2]
    cells = np.column_stack([0 * half, np.sin(half), 0 * half, np.cos(half), x, y, z, 0 * half + 0.1])
    kinds = ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]
    lines = [
        "Format Version,1.23,Take Name,take_001,Capture Frame Rate,120.000000,Export Frame Rate,120.000000,"
        "Capture Start Time,2025-02-06 03.25.39.123 PM,Total Frames in Take," + str(len(rows))
        + ",Rotation Type,Quaternion,Length Units,Millimeters,Coordinate Space,Global",
        "",
        ",Type," + ",".join(["Rigid Body"] * 8),
        ",Name," + ",".join(["hammer"] * 8),
        ",ID," + ",".join(["1"] * 8),
        ",," + ",".join(kinds),
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,",
    ]  # fmt: skip
    lines += [
        f"{k},{time:.6f}," + ",".join(f"{cell:.6f}" for cell in row)
        for k, (time, row) in enumerate(zip(times, cells, strict=True))
    ]
    path.write_text("\n".join(lines) + "\n")


def _write_robot(path, times, at, tip, up, rng):
    place = seen_from(at(times, tip) + 5e-5 * rng.normal(size=(len(times), 2)), ROBOT_FRAME)
    height = 0.02 + at(times, up)[:, 0]
    lines = ["timestamp actual_TCP_pose_0 actual_TCP_pose_1 actual_TCP_pose_2 robot_mode"]
    lines += [
        f"{ROBOT_CLOCK + time:.6f} {x:.6f} {y:.6f} {z:.6f} RUNNING"
        for time, (x, y), z in zip(times, place, height, strict=True)
    ]
    path.write_text("\n".join(lines) + "\n")


def _write_force(path, times, at, force, rng):
    sensed = rotated(at(times, force), -SENSOR_TURN) + BIAS + 0.05 * rng.normal(size=(len(times), 2))
    lines = ["Time;Fx;Fy;Fz"]
    lines += [
        f"{1e3 * (FORCE_CLOCK + time):.1f};{x:.4f};{y:.4f};-1.2".replace(".", ",")
        for time, (x, y) in zip(times, sensed, strict=True)
    ]
    path.write_text("\n".join(lines) + "\n")
