"""Pushes at a table's rim, recorded in Drake's plant: half of them with part of the object beyond it."""

from dataclasses import replace

import numpy as np
import pytest

import slipmap


@pytest.mark.parametrize("name", ["box", "hammer"])
def test_pushes_at_the_rim_are_learnt_from_and_predicted(shared_data, name):
    """Held-out pushes to 2 mm; the same pushes on a floor without a rim were 5.5 and 3.3 mm off."""
    path = shared_data / "edge" / name
    if not path.is_dir():
        pytest.skip(f"no pushes at {path}")
    dataset = slipmap.read_dataset(path)
    found = slipmap.identify(dataset, hypotheses=8, friction_laws=False)
    assert found.belief.table == dataset.table
    heldout = [p.final_add for p in slipmap.predict(found.belief, dataset) if p.role == "heldout"]
    assert len(heldout) == 8
    assert np.mean(heldout) < 2e-3
    floor = replace(dataset, table=None)
    without = [p.final_add for p in slipmap.predict(found.belief, floor) if p.role == "heldout"]
    assert np.mean(without) > 2 * np.mean(heldout)
