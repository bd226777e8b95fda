"""Checks, before anything moves, that an object can be explored where it lies: on the table, in reach of the
finger, in view; and that a simulated camera can detect it and a simulated arm move it.
"""

from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.special import erf
from shapely.affinity import rotate, translate
from shapely.geometry import Polygon, box

from slipmap.diagrams.perception.camera import NEAREST
from slipmap.diagrams.perception.cell_perception import FRAMES
from slipmap.diagrams.perception.sight import ArmHulls, view_from
from slipmap.diagrams.station.arm import HOME, lone_arm
from slipmap.diagrams.station.hidden_effects import tether_pull, tilted_gravity
from slipmap.diagrams.station.sliding_object import FEET, foot_frictions, side_contact
from slipmap.models.geometry import turn
from slipmap.models.objects.meshes import DOUBTFUL_EXTENT
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.perception.first_look import ARM_NEAR
from slipmap.models.perception.object_mask import LEAST_AREA, LEAST_HEIGHT, draw_hulls
from slipmap.models.perception.pinhole_camera import LEAST_SHARE, NARROWEST, View, pixel_size
from slipmap.models.physics.cell_grid import FloatArray

if TYPE_CHECKING:
    from slipmap.diagrams.station.scenario import Scenario

LONGEST_LOOK = 60.0  # longest time that the pictures of the first look may take, s
_STRONGEST = 137.0  # N; the arm's payload, 14 kg
# Blocks, sheets and cans are found in all pictures with noise of 1.6 mm and 0.4 pixels, in two of three with
# 2.2 mm or 1 pixel, in none with 3.2 mm or 2 pixels; at a size of 67 pixels in one of ten, of 30 in none.
_MOST_NOISE = 2.8e-3  # m, standard deviation of depth at the table
_MOST_JITTER = 1.8  # pixels
_FEWEST_PIXELS = 50
_CLEARANCE = 0.02  # m, between the moving finger and what it passes over


def check_placement(scenario: "Scenario", thing: TrueObject) -> None:
    """Refuse an object that cannot be pushed and seen where it lies.

    Raises:
        ValueError: it does not lie on the table; the finger cannot pass over it, or would do so in a push;
            the camera does not see it. The text has the numbers.
    """
    lies = _lies(scenario, thing)
    _check_table(scenario, thing, lies)
    _check_size(thing, lies)
    _check_finger(scenario, thing)
    _check_camera(scenario, thing, lies)


def check_rest(scenario: "Scenario", thing: TrueObject) -> None:
    """Refuse an object that a tilted table or a tether moves by itself, by a ValueError with the numbers."""
    tilt, tether = scenario.hidden.table_tilt, scenario.hidden.tether
    slope = float(np.hypot(np.tan(tilt.down_x), np.tan(tilt.down_y)))
    friction = float(thing.mass @ thing.mu) / thing.total_mass
    if slope >= friction:
        raise ValueError(
            f"hidden.table_tilt: object {thing.name} slides off by itself: the table is tilted by"
            f" {np.degrees(np.arctan(slope)):.1f}°, but friction only holds up to"
            f" {np.degrees(np.arctan(friction)):.1f}°"
        )
    x, y, degrees = scenario.object.pose
    rotation = turn(np.radians(degrees))
    tied = rotation @ [tether.point_x, tether.point_y]
    pull = tether_pull(tether, np.array([*(np.array([x, y]) + tied), 0.0]))[:2]
    if not pull.any():
        return
    gravity = tilted_gravity(tilt, scenario.gravity)
    slide = thing.total_mass * gravity[:2]
    center = thing.center_of_mass[:2]
    feet = thing.grid.centers[:, None] + thing.grid.width * FEET
    lever = tied - rotation @ center
    share = _share_held(
        np.repeat(-gravity[2] * thing.mass * thing.mu / len(FEET), len(FEET)),
        (feet.reshape(-1, 2) - center) @ rotation.T,
        pull + slide,
        float(lever[0] * pull[1] - lever[1] * pull[0]),
    )
    if share < 1.0:
        also = f" and the tilt of the table with {np.hypot(*slide):.3g} N" if slide.any() else ""
        held = f"{100 * share:.3g} % of that" if also else f"{share * np.hypot(*pull):.3g} N there"
        raise ValueError(
            f"hidden.tether: object {thing.name} does not stay where it lies: the tether pulls with"
            f" {np.hypot(*pull):.3g} N{also}, but friction only holds up to {held}; lower stiffness, or place"
            " the anchor nearer or give it more slack"
        )


