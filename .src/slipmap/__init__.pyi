"""The names that `import slipmap` offers and where each is defined; `__init__.py` loads them on first use."""

from . import diagrams as diagrams, models as models, planners as planners
from .diagrams.application import figures as figures
from .diagrams.application.demonstration import (
    simulated_hammer as simulated_hammer,
    tilted_block as tilted_block,
)
from .diagrams.application.figures import (
    maps_figure as maps_figure,
    push_figures as push_figures,
    save as save,
)
from .diagrams.loops.exploration_loop import LoopOptions as LoopOptions
from .diagrams.loops.exploration_run import explore as explore
from .diagrams.loops.pregrasp_loop import PregraspOptions as PregraspOptions, pregrasp as pregrasp
from .diagrams.perception.cell_perception import CellPerception as CellPerception
from .diagrams.station.scenario import Scenario as Scenario
from .diagrams.station.station import Station as Station
from .diagrams.systems.belief_visualizer import BeliefVisualizer as BeliefVisualizer
from .diagrams.systems.cell_grid_slider import CellGridSlider as CellGridSlider
from .diagrams.systems.diagnosis import Diagnosis as Diagnosis
from .diagrams.systems.exploration import Exploration as Exploration
from .diagrams.systems.finger import FingerPath as FingerPath
from .diagrams.systems.goal_and_push_planner import GoalAndPushPlanner as GoalAndPushPlanner
from .diagrams.systems.identification import Identification as Identification
from .diagrams.systems.measurement_logger import TrialLogger as TrialLogger
from .diagrams.systems.model_monitor import ModelMonitor as ModelMonitor
from .diagrams.systems.multiverse_slider import MultiverseSlider as MultiverseSlider
from .diagrams.testing import open_cell as open_cell
from .models.effects.effect import Effect as Effect, Parameter as Parameter
from .models.effects.library import LIBRARY as LIBRARY
from .models.effects.registry import effects_named as effects_named, load_effects as load_effects
from .models.inference.belief import Belief as Belief
from .models.inference.comparison import compare as compare
from .models.inference.identification import fit as fit, identify as identify
from .models.inference.prediction import predict as predict
from .models.measurements.importing import import_dataset as import_dataset
from .models.measurements.push_dataset import PushDataset as PushDataset, Trial as Trial
from .models.measurements.reading import (
    dataset_from_arrays as dataset_from_arrays,
    read_dataset as read_dataset,
)
from .models.measurements.simulated import record_pushes as record_pushes
from .models.measurements.writing import write_dataset as write_dataset
from .models.objects.benchmark_objects import benchmark_object as benchmark_object, hammer as hammer
from .models.objects.footprints import cells_from_polygon as cells_from_polygon
from .models.objects.images import cells_from_label_image as cells_from_label_image
from .models.objects.meshes import cells_from_mesh as cells_from_mesh
from .models.physics.cell_grid import CellGrid as CellGrid
from .models.physics.maps import Maps as Maps
from .models.physics.pushes import Push as Push
from .models.physics.rollout import Slider as Slider
from .planners.exploration import candidate_pushes as candidate_pushes
from .planners.table_push import TablePush as TablePush
from .planners.telling_push import diagnose as diagnose

__version__: str
