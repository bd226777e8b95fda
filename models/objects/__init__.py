"""Objects as cell grids: from an outline, a label image or a mesh.

What is named here is imported when it is first asked for: meshes and images need libraries that take long to
load, and pushes need neither.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slipmap.models.objects.footprints import cells_from_polygon, contour_cells
    from slipmap.models.objects.images import cells_from_label_image
    from slipmap.models.objects.meshes import cells_from_mesh

_PLACES = {
    "contour_cells": "footprints",
    "cells_from_polygon": "footprints",
    "cells_from_label_image": "images",
    "cells_from_mesh": "meshes",
}

__all__ = [
    "cells_from_label_image",
    "cells_from_mesh",
    "cells_from_polygon",
    "contour_cells",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
