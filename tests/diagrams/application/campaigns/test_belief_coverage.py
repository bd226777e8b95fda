"""A trial of `slipmap campaign coverage`, in a world that is the model itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slipmap.diagrams.application.campaigns import belief_coverage
from slipmap.diagrams.application.campaigns.belief_coverage import PLACES, coverage, place_of, trial
from slipmap.diagrams.application.campaigns.worlds import WorldNoise
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.objects.benchmark_objects import benchmark_object
from tests.planners.cell_world import TABLE, CellWorld, belief_about

HAMMER = benchmark_object("hammer")


class World(CellWorld):
    """A `DirectWorld` as far as a trial asks for one; its finger stops with the object."""

    true_object, noise = HAMMER, WorldNoise()

    def __init__(self) -> None:
        super().__init__("hammer", np.zeros(3), 0, noise=0.2)

    def reset(self, pose, rng) -> None:
        self.pose, self._rng = np.array(pose, dtype=float), rng


def test_a_trial_looks_up_where_every_push_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hypotheses around the truth: regions hold nearly all ends; sure ones of another object hold few."""
    world, right = World(), belief_about(HAMMER, hypotheses=12)
    light = HAMMER.mass * np.where(HAMMER.grid.centers[:, 0] > 0.0, 4.0, 0.25)
    wrong = replace(right, maps=replace(right.maps[:1], mass=light[None]), probability=np.ones(1))
    monkeypatch.setattr(belief_coverage, "world_of", lambda truth, name: world)
    shares = []
    for belief in (right, wrong):
        monkeypatch.setattr(belief_coverage, "identified", lambda *told, belief=belief: belief)
        pushes = []
        for seed in range(2):
            world.lowest = np.inf
            pushes += trial(seed=seed, truth="plant", object_name="hammer", belief_seed=0)["pushes"]
        assert {push["place"] for push in pushes} >= {"rim_at_end", "over_rim"}
        assert all(0 <= push["rarity"] <= 1 and push["error"] > 0 for push in pushes)
        counted = coverage(pushes)
        assert sum(row["pushes"] for row in counted.values()) == len(pushes)
        shares.append(np.mean([push["rarity"] >= 0.05 for push in pushes]))
    assert shares[0] > 0.8 > 0.5 > shares[1]


@pytest.mark.parametrize("table", [TABLE, Table("rectangle", (0.0, 0.0), None, (1.0, 1.0))])
def test_places(table: Table) -> None:
    middle, out = np.zeros(3), np.array([0.47, 0.0, 0.0])
    found = [place_of(*ends, HAMMER.grid, table) for ends in ((middle, middle), (middle, out), (out, middle))]
    assert tuple(found) == PLACES
    assert place_of(out, out, HAMMER.grid, table) == "over_rim"
