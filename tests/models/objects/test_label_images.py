"""From a label image to cells: scale, orientation, half pixels, noise."""

import cv2
import numpy as np
import pytest
import shapely
from numpy.testing import assert_allclose
from shapely.geometry import Polygon

from slipmap.models.objects import cells_from_label_image, contour_cells
from slipmap.models.objects.footprints import polygon_moments
from slipmap.models.objects.images import traced_outline

SCALE = 0.001


def l_picture():
    """An L, foot to the right, with a hole near its top and three segments; 300 × 200 pixels."""
    labels = np.zeros((200, 300), dtype=np.uint8)
    labels[20:180, 30:80] = 1  # upright
    labels[140:180, 30:250] = 2  # foot
    labels[140:180, 230:250] = 7  # tip of the foot
    labels[30:60, 40:65] = 0  # hole
    return labels


def to_object_frame(labels, columns, rows):
    v, u = np.nonzero(labels)
    return SCALE * np.column_stack([columns - u.mean(), v.mean() - rows])


def test_scale_orientation_and_segments():
    labels = l_picture()
    grid, segment = cells_from_label_image(labels, SCALE, width=0.005)
    v, u = np.nonzero(labels)
    # Pixel k reaches from k - 1/2 to k + 1/2.
    low, high = to_object_frame(labels, np.array([29.5, 249.5]), np.array([179.5, 19.5]))
    assert_allclose(grid.polygon.bounds, [*low, *high], atol=1e-9)
    assert grid.polygon.area == pytest.approx(len(u) * SCALE**2, rel=1e-3)
    (hole,) = grid.holes
    middle = to_object_frame(labels, np.array([52.0]), np.array([44.5]))[0]
    assert_allclose(Polygon(hole).centroid.coords[0], middle, atol=1e-9)
    assert middle[0] < 0 < middle[1], "the hole is at the upper left"
    assert Polygon(hole).area == pytest.approx(30 * 25 * SCALE**2, rel=0.01)
    # Every cell has the label of the pixel at its centre, unless a border between segments runs through it.
    column = np.rint(grid.centers[:, 0] / SCALE + u.mean()).astype(int)
    row = np.rint(v.mean() - grid.centers[:, 1] / SCALE).astype(int)
    assert np.mean(segment == labels[row, column]) > 0.95
    assert set(segment) == {1, 2, 7}
    assert segment.shape == (len(grid),)
    tip = grid.centers[segment == 7]
    assert np.all(tip[:, 0] > grid.centers[segment == 1, 0].max())
    assert np.all(tip[:, 1] < np.median(grid.centers[segment == 1, 1]))


def test_picture_file_equals_array(tmp_path):
    path = tmp_path / "object.png"
    cv2.imwrite(str(path), l_picture())
    grid, segment = cells_from_label_image(path, SCALE, count=200)
    expected, expected_segment = cells_from_label_image(l_picture(), SCALE, count=200)
    assert abs(len(grid) - 200) <= 2
    assert_allclose(grid.centers, expected.centers)
    assert segment.tolist() == expected_segment.tolist()
    assert_allclose(grid.exterior, expected.exterior)


def test_sixteen_bit_labels_survive_the_file(tmp_path):
    path = tmp_path / "object.png"
    cv2.imwrite(str(path), l_picture().astype(np.uint16) * 1000)
    _, segment = cells_from_label_image(str(path), SCALE, count=200)
    assert set(segment) == {1000, 2000, 7000}


def test_majority_of_pixels_names_the_segment():
    labels = np.zeros((14, 24), dtype=int)
    labels[2:12, 2:12], labels[2:12, 12:22] = 3, 5
    labels[2:12, 8:12] = 5  # 40 of the left cell's 100 pixels
    grid, segment = cells_from_label_image(labels, SCALE, width=0.01)
    assert_allclose(grid.centers, [[-0.005, 0], [0.005, 0]], atol=1e-9)
    assert segment.tolist() == [3, 5]
    labels[2:12, 2:22] = 5
    labels[5:9, 5:9] = 3  # the middle of the left cell, but only 16 of its pixels
    assert cells_from_label_image(labels, SCALE, width=0.01)[1].tolist() == [5, 5]


def test_cells_smaller_than_pixels():
    labels = np.zeros((4, 6), dtype=int)
    labels[1:3, 1:3], labels[1:3, 3:5] = 1, 2
    grid, segment = cells_from_label_image(labels, SCALE, width=0.0003)
    assert len(grid) > 60
    clear = np.abs(grid.centers[:, 0]) > 0.1 * SCALE
    assert np.all(segment[clear] == np.where(grid.centers[clear, 0] < 0, 1, 2))


