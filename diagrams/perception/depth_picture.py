"""Depth pictures without a renderer, by intersecting pixel rays with the shapes of the world.

The arm, the table and their surroundings are boxes, balls, cylinders and capsules, whose depth along a ray
has a closed form; objects are meshes. This takes a tenth of the time that a software renderer needs for them
as 100 000 triangles. Fixed shapes are drawn only once.

Everything is in one file, so that numba recompiles it whenever any of it changes.
"""

import io
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.common.cpp_param import List
from pydrake.common.value import AbstractValue, Value
from pydrake.geometry import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    GeometryId,
    GeometrySet,
    Mesh,
    Role,
    SceneGraph,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort
from pydrake.systems.sensors import ImageDepth32F, RgbdSensor

from slipmap.diagrams.perception.camera import FARTHEST, NEAREST, CameraConfig
from slipmap.diagrams.systems.python_system import PythonSystem
from slipmap.models.objects.meshes import trimesh
from slipmap.models.perception.pinhole_camera import DepthImage
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.compiled import LONE_FOLDER, compiled

BOX, ELLIPSOID, CYLINDER, CAPSULE = range(4)  # kinds of shapes; see `draw_solids` for their dimensions
_NEAR = 0.01  # m; nothing is drawn closer than this to the camera's plane

_compiled = compiled(LONE_FOLDER)


@_compiled
def _through_slab(origin, ray, half):  # type: ignore[no-untyped-def]
    """Where a ray enters and leaves |x| < half; if it misses, the first exceeds the second."""
    if ray == 0.0:
        if abs(origin) < half:
            return -np.inf, np.inf
        return np.inf, -np.inf
    one, other = (-half - origin) / ray, (half - origin) / ray
    return min(one, other), max(one, other)


@_compiled
def _through_quadric(a, b, c):  # type: ignore[no-untyped-def]
    """The interval of t in which a t² + 2 b t + c is negative, for a ≥ 0."""
    if a == 0.0:
        if c < 0.0:
            return -np.inf, np.inf
        return np.inf, -np.inf
    root = b * b - a * c
    if root < 0.0:
        return np.inf, -np.inf
    root = np.sqrt(root)
    return (-b - root) / a, (-b + root) / a


@_compiled
def _seen(first, last):  # type: ignore[no-untyped-def]
    """Depth at which a shape is seen along a ray inside it from `first` to `last`; inf if it is not."""
    if first > last:
        return np.inf
    if first > _NEAR:
        return first
    return last if last > _NEAR else np.inf


@_compiled
def _depth_of_shape(kind, s0, s1, s2, ox, oy, oz, x, y, z):  # type: ignore[no-untyped-def]
    """Depth at which a ray from (ox, oy, oz) along (x, y, z), in the shape's frame, meets it; or inf."""
    if kind == BOX:
        first, last = _through_slab(ox, x, s0)
        one, other = _through_slab(oy, y, s1)
        first, last = max(first, one), min(last, other)
        one, other = _through_slab(oz, z, s2)
        return _seen(max(first, one), min(last, other))
    a, b, c = x * x + y * y, ox * x + oy * y, ox * ox + oy * oy
    if kind == ELLIPSOID:  # in units of its semi-axes
        first, last = _through_quadric(a + z * z, b + oz * z, c + oz * oz - 1.0)
        return _seen(first, last)
    first, last = _through_quadric(a, b, c - s0 * s0)
    if first > last:
        return np.inf  # a ray that misses the cylinder misses a capsule's caps, too
    one, other = _through_slab(oz, z, s2)
    first, last = max(first, one), min(last, other)
    if kind == CYLINDER:
        return _seen(first, last)
    if first > last:
        first, last = np.inf, -np.inf
    for end in (-s2, s2):
        up = oz - end
        one, other = _through_quadric(a + z * z, b + up * z, c + up * up - s0 * s0)
        if one <= other:
            first, last = min(first, one), max(last, other)
    return _seen(first, last)