def _share_held(friction: FloatArray, arms: FloatArray, force: FloatArray, torque: float) -> float:
    """Largest multiple of a load that friction holds on an object at rest.

    It is the least power that any motion loses by friction where the load's power is one; the motion is found
    by repeatedly solving the viscous problem with the same friction at the motion found before.

    Args:
        friction: (n,) greatest friction force of each foot, N.
        arms: (n, 2) feet from the point about which the torque is taken, m.
        force: (2,) of the load, N.
        torque: of the load, N m.
    """
    size = float(np.hypot(*arms.T).max())
    load = np.array([*force, torque / size])
    one, none = np.ones(len(arms)), np.zeros(len(arms))
    x, y = arms.T / size
    motions = np.array([[one, none, -y], [none, one, x]])  # (2, 3, n) velocity of each foot by the motion's
    slip = one
    for _ in range(200):
        viscous = (motions * (friction / np.maximum(slip, 1e-9 * slip.max()))) @ motions.transpose(0, 2, 1)
        motion = np.linalg.solve(viscous.sum(axis=0), load)
        motion /= load @ motion
        slip = np.linalg.norm(np.einsum("ain,i->an", motions, motion), axis=0)
    return float(friction @ slip)


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
    hint = "; is object.metres_per_unit right?" if extent.max() > DOUBTFUL_EXTENT else ""
    if np.hypot(*(corners.mean(axis=0) - [x, y])) > extent.max():
        place = "x = {:.4g} m, y = {:.4g} m".format(*(corners.min(axis=0) + extent / 2))
        hint = f": its middle is at {place}, as object.pose places the origin of the mesh"
    raise ValueError(
        f"object.pose: {thing.name} at x = {x:g} m, y = {y:g} m, {extent[0]:.2f} m by {extent[1]:.2f} m, does"
        f" not lie on the table, which has {size}{hint}"
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
    pixels, _ = _view(scenario).project(top)
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


def check_feasible(scenario: "Scenario", thing: TrueObject) -> None:
    """Refuse an object that cannot be detected or moved in a simulated cell.

    Raises:
        ValueError: its friction cannot be simulated, sliding it takes more force than the arm has, pictures
            are too infrequent, too noisy or too coarse or show too little of the table, or the arm hides the
            object. The text has the numbers.
    """
    foot_frictions(thing, scenario.table.friction)
    side_contact(thing, scenario.gravity)
    force = float(thing.mass @ thing.mu) * scenario.gravity
    if force > _STRONGEST:
        raise ValueError(
            f"object {thing.name} takes {force:.0f} N to slide ({thing.total_mass:.3g} kg at"
            f" {scenario.gravity:g} m/s²);"
            f" the arm can push with at most {_STRONGEST:.0f} N"
        )
    lies = _lies(scenario, thing)
    _check_pictures(scenario, thing, lies)
    _check_table_seen(scenario, lies)
    _check_arm_aside(scenario, thing, lies)


def _check_pictures(scenario: "Scenario", thing: TrueObject, lies: Polygon) -> None:
    camera, noise = scenario.camera, scenario.depth_noise
    if FRAMES / camera.rate > LONGEST_LOOK:
        raise ValueError(
            f"camera.rate: at {camera.rate:g} Hz the {FRAMES} pictures of the first look take"
            f" {FRAMES / camera.rate:.0f} s;"
            f" at most {LONGEST_LOOK:.0f} s are allowed, so the rate must be at least"
            f" {FRAMES / LONGEST_LOOK:g} Hz"
        )
    depth = _noise_of_depth(scenario)
    if depth > _MOST_NOISE:
        raise ValueError(
            f"depth_noise: at the table, {camera.height:g} m below the camera, depth scatters by"
            f" {1e3 * depth:.1f} mm;"
            f" objects can be detected up to {1e3 * _MOST_NOISE:g} mm: lower axial_floor, axial_growth"
            " or camera.height"
        )
    if noise.lateral_jitter > _MOST_JITTER:
        raise ValueError(
            f"depth_noise.lateral_jitter: edges scatter by {noise.lateral_jitter:g} pixels; outlines can be"
            f" detected up to {_MOST_JITTER:g} pixels"
        )
    pixel = pixel_size(_view(scenario))
    if lies.area < _FEWEST_PIXELS * pixel**2:
        raise ValueError(
            f"camera: object {thing.name} covers {lies.area / pixel**2:.0f} pixels of {1e3 * pixel:.1f} mm;"
            " at least"
            f" {_FEWEST_PIXELS} are needed: use more pixels (camera.width, height_pixels), or a camera that"
            " is lower or has a narrower view"
        )


def _check_table_seen(scenario: "Scenario", lies: Polygon) -> None:
    """The table's plane is fitted to readings near it, which must fill enough of the picture."""
    camera, noise = scenario.camera, scenario.depth_noise
    sides = np.array([camera.width, camera.height_pixels]) * pixel_size(_view(scenario)) / 2
    picture = translate(
        rotate(box(*-sides, *sides), np.degrees(camera.yaw), origin=(0.0, 0.0)), *camera.position
    )
    near = erf(NARROWEST / (np.sqrt(2.0) * max(_noise_of_depth(scenario), 1e-9)))
    share = float(
        (scenario.table.make().polygon & picture).difference(lies).area
        / picture.area
        * near
        * (1.0 - noise.missing_anywhere)
    )
    if share < LEAST_SHARE:
        raise ValueError(
            f"camera: readings of the table beside the object, within {1e3 * NARROWEST:.0f} mm of its plane,"
            f" fill {100 * share:.1f} %"
            f" of the picture; {100 * LEAST_SHARE:.0f} % are needed: lower the camera, or reduce its noise"
            " and missing pixels"
        )


def _check_arm_aside(scenario: "Scenario", thing: TrueObject, lies: Polygon) -> None:
    """At home the arm must not hide the object, or the first look waits for it for ever."""
    plant, scene_graph, arm = lone_arm(scenario.arm.models, scenario.execution.finger_radius)
    view = _view(scenario)
    blocked = draw_hulls(ArmHulls(plant, scene_graph, [arm.iiwa, arm.gripper])(HOME), view)
    corners = np.asarray(lies.exterior.coords)
    heights = [0.0, float(thing.height.max())]
    covered = np.zeros(blocked.shape, np.uint8)
    for height in heights:
        pixels, _ = view.project(np.column_stack([corners, np.full(len(corners), height)]))
        cv2.fillPoly(covered, [np.round(pixels).astype(np.int32)], 1)
    size = 2 * ARM_NEAR + 1
    hidden = cv2.dilate(covered, np.ones((size, size), np.uint8)).astype(bool) & blocked
    if hidden.any():
        x, y, _ = scenario.object.pose
        raise ValueError(
            f"object.pose: as the camera sees it, object {thing.name} at x = {x:g} m, y = {y:g} m lies under"
            " or beside the arm"
            " at home; move it away from the arm's stand"
        )


def _lies(scenario: "Scenario", thing: TrueObject) -> Polygon:
    """The object's outline on the table, world, m."""
    x, y, degrees = scenario.object.pose
    return translate(rotate(thing.grid.polygon, degrees, origin=(0.0, 0.0)), x, y)


def _noise_of_depth(scenario: "Scenario") -> float:
    """Standard deviation of depth at the table, m; rounding to a quantum is not counted."""
    noise = scenario.depth_noise
    return float(noise.axial_floor + noise.axial_growth * scenario.camera.height**2)


def _view(scenario: "Scenario") -> View:
    return view_from(scenario.camera.intrinsics, scenario.camera.X_WC.GetAsMatrix4().tobytes())
