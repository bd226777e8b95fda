from .diagnosis_figures import (
    alone_figure as alone_figure,
    gain_figure as gain_figure,
    joint_gain_figure as joint_gain_figure,
    joint_locked_figure as joint_locked_figure,
    locked_figure as locked_figure,
    telling_push_figure as telling_push_figure,
)
from .effect_figures import effect_figure as effect_figure
from .map_figures import maps_figure as maps_figure
from .push_figures import (
    error_figure as error_figure,
    measured_figure as measured_figure,
    push_figures as push_figures,
)
from .residual_figures import (
    correlation_figure as correlation_figure,
    factor_figure as factor_figure,
    object_figure as object_figure,
    residual_figures as residual_figures,
    table_figure as table_figure,
)
from .study_figures import (
    calibration_figure as calibration_figure,
    curves_figure as curves_figure,
    means_figure as means_figure,
    reliability_figure as reliability_figure,
    shares_figure as shares_figure,
)
from .style import (
    draw_cells as draw_cells,
    draw_outline as draw_outline,
    save as save,
)
