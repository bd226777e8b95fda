import numpy as np
import pytest
from heights_seen import heights_seen

from slipmap.models.perception.pinhole_camera import TablePlane
from slipmap.models.perception.seen_object import Relief

ELL = ((-0.1, -0.06, 0.1, 0.0, 0.03), (-0.1, 0.0, -0.03, 0.08, 0.09))
LEVEL = 2e-3  # m between the heights at which a ray is compared with the map
SPACING = 1e-3  # m


def relief_of(boxes):
    x, y = np.arange(-0.15, 0.15, SPACING), np.arange(-0.1, 0.12, SPACING)
    heights = np.zeros((len(y), len(x)), np.float32)
    for x0, y0, x1, y1, height in boxes:
        inside = (x0 <= x) & (x < x1) & ((y0 <= y) & (y < y1))[:, None]
        heights[inside] = height
    return Relief(np.array([x[0], y[0]]), heights)


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (0.31, -0.12, 2.1), (-0.2, 0.25, -0.7)])
def test_a_ray_sees_the_height_at_which_it_meets_the_boxes(scene, pose):
    depth = scene.depth(ELL, pose)
    meant = (scene.view.p_WC + depth[..., None] * scene.view.rays)[..., 2]
    rows, columns = np.meshgrid(np.arange(480), np.arange(640), indexing="ij")
    pixels = np.stack([columns, rows], axis=-1).astype(float)
    seen = heights_seen(relief_of(ELL), pixels, pose, TablePlane(), scene.view)
    meant[~np.isfinite(depth)] = 0.0
    on_object = meant > LEVEL
    assert on_object.sum() > 3000
    off = np.abs(seen - meant)
    # On tops and on the table exactly; on flanks within two levels; by a rim the map's grid decides.
    assert np.mean(off < 1e-4) > 0.95
    assert np.mean(off[on_object] < 2 * LEVEL) > 0.9


def test_heights_between_and_beside_the_points_of_the_map():
    relief = Relief(np.array([-0.002, 0.0]), np.array([[0, 0, 0], [0, 5, 0], [0, 7, 9]], np.float32))
    points = np.array([[-1.2e-3, 1.4e-3], [-1.4e-3, 1.6e-3], [0.2e-3, 2.4e-3], [5e-3, 1e-3], [-1e-3, -2e-3]])
    np.testing.assert_array_equal(relief.at(points), [5, 7, 9, 0, 0])
    np.testing.assert_array_equal(relief.at(points[:, None])[:, 0], relief.at(points))
