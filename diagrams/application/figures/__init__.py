"""Pictures of beliefs, pushes, comparisons, diagnoses, calibration: matplotlib Figures; `save` writes one.

The names in `__init__.pyi` are imported on first use: an effect is drawn with its formula, which loads sympy.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
