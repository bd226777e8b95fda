import numpy as np

from slipmap.models.perception.object_mask import Hull, draw_hulls


def test_a_capsule_covers_what_the_camera_sees_of_it(scene):
    p1, p2, radius = np.array([-0.2, 0.1, 0.3]), np.array([0.25, -0.05, 0.7]), 0.04
    mask = draw_hulls([Hull(np.array([p1, p2]), radius)], scene.view, margin=0.0)[::2, ::2]
    # The distance of each pixel's ray from the axis tells whether it hits the capsule.
    rays = scene.view.rays[::2, ::2].reshape(-1, 3).astype(float)
    axis = p1 + np.linspace(0, 1, 80)[:, None] * (p2 - p1)
    hit = np.zeros(len(rays), bool)
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    for point in axis:
        offset = point - scene.view.p_WC
        hit |= np.linalg.norm(offset - (unit @ offset)[:, None] * unit, axis=1) < radius
    hit = hit.reshape(240, 320)
    assert hit.sum() > 1500
    assert np.sum(hit & ~mask) < 0.002 * hit.sum()
    assert mask.sum() < 1.2 * hit.sum()


def test_a_margin_widens_the_mask_and_what_is_behind_the_camera_is_not_drawn(scene):
    finger = Hull(np.array([[0.0, 0, 0.02], [0, 0, 0.1]]), 0.008)
    narrow, wide = (draw_hulls([finger], scene.view, margin) for margin in (0.0, 0.01))
    assert narrow.sum() > 0
    assert wide.sum() > 2 * narrow.sum()
    assert not np.any(narrow & ~wide)
    assert not np.any(draw_hulls([Hull(np.array([[0.0, 0, 1.5]]), 0.1)], scene.view))
