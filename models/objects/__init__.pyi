from .footprints import cells_from_polygon as cells_from_polygon, contour_cells as contour_cells
from .images import cells_from_label_image as cells_from_label_image
from .meshes import cells_from_mesh as cells_from_mesh
