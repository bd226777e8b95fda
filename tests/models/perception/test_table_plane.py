import numpy as np
import pytest

from slipmap.models.perception.pinhole_camera import NoTable, TablePlane, fit_table


def tilted(scene, slope_x, slope_y, height):
    rays, start = scene.view.rays.astype(float), scene.view.p_WC
    normal = np.array([-slope_x, -slope_y, 1.0])
    return ((height - normal @ start) / (rays @ normal)).astype(np.float32)


def test_finds_a_tilted_table_of_which_an_object_hides_a_third(scene):
    rng = np.random.default_rng(1)
    depth = tilted(scene, 0.02, -0.01, 0.004)
    depth[100:400, 150:490] -= 0.03
    found = fit_table(scene.noisy(depth, rng), scene.view)
    assert found.slope_x == pytest.approx(0.02, abs=3e-4)
    assert found.slope_y == pytest.approx(-0.01, abs=3e-4)
    assert found.height == pytest.approx(0.004, abs=1e-4)
    heights = found.heights(depth, scene.view)
    assert np.median(heights[150:350, 200:440]) == pytest.approx(0.03, abs=3e-4)
    assert np.abs(heights[:80]).max() < 1e-3


def test_rays_meet_the_table_where_they_are_projected_from(scene):
    table = TablePlane(0.02, -0.01, 0.004)
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (20, 2))
    pixels, depth = scene.view.project(table.lift(points, 0.05))
    assert np.allclose(table.meet(pixels, 0.05, scene.view), points, atol=1e-9)
    assert np.allclose(
        scene.view.p_WC + depth[:, None] * scene.view.rays_at(pixels), table.lift(points, 0.05)
    )


def test_no_reading_is_not_a_height_and_beyond_the_range_is_below(scene):
    depth = tilted(scene, 0, 0, 0)
    depth[10, 10], depth[20, 20] = 0.0, np.inf
    heights = TablePlane().heights(depth, scene.view)
    assert np.isnan(heights[10, 10])
    assert heights[20, 20] == -np.inf


def test_a_picture_without_a_table_is_refused(scene):
    with pytest.raises(NoTable, match="X_WC"):
        fit_table(np.full((480, 640), 0.9, np.float32), scene.view)


def test_a_picture_of_another_size_is_refused(scene):
    with pytest.raises(ValueError, match="480 rows and 640 columns"):
        scene.view.checked_depth(np.zeros((640, 480), np.float32))