def test_origin_is_the_centroid_of_the_mask():
    grid, _ = cells_from_label_image(l_picture(), SCALE, count=1000)
    _, centroid, _ = polygon_moments(grid.polygon)
    assert_allclose(centroid, 0, atol=0.02 * SCALE)
    assert_allclose(grid.centers.mean(axis=0), 0, atol=0.5 * grid.width)


@pytest.mark.parametrize("degrees", [0, 3, 10, 26.565, 37, 45, 80])
def test_oblique_edges_are_straight_and_in_place(degrees):
    a = np.deg2rad(degrees)
    turn = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    true = np.array([[-90, -40], [90, -40], [90, 40], [-90, 40]]) @ turn.T
    u, v = np.meshgrid(np.arange(300), np.arange(300))
    inside = shapely.contains_xy(Polygon(true + np.array([150.3, 149.6])), u.ravel(), v.ravel()).reshape(
        u.shape
    )
    grid, _ = cells_from_label_image(inside, SCALE, count=100)
    expected = Polygon(SCALE * true * [1, -1])
    assert grid.polygon.area == pytest.approx(expected.area, rel=5e-3)
    assert grid.polygon.length == pytest.approx(expected.length, rel=5e-3), "stairs are left"
    assert grid.polygon.hausdorff_distance(expected) < 0.8 * SCALE
    assert len(grid.exterior) <= 10
    _, points, normals = contour_cells(grid)
    nearest = expected.exterior
    off = [nearest.distance(p) for p in shapely.points(points)]
    assert max(off) < 0.6 * SCALE
    sides = turn @ [[1, 0, -1, 0], [0, 1, 0, -1]] * [[1], [-1]]
    assert_allclose(np.max(normals @ sides, axis=1), 1.0, atol=1 - np.cos(np.deg2rad(3)))


def test_outline_follows_the_mask_within_a_pixel():
    rng = np.random.default_rng(3)
    blob = cv2.GaussianBlur(rng.standard_normal((200, 200)), (0, 0), 9)
    v, u = np.mgrid[:200, :200]
    mask = (np.hypot(u - 100, v - 100) < 70) & (blob > -0.02)
    _, pieces, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    mask = pieces == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])
    grid, _ = cells_from_label_image(mask, SCALE, count=300)
    outline = shapely.transform(
        grid.polygon, lambda xy: xy / SCALE * [1, -1] + [u[mask].mean(), v[mask].mean()]
    )
    drawn = shapely.contains_xy(outline, u.ravel(), v.ravel()).reshape(mask.shape)
    border = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3))) != cv2.erode(
        mask.astype(np.uint8), np.ones((3, 3))
    )
    small_holes = np.zeros_like(mask)
    number, holes, stats, _ = cv2.connectedComponentsWithStats((~mask).astype(np.uint8), connectivity=8)
    for k in range(1, number):
        small_holes |= (holes == k) & (stats[k, cv2.CC_STAT_AREA] < 0.011 * mask.sum())
    assert not np.any((drawn != mask) & ~border & ~small_holes)
    assert len(grid.holes) > 0
    assert np.mean((drawn != mask)[border & ~small_holes]) < 0.15


def test_specks_are_noise_and_small_holes_are_filled():
    labels = l_picture()
    expected, _ = cells_from_label_image(labels, SCALE, count=100)
    labels[5:7, 280:284] = 1
    labels[100, 50] = 0
    grid, _ = cells_from_label_image(labels, SCALE, count=100)
    assert len(grid.holes) == 1
    assert grid.polygon.area == pytest.approx(expected.polygon.area, rel=1e-9)


def test_single_pixel_and_thin_line():
    labels = np.zeros((5, 9), dtype=np.uint8)
    labels[2, 3] = 4
    grid, segment = cells_from_label_image(labels, 0.01, count=1)
    assert segment.tolist() == [4]
    assert_allclose(grid.centers, [[0, 0]], atol=1e-12)
    labels[2, 1:8] = 4
    grid, _ = cells_from_label_image(labels, 0.01, count=7)
    assert_allclose(grid.centers[:, 0], 0.01 * np.arange(-3, 4), atol=2e-3)


def test_object_at_the_border_of_the_picture():
    grid, _ = cells_from_label_image(np.ones((10, 20), dtype=np.uint8), SCALE, count=8)
    assert_allclose(grid.polygon.bounds, SCALE * np.array([-10, -5, 10, 5]), atol=1e-9)


