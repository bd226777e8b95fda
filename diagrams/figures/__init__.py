"""Pictures of beliefs, pushes, comparisons, diagnoses, calibration: matplotlib Figures; `save` writes one."""

from diagrams.figures.calibration import calibration_figure
from diagrams.figures.comparison import error_figure
from diagrams.figures.correlations import correlation_figure
from diagrams.figures.diagnosis import gain_figure, locked_figure
from diagrams.figures.effects import effect_figure
from diagrams.figures.maps import maps_figure
from diagrams.figures.pushes import push_figures
from diagrams.figures.residual_curves import factor_figure
from diagrams.figures.residual_fields import object_figure, table_figure
from diagrams.figures.residuals import residual_figures
from diagrams.figures.style import save
from diagrams.figures.telling_push import telling_push_figure

__all__ = [
    "calibration_figure",
    "correlation_figure",
    "effect_figure",
    "error_figure",
    "factor_figure",
    "gain_figure",
    "locked_figure",
    "maps_figure",
    "object_figure",
    "push_figures",
    "residual_figures",
    "save",
    "table_figure",
    "telling_push_figure",
]
