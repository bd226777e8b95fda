import subprocess
import sys

import numpy as np
import pytest

from slipmap.diagrams.perception.camera import CameraConfig

TRIAL = """
from slipmap.diagrams.perception.renderer import RendererUnavailable, require_renderer
try:
    require_renderer()
except RendererUnavailable as error:
    print(error)
"""


def test_the_whole_table_is_seen_in_the_middle_of_the_picture(world):
    depth = world.depth(world.context())
    rows, columns = np.nonzero(np.isfinite(depth))
    # Half a pixel off would be 1.1 mm on the table.
    assert columns.mean() == pytest.approx(world.view.camera.center_x, abs=0.05)
    assert rows.mean() == pytest.approx(world.view.camera.center_y, abs=0.05)
    area = len(rows) * (world.config.height / world.view.camera.focal_x) ** 2
    assert area == pytest.approx(np.pi * 0.5**2, rel=3e-3)


def test_points_seen_lie_where_the_object_is(world):
    context = world.context()
    world.place(context, "box", (0.15, -0.1, 0.0))
    depth = world.depth(context)
    points = world.view.p_WC + depth[..., None] * world.view.rays
    top = points[np.isfinite(depth) & (points[..., 2] > 0.068)]
    x, y = (top[:, k].max() + top[:, k].min() for k in (0, 1))
    assert x / 2 == pytest.approx(0.15, abs=1.5e-3)
    assert y / 2 == pytest.approx(-0.1, abs=1.5e-3)


def test_missing_libraries_are_an_error_that_names_the_packages(tmp_path):
    environment = {"__EGL_VENDOR_LIBRARY_FILENAMES": "/dev/null", "PYTHONPATH": ".", "HOME": str(tmp_path)}
    command = [sys.executable, "-c", TRIAL]
    result = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    for package in ("libegl1", "libgl1-mesa-dri", "libglib2.0-0"):
        assert package in result.stdout


@pytest.mark.parametrize("name, value", [("height", 0.0), ("fov_y", 4.0), ("rate", -1.0), ("yaw", np.nan)])
def test_impossible_cameras_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        CameraConfig(**{name: value})
