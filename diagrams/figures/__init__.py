"""Pictures of beliefs, pushes and calibration. They are returned as matplotlib Figures; `save` writes one."""

from diagrams.figures.calibration import calibration_figure
from diagrams.figures.maps import maps_figure
from diagrams.figures.pushes import push_figures
from diagrams.figures.style import save

__all__ = ["calibration_figure", "maps_figure", "push_figures", "save"]
