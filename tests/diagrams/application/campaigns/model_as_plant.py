"""Beliefs of explorations in which the model itself plays the plant, so that nothing is wrong with it.

`python tests/diagrams/application/campaigns/model_as_plant.py wrench hammer` makes twenty of each object.
With `--regions` each is also pushed to the table's edge and back, and the ends of these pushes are compared
with the regions of the belief that chose them, and of other hypotheses from the same exploration.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from slipmap.diagrams.application.campaigns.belief_coverage import LEVELS, place_of, pushes_at_the_edge
from slipmap.diagrams.application.campaigns.worlds import PERIOD, DirectWorld, Motion, as_dataset, explored
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.identification import identify
from slipmap.models.inference.prediction import predict
from slipmap.models.inference.summaries import interval
from slipmap.models.measurements import Trial
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.pushes import Push
from slipmap.models.physics.rollout import Slider

STEP = PERIOD / 2  # s


class ModelWorld(DirectWorld):
    """An object that slides as the cell-grid model with its true maps says."""

    _step = STEP

    def __init__(self, true_object: TrueObject) -> None:
        super().__init__(true_object)
        self._slider = Slider(true_object.grid, self.finger_radius, table=self.table)
        self._at = np.zeros(3)

    def _place(self, pose: FloatArray) -> None:
        self._at = pose.copy()

    def _settle(self) -> None:
        """It rests at the end of each push."""

    def _pose(self) -> FloatArray:
        return self._at.copy()

    def _drive(self, tip: FloatArray) -> Motion:
        times: FloatArray = PERIOD * np.arange(1.0, (len(tip) + 1) // 2)
        push = Push(STEP, tip, self._at, pose_times=times, force_times=times - PERIOD / 2, force_span=PERIOD)
        found = self._slider.rollout(self.true_object.maps, [push])
        poses, forces = np.asarray(found.poses)[0], np.asarray(found.forces)[0]
        before, self._at = self._at, found.end[0, 0, :3].copy()
        return Motion(np.vstack([before, poses]), tip[::2], np.vstack([np.zeros(2), forces]))


Regions = dict[tuple[str, str], list[float]]
"""Rarities of pushes, by whose regions these are and by place."""

CHOSE, OTHER = "the belief that chose the pushes", "other hypotheses"


def add_rarities(
    found: Regions, world: DirectWorld, belief: Belief, taught: Sequence[Trial], seed: int
) -> None:
    """Push the object to the edge and back, and add the rarities of the ends."""
    other = identify(as_dataset(world, taught), seed=seed + 1000, friction_laws=False).belief
    rng = np.random.default_rng([seed, 5])
    world.reset(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]), rng)
    made = as_dataset(world, [], pushes_at_the_edge(world, belief, np.random.default_rng([seed, 6])))
    for whose, one in ((CHOSE, belief), (OTHER, other)):
        for push in predict(one, made):
            place = place_of(push.observation.push.start_pose, push.measured[-1], one.grid, world.table)
            found.setdefault((whose, place), []).append(push.rarity)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Explore objects that slide as the model says.")
    parser.add_argument("objects", nargs="+", metavar="OBJECT")
    parser.add_argument("--explorations", type=int, default=20, metavar="N", help="of each object")
    parser.add_argument("--seed", type=int, default=80, help="of the first exploration")
    parser.add_argument("--regions", action="store_true", help="also of the ends of pushes at the edge")
    arguments = parser.parse_args()
    for name in arguments.objects:
        world = ModelWorld(benchmark_object(name))
        true = world.true_object.mass @ world.true_object.grid.centers / world.true_object.total_mass
        errors, held = [], np.zeros(2, dtype=int)
        rarities: Regions = {}
        for seed in range(arguments.seed, arguments.seed + arguments.explorations):
            belief, taught = explored(world, seed)
            errors.append(belief.probability @ belief.centers_of_mass - true)
            found = [interval(values, belief.probability) for values in belief.centers_of_mass.T]
            held += [low <= value <= high for (_, low, high), value in zip(found, true, strict=True)]
            print(
                f"{name}, seed {seed}: centre of mass off by {np.round(1e3 * errors[-1], 1)} mm", flush=True
            )
            if arguments.regions:
                add_rarities(rarities, world, belief, taught, seed)
        print(
            f"{name}: 90 % intervals hold the centre of mass (x, y) in {held} of {arguments.explorations};"
            f" mean error {np.round(1e3 * np.mean(errors, axis=0), 1)} mm,"
            f" root mean square {np.round(1e3 * np.sqrt(np.mean(np.square(errors), axis=0)), 1)} mm"
        )
        for (whose, place), values in sorted(rarities.items()):
            inside = [round(100 * np.mean(np.array(values) >= 1.0 - level)) for level in LEVELS]
            print(f"{name}, {whose}, {place}: {len(values)} pushes, inside 50, 90, 95 % regions: {inside} %")


if __name__ == "__main__":
    main()
