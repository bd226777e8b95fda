"""The experiments that `slipmap campaign` knows. Naming them loads nothing that is large."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from diagrams.campaigns.experiment import Experiment

ABOUT = {
    "fig3": "error after pushes chosen by three strategies",
    "fig4": "error of identified maps, a uniform object, and Algorithm 1 as printed",
    "fig5": "stable goals at the table's edge",
    "fig6": "pushing to the table's edge by four methods",
    "fig7": "the whole procedure with arm and camera",
    "tilt": "pushing over a tilted table without and with the tilt in the model",
}
"""Every experiment, named after the paper's figure, and what goes beyond the paper."""

_PLACES = {
    "fig3": "learning_curves:FIGURE_3",
    "fig4": "learning_curves:FIGURE_4",
    "fig5": "stable_goals:FIGURE_5",
    "fig6": "pregrasp_success:FIGURE_6",
    "fig7": "whole_procedure:FIGURE_7",
    "tilt": "tilted_table:TILTED_TABLE",
}


def experiment_of(name: str) -> Experiment:
    """An experiment by its name.

    Raises:
        ValueError: an unknown name.
    """
    if name not in _PLACES:
        raise ValueError(f"experiment {name!r} is unknown; there are {', '.join(_PLACES)}")
    module, attribute = _PLACES[name].split(":")
    experiment: Experiment = getattr(importlib.import_module(f"diagrams.campaigns.{module}"), attribute)
    return experiment
