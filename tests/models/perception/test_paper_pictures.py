"""Depth pictures of a real sensor: footprints against labels drawn by hand over the colour pictures."""

import cv2
import numpy as np
import pytest
from heights_seen import heights_seen

from slipmap.models.perception.first_look import first_look
from slipmap.models.perception.pinhole_camera import PinholeCamera, View

LEAST = {"book": 0.85, "box": 0.85, "snack": 0.85, "hammer": 0.75, "spray_gun": 0.75, "wrench": 0.5}
DISTANCE = 0.52  # m
FOCAL = DISTANCE * 640 / 0.53  # pixels


@pytest.fixture(scope="module")
def view():
    X_WC = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, DISTANCE], [0, 0, 0, 1]])
    return View(PinholeCamera(640, 480, FOCAL, FOCAL, 319.5, 239.5), X_WC)


def seen_area(depth, view):
    """Pixels that show the object as it was understood: its footprint and heights, seen from the camera."""
    seen = first_look([depth], view)
    assert seen.angle_seen
    pixels = np.stack(np.meshgrid(np.arange(0, 640, 2.0), np.arange(0, 480, 2.0)), axis=-1)
    return heights_seen(seen.relief, pixels, seen.first_pose, seen.table, view) > 0


def overlap(area, label, shift):
    moved = np.roll(area, (shift[1], shift[0]), axis=(0, 1))
    return (moved & label).sum() / (moved | label).sum()


def test_footprints_from_depth_alone_overlap_the_labels(shared_data, view):
    folder = shared_data / "paper_objects"
    pairs = {}
    for name in LEAST:
        depth = cv2.imread(str(folder / f"{name}_depth.png"), cv2.IMREAD_UNCHANGED).astype(np.float32) / 1000
        label = cv2.imread(str(folder / f"{name}_label.png"), cv2.IMREAD_UNCHANGED) > 0
        label = label[::2, ::2]
        pairs[name] = seen_area(depth, view), label
    shifts = [(x, y) for x in range(-5, 6) for y in range(-5, 6)]
    shift = max(shifts, key=lambda s: sum(overlap(*pair, s) for pair in pairs.values()))
    found = {name: float(overlap(*pair, shift)) for name, pair in pairs.items()}
    print(shift, found)
    assert all(found[name] >= LEAST[name] for name in LEAST), (shift, found)
