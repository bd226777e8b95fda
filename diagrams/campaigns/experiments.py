"""The experiments that `slipmap campaign` knows."""

from __future__ import annotations

from diagrams.campaigns.experiment import Experiment
from diagrams.campaigns.learning_curves import FIGURE_3, FIGURE_4
from diagrams.campaigns.pregrasp_success import FIGURE_6
from diagrams.campaigns.stable_goals import FIGURE_5

EXPERIMENTS: dict[str, Experiment] = {
    experiment.name: experiment for experiment in (FIGURE_3, FIGURE_4, FIGURE_5, FIGURE_6)
}