def test_a_background_is_not_taken_for_the_object():
    picture = l_picture()
    inverted = np.where(picture == 0, 255, 0)
    nothing_zero = np.where(picture == 0, 200, picture)
    with pytest.raises(ValueError, match=r"covers 100 % of the picture's border.* give background=255"):
        cells_from_label_image(inverted, SCALE, count=9)
    with pytest.raises(ValueError, match=r"give background=200"):
        cells_from_label_image(nothing_zero, SCALE, count=9)
    expected, _ = cells_from_label_image(picture, SCALE, count=9)
    for image, background in ((inverted, 255), (nothing_zero, 200)):
        grid, _ = cells_from_label_image(image, SCALE, count=9, background=background)
        assert_allclose(grid.centers, expected.centers)


@pytest.mark.parametrize("kind", ["png", "tiff"])
def test_a_picture_is_turned_as_its_camera_noted(tmp_path, kind):
    from PIL import Image

    labels = np.zeros((20, 40), np.uint8)
    labels[5:10, 4:36] = 1
    noted = Image.Exif()
    noted[274] = 6  # the first row is the right side
    Image.fromarray(labels).save(tmp_path / f"photo.{kind}", exif=noted)
    grid, _ = cells_from_label_image(tmp_path / f"photo.{kind}", SCALE, count=9)
    assert_allclose(np.ptp(grid.exterior, axis=0), SCALE * np.array([5, 32]), atol=1e-9)


def test_another_background():
    grid, segment = cells_from_label_image(
        np.where(l_picture() == 0, 255, l_picture()), SCALE, count=9, background=255
    )
    expected, _ = cells_from_label_image(l_picture(), SCALE, count=9)
    assert_allclose(grid.centers, expected.centers)
    assert 255 not in segment


def test_pieces_that_meet_in_a_corner_are_separate():
    labels = np.zeros((20, 20), dtype=np.uint8)
    labels[2:10, 2:10] = labels[10:16, 10:16] = 1
    with pytest.raises(
        ValueError, match=r"besides the largest \(64 pixels\) there is one of 36 pixels at column 10"
    ):
        cells_from_label_image(labels, SCALE, count=4)


def test_ring_that_is_closed_by_a_corner():
    labels = np.zeros((40, 40), dtype=np.uint8)
    labels[5:35, 5:35] = 1
    labels[12:28, 12:28] = 0
    labels[28:35, 28:35] = 0  # the hole and the outside meet in a corner
    grid, _ = cells_from_label_image(labels, SCALE, count=50)
    assert grid.polygon.is_valid
    assert grid.polygon.area == pytest.approx(np.count_nonzero(labels) * SCALE**2, rel=0.01)


@pytest.mark.parametrize(
    ("labels", "scale", "message"),
    [
        (np.zeros((4, 4), dtype=int), SCALE, "no object, every pixel has the background label 0"),
        (np.ones((4, 4, 3), dtype=np.uint8), SCALE, "one channel"),
        (np.ones((4, 4)), SCALE, "whole numbers, got float64"),
        (np.ones((4, 4), dtype=int), 0.0, "metres_per_pixel must be a positive length, got 0.0"),
        (np.ones((4, 4), dtype=int), np.nan, "metres_per_pixel"),
        (
            np.ones((4, 4), dtype=int),
            1e-9,
            "metres_per_pixel = 1e-09 the object measures 3e-09 m; .* 0.001 and 5",
        ),
        (np.ones((4, 4), dtype=int), 1e300, "metres_per_pixel = 1e.300 the object measures 3e.300 m"),
        (np.ones((0, 4), dtype=int), SCALE, "no object|empty"),
    ],
)
def test_wrong_input_is_refused(labels, scale, message):
    with pytest.raises(ValueError, match=message):
        cells_from_label_image(labels, scale, count=4)


def test_the_greys_of_a_soft_edge_are_no_labels():
    sharp = np.uint8(50) * (l_picture() > 0)
    big = np.asarray(cv2.resize(sharp, (1200, 800), interpolation=cv2.INTER_NEAREST))
    slanted = cv2.warpAffine(big, cv2.getRotationMatrix2D((600.0, 400.0), 20.0, 0.7), (1200, 800))
    drawn = cv2.resize(slanted, (300, 200), interpolation=cv2.INTER_AREA)
    for soft in (cv2.GaussianBlur(sharp, (9, 9), 3), drawn):
        with pytest.raises(ValueError, match=r"edge is made of \d+ values .*; give its pixels one value"):
            cells_from_label_image(soft, SCALE, count=40)
    assert len(cells_from_label_image(sharp, SCALE, count=40)[0]) == 40


