"""Objects as cell grids: from an outline, a label image or a mesh.

The names in `__init__.pyi` are imported on first use: meshes and images need libraries that load slowly, and
pushes need neither.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
