"""Openings of an object: in descriptions and datasets, and for a finger that pushes from inside of one."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from slipmap.models.measurements import read_dataset, write_dataset
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.maps import Maps
from slipmap.models.physics.rollout import Push, Slider

ANGLES = np.linspace(0, 2 * np.pi, 72, endpoint=False)
CIRCLE = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
OUTER, INNER, FINGER = 0.05, 0.03, 0.008


def described() -> dict:
    shape = {"outline": (OUTER * CIRCLE).tolist(), "holes": [(INNER * CIRCLE).tolist()]}
    return {"object": shape, "finger": {"radius": FINGER}}


@pytest.fixture
def pushed_from_inside(tmp_path):
    """CSV rows of a ring that follows a finger along x, from the touch on, and its description."""
    (tmp_path / "ring.yaml").write_text(yaml.safe_dump(described()))
    tips = np.linspace(0.0, 0.06, 120)
    rows = [f"{0.02 * k},{max(0.0, tip - (INNER - FINGER))},0,0,{tip},0" for k, tip in enumerate(tips)]
    header = "t,object_x,object_y,object_theta,tip_x,tip_y\n"
    (tmp_path / "push.csv").write_text(header + "\n".join(rows) + "\n")
    return read_dataset(tmp_path / "push.csv", object_name=str(tmp_path / "ring.yaml"))


def test_a_finger_in_an_opening_is_outside_of_the_object(pushed_from_inside, tmp_path):
    grid = pushed_from_inside.grid
    assert len(grid.holes) == 1 and np.hypot(*grid.centers.T).min() > INNER - grid.width / 2
    assert pushed_from_inside.warnings == ()
    write_dataset(pushed_from_inside, tmp_path / "again")
    again = read_dataset(tmp_path / "again").grid
    np.testing.assert_allclose(again.holes[0], grid.holes[0])
    np.testing.assert_allclose(again.centers, grid.centers)


def test_a_finger_takes_a_ring_along_from_inside():
    grid = cells_from_polygon(OUTER * CIRCLE, [INNER * CIRCLE], count=40)
    n = len(grid)
    maps = Maps(np.full((1, n), 0.5 / n), np.full((1, n), 0.3), np.array([0.3]))
    tip = np.column_stack([np.linspace(0.0, 0.06, 601), np.zeros(601)])
    end = Slider(grid, FINGER).rollout(maps, [Push(1e-2, tip, np.zeros(3))]).end[0, 0, :3]
    np.testing.assert_allclose(end, [0.06 - (INNER - FINGER), 0.0, 0.0], atol=3e-4)
