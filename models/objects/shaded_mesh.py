"""Meshes as Wavefront OBJ text with the normals that renderers want: smooth on curves, sharp at edges."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.sparse import csr_array

from models.physics.cell_grid import FloatArray

CREASE = np.deg2rad(35.0)
"""Faces that meet at a larger angle than this show an edge."""


def shaded_obj(mesh: trimesh.Trimesh) -> str:
    """OBJ text of a mesh with a normal at every corner of a face."""
    normals, index = np.unique(np.round(corner_normals(mesh), 4), axis=0, return_inverse=True)
    corners = np.stack([mesh.faces, index.reshape(-1, 3)], axis=2) + 1
    lines = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in mesh.vertices]
    lines += [f"vn {x:.4g} {y:.4g} {z:.4g}" for x, y, z in normals]
    lines += ["f " + " ".join(f"{vertex}//{normal}" for vertex, normal in face) for face in corners]
    return "\n".join(lines) + "\n"


def corner_normals(mesh: trimesh.Trimesh) -> FloatArray:
    """(3 f, 3) unit normals: the mean, by area, over the faces around a corner that meet its own face in no
    more than `CREASE`."""
    corners = mesh.faces.reshape(-1)
    count = len(corners)
    at_vertex = csr_array((np.ones(count), (np.arange(count), corners)), shape=(count, len(mesh.vertices)))
    first, second = (at_vertex @ at_vertex.T).nonzero()
    face_normals = np.repeat(mesh.face_normals, 3, axis=0)
    smooth = np.sum(face_normals[first] * face_normals[second], axis=1) > np.cos(CREASE)
    first, second = first[smooth], second[smooth]
    total = np.zeros((count, 3))
    np.add.at(total, first, face_normals[second] * np.repeat(mesh.area_faces, 3)[second, None])
    return total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None]
