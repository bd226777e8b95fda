"""Objects as cell grids: from an outline, cell centres, a label image or a mesh."""

from models.objects.contour import contour_cells
from models.objects.footprints import cells_from_centres, cells_from_polygon
from models.objects.images import cells_from_label_image
from models.objects.meshes import cells_from_mesh

__all__ = [
    "cells_from_centres",
    "cells_from_label_image",
    "cells_from_mesh",
    "cells_from_polygon",
    "contour_cells",
]
