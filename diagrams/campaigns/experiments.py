"""The experiments that `slipmap campaign` knows."""

from __future__ import annotations

from diagrams.campaigns.experiment import Experiment
from diagrams.campaigns.learning_curves import FIGURE_3, FIGURE_4

EXPERIMENTS: dict[str, Experiment] = {experiment.name: experiment for experiment in (FIGURE_3, FIGURE_4)}
