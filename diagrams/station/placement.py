"""Checks that an object can be explored where it lies: on the table, in reach of the finger, in view."""

from typing import TYPE_CHECKING

import numpy as np
from shapely.affinity import rotate, translate
from shapely.geometry import Polygon

from slipmap.diagrams.perception.camera import NEAREST
from slipmap.models.objects.meshes import DOUBTFUL_EXTENT
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.perception.object_mask import LEAST_AREA, LEAST_HEIGHT
from slipmap.models.perception.pinhole_camera import View

if TYPE_CHECKING:
    from slipmap.diagrams.station.scenario import Scenario

_CLEARANCE = 0.02  # m, between the moving finger and what it passes over


def check_placement(scenario: "Scenario", thing: TrueObject) -> None:
    """Refuse an object that cannot be pushed and seen where it lies.

    Raises:
        ValueError: it does not lie on the table; the finger cannot pass over it, or would do so in a push;
            the camera does not see it. The text has the numbers.
    """
    x, y, degrees = scenario.object.pose
    lies = translate(rotate(thing.grid.polygon, degrees, origin=(0.0, 0.0)), x, y)
    _check_table(scenario, thing, lies)
    _check_size(thing, lies)
    _check_finger(scenario, thing)
    _check_camera(scenario, thing, lies)


def check_rest(scenario: "Scenario", thing: TrueObject) -> None:
    """Refuse an object that slides off a tilted table by itself, by a ValueError with the numbers."""
    tilt = scenario.hidden.table_tilt
    slope = float(np.hypot(np.tan(tilt.down_x), np.tan(tilt.down_y)))
    friction = float(thing.mass @ thing.mu) / thing.total_mass
    if slope >= friction:
        raise ValueError(
            f"hidden.table_tilt: object {thing.name} slides off by itself: the table is tilted by"
            f" {np.degrees(np.arctan(slope)):.1f}°, but friction only holds up to"
            f" {np.degrees(np.arctan(friction)):.1f}°"
        )


def _check_table(scenario: "Scenario", thing: TrueObject, lies: Polygon) -> None:
    corners, table = np.asarray(lies.exterior.coords), scenario.table
    if table.shape == "round":
        on_table = bool((np.hypot(*corners.T) < table.radius).all())
        size = f"a radius of {table.radius:g} m"
    else:
        on_table = bool((np.abs(corners) < np.array(table.size) / 2).all())
        size = f"sides of {table.size[0]:g} m and {table.size[1]:g} m"
    if on_table:
        return
    extent = np.ptp(corners, axis=0)
    x, y, _ = scenario.object.pose
    unit = "; is object.metres_per_unit right?" if extent.max() > DOUBTFUL_EXTENT else ""
    raise ValueError(
        f"object.pose: {thing.name} at x = {x:g} m, y = {y:g} m, {extent[0]:.2f} m by {extent[1]:.2f} m, does"
        f" not lie on the table, which has {size}{unit}"
    )


def _check_finger(scenario: "Scenario", thing: TrueObject) -> None:
    execution = scenario.execution
    highest = execution.safe_height - _CLEARANCE
    if thing.height.max() > highest:
        raise ValueError(
            f"object {thing.name} is {thing.height.max():.3f} m high; the finger passes over objects of at"
            f" most {highest:.3f} m (execution.safe_height less {_CLEARANCE} m); raise safe_height"
        )
    lowest = min(block.height for block in thing.blocks)
    if execution.tip_height >= lowest:
        raise ValueError(
            f"execution.tip_height is {execution.tip_height:g} m, but the lowest part of object"
            f" {thing.name} is {lowest:.3g} m high: the finger would pass over it; lower tip_height"
        )


def _check_size(thing: TrueObject, lies: Polygon) -> None:
    highest = float(thing.height.max())
    if highest < LEAST_HEIGHT or lies.area < LEAST_AREA:
        raise ValueError(
            f"object {thing.name} is {1e3 * highest:.1f} mm high and covers {1e4 * lies.area:.1f} cm²; to be"
            f" detected, it must be at least {1e3 * LEAST_HEIGHT:.0f} mm high and cover at least"
            f" {1e4 * LEAST_AREA:.0f} cm²"
        )


def _check_camera(scenario: "Scenario", thing: TrueObject, lies: Polygon) -> None:
    camera, highest = scenario.camera, float(thing.height.max())
    if camera.height - highest < NEAREST:
        raise ValueError(
            f"camera.height: at {camera.height:g} m the top of object {thing.name} is"
            f" {camera.height - highest:.3f} m away; the camera needs at least {NEAREST:g} m"
        )
    corners = np.asarray(lies.exterior.coords)
    top = np.column_stack([corners, np.full(len(corners), highest)])
    pixels, _ = View(camera.intrinsics, camera.X_WC.GetAsMatrix4()).project(top)
    size = np.array([camera.width, camera.height_pixels])
    outside = (pixels < 0.0) | (pixels > size - 1.0)
    if outside.any():
        x, y, _ = scenario.object.pose
        middle = (size - 1) / 2 / camera.focal * (camera.height - highest)
        raise ValueError(
            f"camera: object {thing.name} at x = {x:g} m, y = {y:g} m is not wholly in the picture, which"
            f" shows {2 * middle[0]:.2f} m by {2 * middle[1]:.2f} m about ({camera.position[0]:g},"
            f" {camera.position[1]:g}) m; check camera.position, height, yaw and fov_y"
        )
