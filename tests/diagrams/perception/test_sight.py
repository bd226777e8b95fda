"""What the camera sees of an object past the arm and inside its picture."""

from types import SimpleNamespace

import numpy as np
import pytest

from slipmap.diagrams.perception.camera import CameraConfig
from slipmap.diagrams.perception.sight import Sight
from slipmap.models.objects import cells_from_polygon
from slipmap.models.perception.object_mask import Hull
from slipmap.models.perception.pinhole_camera import TablePlane, View

GRID = cells_from_polygon(np.array([[-10, -2], [10, -2], [10, 2], [-10, 2]]) * 0.01, width=0.01)
SEEN = SimpleNamespace(grid=GRID, cell_heights=np.full(len(GRID), 0.02), table=TablePlane())
CONFIG = CameraConfig()
VIEW = View(CONFIG.intrinsics, CONFIG.X_WC.GetAsMatrix4())


def test_all_is_seen_in_the_middle_and_half_where_the_picture_ends():
    sight = Sight(VIEW, [])
    assert sight.share(SEEN, np.array([0.1, -0.1, 0.7])) == 1.0
    # At a height of 0.02 m the picture ends where the slope of the outermost ray says.
    edge = (CONFIG.height - 0.02) * np.tan(CONFIG.fov_y / 2)
    assert sight.share(SEEN, np.array([0.0, edge, np.pi / 2])) == pytest.approx(0.5, abs=0.06)
    assert sight.share(SEEN, np.array([0.0, edge + 0.2, 0.0])) == 0.0


def test_more_is_seen_on_a_table_that_is_lower_than_it_should_be():
    low = SimpleNamespace(**{**vars(SEEN), "table": TablePlane(height=-0.04)})
    edge = (CONFIG.height + 0.02) * np.tan(CONFIG.fov_y / 2)
    middle = np.array([0.0, edge - 0.08, np.pi / 2])
    assert Sight(VIEW, []).share(low, middle) == pytest.approx(0.9, abs=0.01)
    assert Sight(VIEW, []).share(SEEN, middle) == pytest.approx(0.75, abs=0.06)


def test_what_the_arm_hides_is_not_seen():
    """A wall just over the object, which covers everything at x > 0.3 m."""
    wall = Hull(np.array([[x, y, z] for x in (0.3, 0.9) for y in (-0.6, 0.6) for z in (0.02, 0.021)]), 0.0)
    sight = Sight(VIEW, [wall])
    assert sight.share(SEEN, np.array([0.1, 0.0, 0.0])) == 1.0
    assert sight.share(SEEN, np.array([0.3, 0.0, 0.0])) == pytest.approx(0.5, abs=0.06)
    assert sight.share(SEEN, np.array([0.35, 0.1, np.pi])) == pytest.approx(0.25, abs=0.06)
    assert sight.share(SEEN, np.array([0.45, 0.0, 0.0])) == 0.0