@_compiled
def _window(image, camera, half, X):  # type: ignore[no-untyped-def]
    """First and last row and column of a box with pose X in the picture, and its smallest depth; the range of
    rows is empty if it is not visible."""
    height, width = image.shape
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    nearest, farthest = np.inf, -np.inf
    for corner in range(8):
        sx = half[0] if corner & 1 else -half[0]
        sy = half[1] if corner & 2 else -half[1]
        sz = half[2] if corner & 4 else -half[2]
        x = X[0, 0] * sx + X[0, 1] * sy + X[0, 2] * sz + X[0, 3]
        y = X[1, 0] * sx + X[1, 1] * sy + X[1, 2] * sz + X[1, 3]
        z = X[2, 0] * sx + X[2, 1] * sy + X[2, 2] * sz + X[2, 3]
        nearest, farthest = min(nearest, z), max(farthest, z)
        if z > _NEAR:
            u, v = fx * x / z + cx, fy * y / z + cy
            left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
    if nearest <= _NEAR:
        left, top, right, bottom = 0.0, 0.0, width - 1.0, height - 1.0
    if farthest <= _NEAR or right < 0.0 or bottom < 0.0 or left > width - 1.0 or top > height - 1.0:
        return 0, -1, 0, -1, nearest
    return (
        int(np.ceil(max(top, 0.0))),
        int(np.floor(min(bottom, height - 1.0))),
        int(np.ceil(max(left, 0.0))),
        int(np.floor(min(right, width - 1.0))),
        nearest,
    )


@_compiled
def _columns(camera, half, X, window, first, last):  # type: ignore[no-untyped-def]
    """Set `first` and `last` (H,) to the range of columns of a box with pose X in each row of its window.

    The range may be a little too large.
    """
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    u, v = np.empty(8), np.empty(8)
    for corner in range(8):
        sx = half[0] if corner & 1 else -half[0]
        sy = half[1] if corner & 2 else -half[1]
        sz = half[2] if corner & 4 else -half[2]
        z = X[2, 0] * sx + X[2, 1] * sy + X[2, 2] * sz + X[2, 3]
        if z <= _NEAR:
            first[window[0] : window[1] + 1], last[window[0] : window[1] + 1] = window[2], window[3]
            return
        u[corner] = fx * (X[0, 0] * sx + X[0, 1] * sy + X[0, 2] * sz + X[0, 3]) / z + cx
        v[corner] = fy * (X[1, 0] * sx + X[1, 1] * sy + X[1, 2] * sz + X[1, 3]) / z + cy
    for row in range(window[0], window[1] + 1):
        left, right = np.inf, -np.inf
        for one in range(8):
            for bit in (1, 2, 4):  # an edge for each; the silhouette consists of edges
                other = one | bit
                if other != one and (v[one] < row) != (v[other] < row):
                    column = u[one] + (row - v[one]) / (v[other] - v[one]) * (u[other] - u[one])
                    left, right = min(left, column), max(right, column)
        first[row], last[row] = window[2], window[3]
        if left <= right:  # otherwise the row just touches a corner
            first[row] = max(first[row], int(np.floor(left)) - 1)
            last[row] = min(last[row], int(np.ceil(right)) + 1)


@_compiled
def _draw_solid(image, camera, kind, size, X, window, nearest, first, last):  # type: ignore[no-untyped-def]
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    # The camera, where all rays start, and its axes in the shape's frame.
    origin = np.empty(3)
    axes = np.empty((3, 3))
    for k in range(3):
        unit = size[k] if kind == ELLIPSOID else 1.0
        origin[k] = -(X[0, k] * X[0, 3] + X[1, k] * X[1, 3] + X[2, k] * X[2, 3]) / unit
        for i in range(3):
            axes[i, k] = X[i, k] / unit
    for row in range(window[0], window[1] + 1):
        b = (row - cy) / fy
        x = b * axes[1, 0] + axes[2, 0]
        y = b * axes[1, 1] + axes[2, 1]
        z = b * axes[1, 2] + axes[2, 2]
        met = False
        for column in range(first[row], last[row] + 1):
            if image[row, column] <= nearest:
                continue
            a = (column - cx) / fx
            depth = _depth_of_shape(
                kind, size[0], size[1], size[2], origin[0], origin[1], origin[2],
                a * axes[0, 0] + x, a * axes[0, 1] + y, a * axes[0, 2] + z,
            )  # fmt: skip
            if depth < np.inf:
                met = True
                if depth < image[row, column]:
                    image[row, column] = depth
            elif met:
                break  # it is convex


