"""Pictures of beliefs, pushes, comparisons, diagnoses, calibration: matplotlib Figures; `save` writes one."""

from slipmap.diagrams.application.figures.diagnosis_figures import (
    gain_figure,
    locked_figure,
    telling_push_figure,
)
from slipmap.diagrams.application.figures.effect_figures import effect_figure
from slipmap.diagrams.application.figures.map_figures import maps_figure
from slipmap.diagrams.application.figures.push_figures import error_figure, measured_figure, push_figures
from slipmap.diagrams.application.figures.residual_figures import (
    correlation_figure,
    factor_figure,
    object_figure,
    residual_figures,
    table_figure,
)
from slipmap.diagrams.application.figures.study_figures import calibration_figure
from slipmap.diagrams.application.figures.style import draw_cells, draw_outline, save
