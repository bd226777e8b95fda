"""slipmap finds out how an unknown object slides: maps of mass and friction from a few pushes.

What most scripts and notebooks need is offered here, each name loaded when it is first used:

>>> import slipmap
>>> dataset, truth = slipmap.simulated_hammer(seed=1)
>>> len(dataset.fit_trials), len(dataset.grid)
(6, 23)

`docs/python.md` has a line on each name. What is not offered here lies in `slipmap.models` (the world: the
sliding step, measurements, identification), `slipmap.planners` (what to do) and `slipmap.diagrams` (Drake
blocks, and the application around them).
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slipmap.diagrams.application.demonstration import simulated_hammer
    from slipmap.diagrams.application.figures import (
        effect_figure,
        error_figure,
        gain_figure,
        maps_figure,
        push_figures,
        save,
    )
    from slipmap.diagrams.loops.exploration_loop import LoopOptions
    from slipmap.diagrams.loops.exploration_run import explore
    from slipmap.diagrams.loops.pregrasp_loop import PregraspOptions
    from slipmap.diagrams.loops.pregrasp_loop import run_pregrasp as pregrasp
    from slipmap.diagrams.perception.cell_perception import CellPerception
    from slipmap.diagrams.station.scenario import Scenario
    from slipmap.diagrams.station.station import Station
    from slipmap.diagrams.systems.belief_visualizer import BeliefVisualizer
    from slipmap.diagrams.systems.cell_grid_slider import CellGridSlider
    from slipmap.diagrams.systems.exploration import Exploration
    from slipmap.diagrams.systems.finger import FingerMotion
    from slipmap.diagrams.systems.goal_and_push_planner import GoalAndPushPlanner
    from slipmap.diagrams.systems.identification import Identification
    from slipmap.diagrams.systems.measurement_logger import MeasurementLogger
    from slipmap.diagrams.systems.model_monitor import ModelMonitor
    from slipmap.diagrams.testing import open_cell
    from slipmap.models.effects.effect import Effect, Parameter
    from slipmap.models.effects.library import LIBRARY
    from slipmap.models.effects.registry import load_effects
    from slipmap.models.inference.belief import Belief
    from slipmap.models.inference.comparison import compare
    from slipmap.models.inference.diagnosis.effect_fit import fit_effects as fit
    from slipmap.models.inference.identification import identify
    from slipmap.models.inference.prediction import predict
    from slipmap.models.measurements.push_dataset import PushDataset, Trial
    from slipmap.models.measurements.reading import read_dataset
    from slipmap.models.measurements.simulated import record_pushes
    from slipmap.models.measurements.writing import write_dataset
    from slipmap.models.objects.benchmark_objects import benchmark_object
    from slipmap.models.objects.footprints import cells_from_polygon
    from slipmap.models.objects.images import cells_from_label_image
    from slipmap.models.objects.meshes import cells_from_mesh
    from slipmap.models.physics.cell_grid import CellGrid
    from slipmap.models.physics.maps import Maps
    from slipmap.models.physics.pushes import Push
    from slipmap.models.physics.rollout import Slider
    from slipmap.planners.table_push import TablePush
    from slipmap.planners.telling_push import diagnosed as diagnose

_PLACES = {
    "diagrams.application.demonstration": "simulated_hammer",
    "diagrams.application.figures": "effect_figure error_figure gain_figure maps_figure push_figures save",
    "diagrams.loops.exploration_loop": "LoopOptions",
    "diagrams.loops.exploration_run": "explore",
    "diagrams.loops.pregrasp_loop": "PregraspOptions pregrasp=run_pregrasp",
    "diagrams.perception.cell_perception": "CellPerception",
    "diagrams.station.scenario": "Scenario",
    "diagrams.station.station": "Station",
    "diagrams.systems.belief_visualizer": "BeliefVisualizer",
    "diagrams.systems.cell_grid_slider": "CellGridSlider",
    "diagrams.systems.exploration": "Exploration",
    "diagrams.systems.finger": "FingerMotion",
    "diagrams.systems.goal_and_push_planner": "GoalAndPushPlanner",
    "diagrams.systems.identification": "Identification",
    "diagrams.systems.measurement_logger": "MeasurementLogger",
    "diagrams.systems.model_monitor": "ModelMonitor",
    "diagrams.testing": "open_cell",
    "models.effects.effect": "Effect Parameter",
    "models.effects.library": "LIBRARY",
    "models.effects.registry": "load_effects",
    "models.inference.belief": "Belief",
    "models.inference.comparison": "compare",
    "models.inference.diagnosis.effect_fit": "fit=fit_effects",
    "models.inference.identification": "identify",
    "models.inference.prediction": "predict",
    "models.measurements.push_dataset": "PushDataset Trial",
    "models.measurements.reading": "read_dataset",
    "models.measurements.simulated": "record_pushes",
    "models.measurements.writing": "write_dataset",
    "models.objects.benchmark_objects": "benchmark_object",
    "models.objects.footprints": "cells_from_polygon",
    "models.objects.images": "cells_from_label_image",
    "models.objects.meshes": "cells_from_mesh",
    "models.physics.cell_grid": "CellGrid",
    "models.physics.maps": "Maps",
    "models.physics.pushes": "Push",
    "models.physics.rollout": "Slider",
    "planners.table_push": "TablePush",
    "planners.telling_push": "diagnose=diagnosed",
}
"""By module: the names that are offered of it; `offered=name` where it is called otherwise there."""

_HOMES = {
    offered.partition("=")[0]: (module, offered.rpartition("=")[2])
    for module, names in _PLACES.items()
    for offered in names.split()
}

__all__ = [
    "LIBRARY",
    "Belief",
    "BeliefVisualizer",
    "CellGrid",
    "CellGridSlider",
    "CellPerception",
    "Effect",
    "Exploration",
    "FingerMotion",
    "GoalAndPushPlanner",
    "Identification",
    "LoopOptions",
    "Maps",
    "MeasurementLogger",
    "ModelMonitor",
    "Parameter",
    "PregraspOptions",
    "Push",
    "PushDataset",
    "Scenario",
    "Slider",
    "Station",
    "TablePush",
    "Trial",
    "benchmark_object",
    "cells_from_label_image",
    "cells_from_mesh",
    "cells_from_polygon",
    "compare",
    "diagnose",
    "effect_figure",
    "error_figure",
    "explore",
    "fit",
    "gain_figure",
    "identify",
    "load_effects",
    "maps_figure",
    "open_cell",
    "predict",
    "pregrasp",
    "push_figures",
    "read_dataset",
    "record_pushes",
    "save",
    "simulated_hammer",
    "write_dataset",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _HOMES[name]
    value = getattr(import_module(f"{__name__}.{module}"), attribute)
    globals()[name] = value  # asked for once
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
