"""Pushes by the arm of the robot's cell, without camera, compared with the cell-grid model at the true maps.

`python tests/diagrams/station/arm_pushes.py wrench spray_gun` makes sixty short and thirty long random pushes
of each object. With `--turning` the hand does not keep its direction while it pushes.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import shapely
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus

import slipmap
from slipmap.diagrams.execution.plans import ArmPlanner
from slipmap.diagrams.execution.push_executor import PushExecutor
from slipmap.diagrams.execution.requests import ActivePush
from slipmap.diagrams.station.arm import HOME, arm_model
from slipmap.diagrams.station.sliding_object import BODY, resting_pose, sink_of
from slipmap.diagrams.station.station import Station, take_fixed_steps
from slipmap.models.geometry import placed, rotated
from slipmap.models.inference.observations import observe
from slipmap.models.measurements.trial import Channel, Trial
from slipmap.models.measurements.trial_tables import if_turning
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.perception.seen_object import ObservedPose
from slipmap.models.physics.paper_notation import add
from slipmap.planners.table_push import TablePush

FINGER_RADIUS = 0.008
SPEED = 0.077  # m/s, as in an exploration
SHORT, LONG = (0.02, 0.06), (0.15, 0.22)  # m, from first touch
ROCKS = 1e-4  # rad, tilt of an object that does not lie on its feet
_SAMPLE = 0.01  # s
_DOWN = 0.006  # m; the finger's end is lower during a push
_APPROACH = 0.03  # m


@dataclass(frozen=True)
class Outcome:
    """What became of a push, and what the model says."""

    moved: float  # m
    off: float  # average distance (ADD) between the end in the plant and the model's, m
    turned_off: float  # angle between the two, rad
    off_if_still: float  # the same for a model that does not know of a finger that turns, m
    rocking: float  # share of the steps in motion with a tilt of more than `ROCKS`


class ArmCell:
    """A station and an executor, which knows where the object is and how high."""

    def __init__(self, name: str) -> None:
        scenario = slipmap.Scenario()
        thing = replace(scenario.object, name=name, pose=[0.0, 0.0, 0.0])
        builder = DiagramBuilder()
        self.station = builder.AddSystem(Station(replace(scenario, object=thing)))
        self.thing = self.station.true_object
        table = scenario.table.make()
        self._executor = builder.AddSystem(PushExecutor(arm_model(), HOME, scenario.execution, table))
        for port in ("iiwa.position", "gripper.position", "gripper.force_limit"):
            builder.Connect(self._executor.GetOutputPort(port), self.station.GetInputPort(port))
        for port in ("iiwa.position_measured", "iiwa.torque_external"):
            builder.Connect(self.station.GetOutputPort(port), self._executor.GetInputPort(port))
        for port in ("push", "object_pose", "seen_object"):
            builder.ExportInput(self._executor.GetInputPort(port), port)
        self._simulator = Simulator(builder.Build())
        take_fixed_steps(self._simulator)
        self._slider = slipmap.Slider(self.thing.grid, finger_radius=FINGER_RADIUS)
        self._count = 0

    def push(self, begin: np.ndarray, end: np.ndarray, angle: float) -> Outcome | None:
        """Push the object, which lies at the world's origin turned by an angle; None if the arm cannot.

        Args:
            begin, end: (2,) of the finger in the object's frame, m.
        """
        trial, tilts = self._recorded(begin, end, np.array([0.0, 0.0, angle]))
        if trial is None:
            return None
        push = observe(trial).push
        pushes = [push, replace(push, tip_angle=None)]
        measured = trial.object_pose.values[-1]
        ends = self._slider.rollout(self.thing.maps, pushes).end[0, :, :3]
        off, off_if_still = (float(add(end, measured, self.thing.grid.centers)) for end in ends)
        return Outcome(
            float(np.linalg.norm(measured[:2] - push.start_pose[:2])),
            off,
            abs(float(ends[0, 2] - measured[2])),
            off_if_still,
            float(np.mean(tilts > ROCKS)) if len(tilts) else 0.0,
        )

    def _recorded(
        self, begin: np.ndarray, end: np.ndarray, pose: np.ndarray
    ) -> tuple[Trial | None, np.ndarray]:
        """The push without noise of sensors, and the object's tilts in the steps in which it moves, rad."""
        root = self._simulator.get_mutable_context()
        plant, sink = self.station.plant, sink_of(self.thing)
        of_plant = plant.GetMyMutableContextFromRoot(root)
        plant.SetFreeBodyPose(of_plant, plant.GetBodyByName(BODY), resting_pose(*pose, sink=sink))
        self._count += 1
        request = ActivePush(self._count, TablePush(placed(begin, pose), placed(end, pose), SPEED))
        inputs = {
            "push": request,
            "object_pose": ObservedPose(pose, np.zeros((3, 3)), valid=True),
            "seen_object": SimpleNamespace(grid=self.thing.grid, cell_heights=self.thing.height),
        }
        for port, value in inputs.items():
            self._simulator.get_system().GetInputPort(port).FixValue(root, Value[object](value))
        status, context = self._executor.GetOutputPort("status"), self._executor.GetMyContextFromRoot(root)
        steps, rows = [], []

        def watch(now: Context) -> EventStatus:
            said = status.Eval(context)
            if said.push_id == self._count and said.mode in ("home", "refused"):
                return EventStatus.ReachedTermination(self._executor, said.mode)
            seen = self.station.GetOutputPort("truth.object_pose")
            X_WO = seen.Eval(self.station.GetMyContextFromRoot(now))
            R = X_WO.rotation().matrix()
            placed_at = [*X_WO.translation()[:2], np.arctan2(R[1, 0], R[0, 0])]
            steps.append([*placed_at, np.hypot(R[2, 0], R[2, 1])])
            if not rows or now.get_time() > rows[-1][0] + _SAMPLE - 1e-6:
                X_WT = self._executor.GetOutputPort("tip_pose").Eval(context)
                x_axis = X_WT.rotation().matrix()[:, 0]
                rows.append(
                    [now.get_time(), *X_WT.translation(), *placed_at, np.arctan2(x_axis[1], x_axis[0])]
                )
            self.station.after_step(now)
            return EventStatus.DidNothing()

        self._simulator.set_monitor(watch)
        self._simulator.AdvanceTo(root.get_time() + 20.0)
        ended = status.Eval(context)
        assert ended.push_id == self._count and ended.mode in ("home", "refused"), ended
        if ended.mode == "refused":
            return None, np.zeros(0)
        recording, table = np.array(rows), np.array(steps)
        low = recording[recording[:, 3] < _DOWN]
        moving = np.abs(np.diff(table[:, :3], axis=0)).max(axis=1) > 1e-7
        low[:, 0] -= low[0, 0]
        time = low[:, 0]
        angle = if_turning(Channel(time, np.unwrap(low[:, 7])[:, None]))
        ends = low[[0, -1], 4:7]
        ends[:, 2] = np.unwrap(ends[:, 2])
        pose, tip = Channel(time[[0, -1]], ends), Channel(time, low[:, 1:3])
        return Trial("push", "fit", pose, tip, tip_angle=angle), table[1:][moving, 3]