@_compiled
def draw_solids(image, camera, kinds, sizes, halves, X_BG, bodies, X_CB):  # type: ignore[no-untyped-def]
    """Draw solids into a picture wherever they are nearer than its present content.

    Args:
        image: (H, W) depth, m.
        camera: (4,) focal lengths and centre, pixels.
        kinds: (n,) such as BOX.
        sizes: (n, 3) half the sides of a BOX; semi-axes of an ELLIPSOID; radius, radius and half the length
            along z of a CYLINDER or a CAPSULE, whose length is between the centres of its caps.
        halves: (n, 3) half the sides of a bounding box of each.
        X_BG: (n, 3, 4) their poses in the frames of their bodies.
        bodies: (n,) rows of X_CB.
        X_CB: (b, 3, 4) poses of the bodies in the camera's frame.
    """
    number = len(kinds)
    windows = np.empty((number, 4), np.int64)
    nearest = np.empty(number)
    X_CG = np.empty((number, 3, 4))
    for k in range(number):
        X = X_CB[bodies[k]]
        for i in range(3):
            for j in range(4):
                X_CG[k, i, j] = X[i, 0] * X_BG[k, 0, j] + X[i, 1] * X_BG[k, 1, j] + X[i, 2] * X_BG[k, 2, j]
            X_CG[k, i, 3] += X[i, 3]
        windows[k, 0], windows[k, 1], windows[k, 2], windows[k, 3], nearest[k] = _window(
            image, camera, halves[k], X_CG[k]
        )
    first, last = np.empty(len(image), np.int64), np.empty(len(image), np.int64)
    # Shapes in front hide most of those behind, whose depth then need not be computed.
    for k in np.argsort(nearest):
        _columns(camera, halves[k], X_CG[k], windows[k], first, last)
        _draw_solid(image, camera, kinds[k], sizes[k], X_CG[k], windows[k], nearest[k], first, last)


@_compiled
def draw_triangles(image, camera, corners, triangles, X_CG):  # type: ignore[no-untyped-def]
    """Draw triangles, visible from either side, wherever they are nearer than the present content.

    Args:
        image, camera: as for `draw_solids`.
        X_CG: (3, 4) pose of the corners' frame in the camera's.
        corners: (n, 3) m.
        triangles: (m, 3) indices of corners. Triangles that reach behind the camera are skipped.
    """
    height, width = image.shape
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    u, v, w = np.empty(len(corners)), np.empty(len(corners)), np.empty(len(corners))
    for k in range(len(corners)):
        px, py, pz = corners[k, 0], corners[k, 1], corners[k, 2]
        x = X_CG[0, 0] * px + X_CG[0, 1] * py + X_CG[0, 2] * pz + X_CG[0, 3]
        y = X_CG[1, 0] * px + X_CG[1, 1] * py + X_CG[1, 2] * pz + X_CG[1, 3]
        z = X_CG[2, 0] * px + X_CG[2, 1] * py + X_CG[2, 2] * pz + X_CG[2, 3]
        w[k] = 1.0 / z if z > _NEAR else -1.0
        u[k], v[k] = fx * x * w[k] + cx, fy * y * w[k] + cy
    for t in range(len(triangles)):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if w[i] < 0.0 or w[j] < 0.0 or w[k] < 0.0:
            continue
        area = (u[j] - u[i]) * (v[k] - v[i]) - (v[j] - v[i]) * (u[k] - u[i])
        if area == 0.0:
            continue
        first_column = int(np.ceil(max(min(u[i], u[j], u[k]), 0.0)))
        last_column = int(np.floor(min(max(u[i], u[j], u[k]), width - 1.0)))
        first_row = int(np.ceil(max(min(v[i], v[j], v[k]), 0.0)))
        last_row = int(np.floor(min(max(v[i], v[j], v[k]), height - 1.0)))
        for row in range(first_row, last_row + 1):
            for column in range(first_column, last_column + 1):
                # Barycentric coordinates; 1 / depth is linear in the picture.
                one = ((u[j] - column) * (v[k] - row) - (v[j] - row) * (u[k] - column)) / area
                two = ((u[k] - column) * (v[i] - row) - (v[k] - row) * (u[i] - column)) / area
                three = 1.0 - one - two
                if one >= 0.0 and two >= 0.0 and three >= 0.0:
                    depth = 1.0 / (one * w[i] + two * w[j] + three * w[k])
                    if depth < image[row, column]:
                        image[row, column] = depth