def test_many_thin_segments_are_labels():
    labels = np.zeros((80, 100), dtype=np.uint8)
    labels[20:60, 20:80] = 1 + np.arange(60) // 2  # stripes of two pixels
    _, segment = cells_from_label_image(labels, SCALE, width=2 * SCALE)
    assert len(set(segment)) == 30


def test_wrong_files_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"missing\.png: there is no such file"):
        cells_from_label_image(tmp_path / "missing.png", SCALE, count=4)
    text = tmp_path / "text.png"
    text.write_text("not a picture")
    with pytest.raises(ValueError, match=r"text\.png: not a picture"):
        cells_from_label_image(text, SCALE, count=4)
    colour = tmp_path / "colour.png"
    cv2.imwrite(str(colour), np.ones((4, 4, 3), dtype=np.uint8))
    with pytest.raises(ValueError, match=r"colour\.png: expected one channel"):
        cells_from_label_image(colour, SCALE, count=4)


@pytest.mark.parametrize(
    ("name", "count", "segments", "holes"),
    [
        ("book", 28, 2, 0),
        ("box", 65, 2, 0),
        ("hammer", 88, 2, 0),
        ("wrench", 60, 3, 1),
        ("snack", 44, 2, 0),
        ("spray_gun", 56, 2, 0),
    ],
)
def test_pictures_of_the_papers_objects(shared_data, name, count, segments, holes):
    path = shared_data / "paper_objects" / f"{name}_label.png"
    scale = 0.53 / 640
    labels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    grid, segment = cells_from_label_image(path, scale, count=count)
    assert abs(len(grid) - count) <= 1
    assert len(grid.holes) == holes
    assert set(segment) <= set(range(1, segments + 1))
    assert grid.polygon.area == pytest.approx(np.count_nonzero(labels) * scale**2, rel=0.01)
    fine, fine_segment = cells_from_label_image(path, scale, count=2000)
    assert abs(len(fine) - 2000) <= 25
    for k in range(1, segments + 1):
        share = np.count_nonzero(labels == k) / np.count_nonzero(labels)
        assert np.mean(fine_segment == k) == pytest.approx(share, abs=0.02)
        middle = to_segment_middle(labels, k, scale)
        assert_allclose(fine.centers[fine_segment == k].mean(axis=0), middle, atol=0.75 * fine.width)


def to_segment_middle(labels, k, scale):
    v, u = np.nonzero(labels)
    row, column = np.nonzero(labels == k)
    return scale * np.array([column.mean() - u.mean(), v.mean() - row.mean()])


@pytest.mark.parametrize("radius", [6, 10, 20, 50, 100])
def test_traced_disc_keeps_area_and_perimeter(radius):
    u, v = np.meshgrid(np.arange(220), np.arange(220))
    outline = traced_outline(np.hypot(u - 110.3, v - 109.6) < radius)
    assert outline.area == pytest.approx(np.pi * radius**2, rel=0.3 / radius)
    assert outline.length == pytest.approx(2 * np.pi * radius, rel=0.6 / radius)
    assert_allclose(outline.centroid.coords[0], [110.3, 109.6], atol=0.15)


def test_traced_random_masks_are_valid_and_keep_their_area():
    rng = np.random.default_rng(0)
    holes = 0
    for _ in range(100):
        noise = cv2.GaussianBlur(rng.standard_normal((90, 90)), (0, 0), rng.uniform(0.8, 8))
        _, pieces, stats, _ = cv2.connectedComponentsWithStats((noise > 0).astype(np.uint8), connectivity=4)
        mask = pieces == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])
        outline = traced_outline(mask)
        assert outline.is_valid
        assert abs(outline.area - mask.sum()) < 0.1 * outline.length + 1
        holes += len(outline.interiors)
    assert holes > 100


@pytest.mark.parametrize("pixels", [1, 2, 3])
def test_traced_thin_line_keeps_its_thickness(pixels):
    mask = np.zeros((9, 40), dtype=bool)
    mask[3 : 3 + pixels, 5:35] = True
    outline = traced_outline(mask)
    assert outline.area == pytest.approx(30 * pixels, rel=0.03)
    assert_allclose(outline.bounds, [4.5, 2.5, 34.5, 2.5 + pixels], atol=0.51)
