"""Flat shapes for Meshcat that keep their exact colours under any light and from any viewpoint.

They are in-memory glTF files with `KHR_materials_unlit`.
"""

import base64
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common import MemoryFile
from pydrake.geometry import InMemoryMesh, Mesh

from slipmap.models.physics.cell_grid import CellGrid, FloatArray

_FLOAT, _INDEX = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
_THICKNESS = 2e-3  # m, of tiles
Triangles = tuple[FloatArray, NDArray[np.uint32]]  # vertices (v, 3) in m and triangles (t, 3)


def unlit_mesh(
    vertices: FloatArray,
    triangles: NDArray[np.uint32],
    colors: FloatArray | None = None,
    picture: bytes | None = None,
    places: FloatArray | None = None,
) -> Mesh:
    """A mesh with vertex colours or a picture on it, visible from both sides.

    Args:
        vertices: (v, 3) m.
        triangles: (t, 3) rows of `vertices`.
        colors: (v, 3) sRGB, 0 to 1.
        picture: a PNG file instead of colours.
        places: (v, 2) texture coordinates of the vertices; (0, 0) is the picture's upper left corner.
    """
    # y points up in glTF, z in Drake.
    upright = np.column_stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]])
    parts: list[tuple[NDArray[Any], int, str]] = [
        (upright.astype("<f4"), _VERTICES, "VEC3"),
        (triangles.astype("<u4").ravel(), _INDICES, "SCALAR"),
    ]
    attributes = {"POSITION": 0}
    material: dict[str, Any] = {
        "doubleSided": True,
        "extensions": {"KHR_materials_unlit": {}},
        "pbrMetallicRoughness": {"metallicFactor": 0.0},
    }
    tree: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "materials": [material],
        "extensionsUsed": ["KHR_materials_unlit"],
    }
    if colors is not None:
        linear = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
        attributes["COLOR_0"] = len(parts)
        parts.append((linear.astype("<f4"), _VERTICES, "VEC3"))
    if picture is not None and places is not None:
        attributes["TEXCOORD_0"] = len(parts)
        parts.append((places.astype("<f4"), _VERTICES, "VEC2"))
        tree["images"] = [{"uri": _uri(picture, "image/png")}]
        tree["textures"] = [{"source": 0}]
        material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    tree["meshes"] = [{"primitives": [{"attributes": attributes, "indices": 1, "material": 0}]}]
    views, accessors, data = [], [], b""
    for k, (array, target, kind) in enumerate(parts):
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes, "target": target})
        component = _INDEX if kind == "SCALAR" else _FLOAT
        accessor = {"bufferView": k, "componentType": component, "count": len(array), "type": kind}
        if k == 0:
            accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        accessors.append(accessor)
        data += array.tobytes()
    tree |= {
        "bufferViews": views,
        "accessors": accessors,
        "buffers": [{"byteLength": len(data), "uri": _uri(data, "application/octet-stream")}],
    }
    return Mesh(InMemoryMesh(mesh_file=MemoryFile(json.dumps(tree), ".gltf", "unlit mesh")))


def _uri(data: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def painted(shape: Triangles, color: tuple[float, float, float]) -> Mesh:
    """A shape in one colour, sRGB."""
    vertices, triangles = shape
    return unlit_mesh(vertices, triangles, np.tile(color, (len(vertices), 1)))


def tiles(grid: CellGrid, colors: FloatArray) -> Mesh:
    """A flat box per cell in colours (n, 3), with tops at z = 0, darker sides, and seams between them."""
    ring, n = grid.squares(0.92 * grid.width), len(grid)
    top = np.concatenate([ring, np.zeros((n, 4, 1))], axis=2)
    low = np.concatenate([ring, np.full((n, 4, 1), -_THICKNESS)], axis=2)
    # Twelve vertices per cell: four for the top, eight for the sides.
    vertices = np.concatenate([top, top, low], axis=1).reshape(-1, 3)
    shades = np.concatenate(
        [np.repeat(colors[:, None], 4, axis=1), np.repeat(0.7 * colors[:, None], 8, axis=1)], axis=1
    )
    one = [[0, 1, 2], [0, 2, 3]]
    for k in range(4):
        following = (k + 1) % 4
        one += [[4 + k, 8 + k, 8 + following], [4 + k, 8 + following, 4 + following]]
    triangles = (12 * np.arange(n)[:, None, None] + np.array(one)).reshape(-1, 3)
    return unlit_mesh(vertices, triangles.astype(np.uint32), shades.reshape(-1, 3))


def ribbon(edges: FloatArray, width: float) -> Triangles:
    """Line segments (E, 4) in the plane z = 0 as strips of a given width, m."""
    begin, end = edges[:, :2], edges[:, 2:]
    along = (end - begin) / np.linalg.norm(end - begin, axis=1, keepdims=True) * 0.5 * width
    across = np.column_stack([-along[:, 1], along[:, 0]])
    corners = np.stack(
        [begin - along - across, end + along - across, end + along + across, begin - along + across], axis=1
    )
    return quads(np.concatenate([corners, np.zeros((len(corners), 4, 1))], axis=2))


def ringed_discs(centers: FloatArray, radii: FloatArray) -> Mesh:
    """White discs with black rims about centres (k, 2), just above the plane z = 0."""
    sides, k = 16, len(centers)
    angles = 2 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    rims = (centers[:, None] + 1.3 * radii[:, None, None] * ring).reshape(-1, 2)
    discs = (centers[:, None] + radii[:, None, None] * ring).reshape(-1, 2)
    height = np.repeat([0.0, 2e-4], sides * k)
    fan = np.column_stack([np.zeros(sides - 2), np.arange(1, sides - 1), np.arange(2, sides)])
    triangles = (sides * np.arange(2 * k)[:, None, None] + fan).reshape(-1, 3)
    colors = np.repeat([[0.0] * 3, [1.0] * 3], sides * k, axis=0)
    vertices = np.column_stack([np.concatenate([rims, discs]), height])
    return unlit_mesh(vertices, triangles.astype(np.uint32), colors)


def arrow(length: float, width: float, head: float) -> Triangles:
    """An arrow from the origin along x in the plane z = 0, with a head 2.6 times as wide as its shaft."""
    neck, half = length - head, 0.5 * width
    shaft = [[0, -half], [neck, -half], [neck, half], [0, half]]
    points = np.array([*shaft, [neck, -2.6 * half], [length, 0], [neck, 2.6 * half]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6]], dtype=np.uint32)
    return np.column_stack([points, np.zeros(len(points))]), triangles


def billboard(picture: bytes, width: float, height: float) -> Mesh:
    """A picture (PNG) standing in the plane y = 0, centred on the origin, seen from -y."""
    corners = 0.5 * np.array(
        [[-width, 0, -height], [width, 0, -height], [width, 0, height], [-width, 0, height]]
    )
    places = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
    return unlit_mesh(corners, triangles, picture=picture, places=places)


def quads(corners: FloatArray) -> Triangles:
    """Quadrilaterals (k, 4, 3), m, as triangles."""
    begin = 4 * np.arange(len(corners))[:, None, None]
    triangles = (begin + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return corners.reshape(-1, 3), triangles.astype(np.uint32)