@_compiled
def keep_range(image, nearest, farthest):  # type: ignore[no-untyped-def]
    """Limit depth (H, W) to a camera's range: 0 for anything nearer, inf for anything farther."""
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            depth = image[row, column]
            if depth < nearest:
                image[row, column] = 0.0
            elif depth > farthest:
                image[row, column] = np.inf


class NotDrawable(ValueError):
    """A shape that only a renderer can draw; the text names it."""


class _Solid(NamedTuple):
    """A shape with a closed form; see `draw_solids`."""

    kind: int
    size: FloatArray
    half: FloatArray


class _Surface(NamedTuple):
    """Triangles (m, 3) between corners (n, 3)."""

    corners: FloatArray
    triangles: NDArray[np.int64]


_Placed = tuple[BodyIndex, FloatArray, _Solid | _Surface]


class _Scene:
    """Shapes on some bodies, ready to be drawn."""

    def __init__(self, shapes: Sequence[_Placed]) -> None:
        """Shapes with their bodies and their poses (3, 4) in the bodies' frames."""
        self.bodies = list(dict.fromkeys(body for body, _, _ in shapes))
        rows = [self.bodies.index(body) for body, _, _ in shapes]
        solids = [k for k, (_, _, shape) in enumerate(shapes) if isinstance(shape, _Solid)]
        self._solids = (
            np.array([shapes[k][2][0] for k in solids], dtype=np.int64),
            *(np.array([shapes[k][2][m] for k in solids]).reshape(-1, 3) for m in (1, 2)),
            np.array([shapes[k][1] for k in solids]).reshape(-1, 3, 4),
            np.array([rows[k] for k in solids], dtype=np.int64),
        )
        self._surfaces = [
            (row, np.ascontiguousarray(shape.corners @ X_BG[:, :3].T + X_BG[:, 3]), shape.triangles)
            for row, (_, X_BG, shape) in zip(rows, shapes, strict=True)
            if isinstance(shape, _Surface)
        ]

    def draw(self, image: DepthImage, camera: FloatArray, X_CB: Sequence[RigidTransform]) -> None:
        """Draw into a picture (H, W), m, for poses of `bodies` in the camera's frame."""
        poses = np.array([X.GetAsMatrix34() for X in X_CB]).reshape(-1, 3, 4)
        draw_solids(image, camera, *self._solids, poses)
        for row, corners, triangles in self._surfaces:
            draw_triangles(image, camera, corners, triangles, poses[row])