def random_pushes(
    thing: TrueObject, count: int, seed: int, travel: tuple[float, float]
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Beginnings and ends in the object's frame, (2,) m, and angles of the object, rad.

    They meet the outline at random places, up to 40° from its normal, and go on for a random distance.

    Args:
        travel: shortest and longest distance, m.
    """
    rng = np.random.default_rng(seed)
    outline = shapely.orient_polygons(thing.grid.polygon)
    while count:
        share, lean = rng.uniform(0.0, 1.0), rng.uniform(-0.7, 0.7)
        length, angle = rng.uniform(*travel), rng.uniform(-np.pi, np.pi)
        place, beside = (
            shapely.get_coordinates(outline.exterior.interpolate(share + more, normalized=True))[0]
            for more in (0.0, 1e-4)
        )
        along = (beside - place) / np.linalg.norm(beside - place)
        way = rotated(np.array([-along[1], along[0]]), lean)
        begin = place - _APPROACH * way
        if outline.distance(shapely.Point(begin)) > 1.1 * FINGER_RADIUS:
            count -= 1
            yield begin, begin + (_APPROACH + length) * way, angle


def main() -> None:
    """Print a row for each object that is named."""
    names = [name for name in sys.argv[1:] if name != "--turning"]
    if len(names) < len(sys.argv) - 1:
        ArmPlanner._steady = lambda planner, push: iter(())  # type: ignore[method-assign]
    print(
        "ADD of the ends from the model's: median, 90 %, largest, mm, and if the finger is taken for a still"
    )
    print("one; pushes that rock in more than 10 % of their steps, and that the arm cannot make")
    for name in names:
        cell = ArmCell(name)
        for what, count, travel in (("short", 60, SHORT), ("long", 30, LONG)):
            found = [cell.push(*push) for push in random_pushes(cell.thing, count, 5, travel)]
            refused = sum(outcome is None for outcome in found)
            made = [outcome for outcome in found if outcome is not None and outcome.moved > 1e-4]
            off = 1e3 * np.array([[outcome.off, outcome.off_if_still] for outcome in made])
            known, still = (
                f"{median:.2f}, {most:.1f}, {largest:.1f}"
                for median, most, largest in np.quantile(off, [0.5, 0.9, 1.0], axis=0).T
            )
            rocking = sum(outcome.rocking > 0.1 for outcome in made)
            print(
                f"{name}: {len(made)} {what}, {known}, if still {still}; {rocking} rock, {refused} refused",
                flush=True,
            )


if __name__ == "__main__":
    main()
