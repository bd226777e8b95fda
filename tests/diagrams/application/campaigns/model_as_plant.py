"""Beliefs of explorations in which the model itself plays the plant, so that nothing is wrong with it.

`python tests/diagrams/application/campaigns/model_as_plant.py wrench hammer` makes twenty of each object.
"""

from __future__ import annotations

import argparse

import numpy as np

from slipmap.diagrams.application.campaigns.worlds import PERIOD, DirectWorld, Motion, explored
from slipmap.models.inference.summaries import interval
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.pushes import Push
from slipmap.models.physics.rollout import Slider

STEP = PERIOD / 2  # s


class ModelWorld(DirectWorld):
    """An object that slides as the cell-grid model with its true maps says."""

    def __init__(self, true_object: TrueObject) -> None:
        super().__init__(true_object)
        self._slider = Slider(true_object.grid, self.finger_radius)
        self._at = np.zeros(3)

    @property
    def _step(self) -> float:
        return STEP

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


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Explore objects that slide as the model says.")
    parser.add_argument("objects", nargs="+", metavar="OBJECT")
    parser.add_argument("--explorations", type=int, default=20, metavar="N", help="of each object")
    parser.add_argument("--seed", type=int, default=80, help="of the first exploration")
    arguments = parser.parse_args()
    for name in arguments.objects:
        world = ModelWorld(benchmark_object(name))
        true = world.true_object.mass @ world.true_object.grid.centers / world.true_object.total_mass
        errors, held = [], np.zeros(2, dtype=int)
        for seed in range(arguments.seed, arguments.seed + arguments.explorations):
            belief, _ = explored(world, seed)
            errors.append(belief.probability @ belief.centers_of_mass - true)
            found = [interval(values, belief.probability) for values in belief.centers_of_mass.T]
            held += [low <= value <= high for (_, low, high), value in zip(found, true, strict=True)]
            print(f"{name}, seed {seed}: centre of mass off by {np.round(1e3 * errors[-1], 1)} mm")
        print(
            f"{name}: 90 % intervals hold the centre of mass (x, y) in {held} of {arguments.explorations};"
            f" mean error {np.round(1e3 * np.mean(errors, axis=0), 1)} mm,"
            f" root mean square {np.round(1e3 * np.sqrt(np.mean(np.square(errors), axis=0)), 1)} mm"
        )


if __name__ == "__main__":
    main()