class DepthPicture(PythonSystem):
    """Depth pictures of a plant, without noise.

    The input `body_poses` is that of the plant. The output `depth_image`, an ImageDepth32F, matches the
    rendering of Drake's `RgbdSensor`, except that edges may be off by a pixel: 0 for anything too near, inf
    for anything too far. It shows all shapes with a perception role.

    Args:
        plant, scene_graph: finalized.

    Raises:
        ValueError: the plant is not finalized.
        NotDrawable: a shape that is neither a simple solid nor a mesh in an OBJ file.
    """

    def __init__(self, plant: MultibodyPlant, scene_graph: SceneGraph, config: CameraConfig) -> None:
        super().__init__()
        if not plant.is_finalized():
            raise ValueError("depth picture: finalize the plant first, so that all visible shapes are there")
        camera = config.intrinsics
        self._camera = np.array([camera.focal_x, camera.focal_y, camera.center_x, camera.center_y])
        self._X_CW = config.X_WC.inverse()
        fixed = {body.index() for body in plant.GetBodiesWeldedTo(plant.world_body())}
        inspector = scene_graph.model_inspector()
        found = inspector.GetGeometryIds(GeometrySet(inspector.GetAllGeometryIds()), Role.kPerception)
        standing: list[_Placed] = []
        moving: list[_Placed] = []
        for geometry in sorted(found, key=lambda geometry: geometry.get_value()):
            body = plant.GetBodyFromFrameId(inspector.GetFrameId(geometry)).index()
            X_BG = inspector.GetPoseInFrame(geometry).GetAsMatrix34()
            (standing if body in fixed else moving).append((body, X_BG, _drawable(inspector, geometry)))
        background, self._moving = _Scene(standing), _Scene(moving)
        self._background = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
        rest = plant.CreateDefaultContext()
        everything = self._background.copy()
        for scene, image in ((background, self._background), (self._moving, everything)):
            X_WB = [plant.EvalBodyPoseInWorld(rest, plant.get_body(body)) for body in scene.bodies]
            scene.draw(image, self._camera, [self._X_CW @ X for X in X_WB])
        # This picture is unused, but compiles the code now, so that no picture of a twin is late.
        keep_range(everything, NEAREST, FARTHEST)
        poses = self.DeclareAbstractInputPort("body_poses", Value[List[RigidTransform]]())
        self.DeclareAbstractOutputPort(
            "depth_image", lambda: AbstractValue.Make(ImageDepth32F()), self._calc, {poses.ticket()}
        )

    def _calc(self, context: Context, output: Any) -> None:
        X_WB: Any = self.get_input_port().Eval(context)
        height, width = self._background.shape
        picture: Any = ImageDepth32F(width, height)
        image = picture.mutable_data[:, :, 0]
        image[:] = self._background
        self._moving.draw(image, self._camera, [self._X_CW @ X_WB[body] for body in self._moving.bodies])
        keep_range(image, NEAREST, FARTHEST)
        output.set_value(picture)


def add_depth_picture(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    config: CameraConfig,
    camera: RgbdSensor,
) -> OutputPort:
    """Add depth pictures of a camera, by a `DepthPicture` if that can draw all visible shapes.

    Otherwise `camera`, the same one from `add_camera`, renders them.
    """
    try:
        picture = builder.AddNamedSystem("depth_picture", DepthPicture(plant, scene_graph, config))
    except NotDrawable:
        return camera.depth_image_32F_output_port()
    builder.Connect(plant.get_body_poses_output_port(), picture.get_input_port())
    return picture.get_output_port()


def _drawable(inspector: Any, geometry: GeometryId) -> _Solid | _Surface:
    shape: Shape = inspector.GetShape(geometry)
    if isinstance(shape, Box):
        half = shape.size() / 2
        return _Solid(BOX, half, half)
    if isinstance(shape, Sphere):
        half = np.full(3, shape.radius())
        return _Solid(ELLIPSOID, half, half)
    if isinstance(shape, Ellipsoid):
        half = np.array([shape.a(), shape.b(), shape.c()])
        return _Solid(ELLIPSOID, half, half)
    if isinstance(shape, Cylinder):
        half = np.array([shape.radius(), shape.radius(), shape.length() / 2])
        return _Solid(CYLINDER, half, half)
    if isinstance(shape, Capsule):
        size = np.array([shape.radius(), shape.radius(), shape.length() / 2])
        return _Solid(CAPSULE, size, size + np.array([0.0, 0.0, shape.radius()]))
    if isinstance(shape, Mesh) and shape.extension() == ".obj":
        mesh = _triangles(shape)
        return _Surface(mesh.vertices * shape.scale3(), np.ascontiguousarray(mesh.faces, np.int64))
    raise NotDrawable(f"depth picture: {inspector.GetName(geometry)} is a {type(shape).__name__}")


def _triangles(shape: Mesh) -> Any:
    source = shape.source()
    content = source.path().read_bytes() if source.is_path() else source.in_memory().mesh_file.contents()
    return trimesh.load_mesh(io.BytesIO(content), file_type="obj", process=False, skip_materials=True)
