"""A Diagram of your own: a finger makes two pushes; each is recorded, learned from and shown."""

import numpy as np
from pydrake.all import DiagramBuilder, Simulator, StartMeshcat

from slipmap import (
    BeliefVisualizer,
    CellGridSlider,
    FingerPath,
    Identification,
    Maps,
    TablePush,
    TrialLogger,
    cells_from_polygon,
)  # fmt: skip

grid = cells_from_polygon(np.array([[-6, -3], [6, -3], [6, 3], [-6, 3]]) * 0.01, count=18)
mass = 0.5 * np.where(grid.centers[:, :1].T > 0, 3.0, 1.0) / len(grid)  # kg; its right half is heavier
truth = Maps(mass, np.full_like(mass, 0.3), np.array([0.3]))
pushes = [TablePush([-0.03, -0.05], [-0.03, 0.02], 0.05), TablePush([0.10, 0.02], [0.04, 0.02], 0.05)]

builder = DiagramBuilder()
finger = builder.AddSystem(FingerPath(pushes, h=0.005))
slider = builder.AddSystem(CellGridSlider(grid, truth, finger_radius=0.008, h=0.005))
logger = builder.AddSystem(TrialLogger())
learner = builder.AddSystem(Identification(grid=grid, finger_radius=0.008, hypotheses=6))
visualizer = builder.AddSystem(BeliefVisualizer(StartMeshcat()))
builder.Connect(finger.GetOutputPort("finger"), slider.GetInputPort("finger"))
builder.Connect(finger.GetOutputPort("finger"), logger.GetInputPort("finger"))
builder.Connect(slider.GetOutputPort("object_pose"), logger.GetInputPort("object_pose"))
builder.Connect(slider.GetOutputPort("finger_force"), logger.GetInputPort("finger_force"))
builder.Connect(logger.GetOutputPort("trials"), learner.GetInputPort("trials"))
builder.Connect(logger.GetOutputPort("observed_pose"), visualizer.GetInputPort("object_pose"))
builder.Connect(learner.GetOutputPort("belief"), visualizer.GetInputPort("belief"))

simulator = Simulator(builder.Build())
simulator.AdvanceTo(finger.end)
belief = learner.GetOutputPort("belief").Eval(learner.GetMyContextFromRoot(simulator.get_context()))
print(
    f"after {belief.taught} pushes its centre of mass is at {belief.probability @ belief.centers_of_mass} m"
)
