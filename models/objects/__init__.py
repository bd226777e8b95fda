"""Objects as cell grids: from an outline, a label image or a mesh.

What is named in `__init__.pyi` is imported when it is first asked for: meshes and images need libraries that
take long to load, and pushes need neither.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
