"""Python frees whole diagrams, so that many can be run in one process."""

from __future__ import annotations

import gc
import re
import weakref
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, System

from slipmap import diagrams
from slipmap.diagrams.loops.exploration_loop import LoopOptions, exploration_loop
from slipmap.diagrams.loops.pregrasp_loop import PregraspOptions, pregrasp_loop
from slipmap.diagrams.systems.cell_grid_slider import CellGridSlider
from slipmap.diagrams.systems.python_system import PythonSystem, weakly
from slipmap.diagrams.testing.cell import small_scenario
from slipmap.diagrams.testing.twins import LockstepCell
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.physics.rollout import Maps

OPTIONS = LoopOptions(pushes=1, cells=20, hypotheses=4)


def subsystems(system: System) -> Iterator[System]:
    yield system
    if isinstance(system, Diagram):
        for part in system.GetSystems():
            yield from subsystems(part)


def count(kind: type) -> int:
    gc.collect()
    return sum(type(thing) is kind for thing in gc.get_objects())


def in_memory() -> Diagram:
    cell = LockstepCell(small_scenario("lockstep"))
    loop = exploration_loop(small_scenario("lockstep"), OPTIONS, cell=cell)
    simulator = Simulator(loop)
    cell.connect(simulator.get_mutable_context())
    simulator.AdvanceTo(0.05)
    cell.close()
    return loop


def simulated(make) -> Diagram:
    loop = make()
    Simulator(loop).AdvanceTo(0.05)
    return loop


@pytest.mark.usefixtures("renderer")
@pytest.mark.parametrize(
    "run",
    [
        lambda: simulated(lambda: exploration_loop(small_scenario("lockstep"), OPTIONS)),
        lambda: simulated(lambda: pregrasp_loop(small_scenario("lockstep"), PregraspOptions(OPTIONS))),
        in_memory,
    ],
    ids=["explore", "pregrasp", "lockstep"],
)
def test_a_loop_that_was_run_is_freed(run):
    plants = count(MultibodyPlant)
    alive = [weakref.ref(system) for system in subsystems(run())]
    assert len(alive) > 20
    gc.collect()
    assert [type(system()).__name__ for system in alive if system() is not None] == []
    assert count(MultibodyPlant) == plants, "also those with which its systems compute"


def test_the_model_as_a_system_is_freed():
    thing = benchmark_object("hammer")
    maps = Maps(thing.mass[None], thing.mu[None], np.array([0.3]))
    system = weakref.ref(CellGridSlider(thing.grid, maps, 0.008, 0.01))
    gc.collect()
    assert system() is None


def test_all_systems_are_of_the_kind_that_can_be_freed():
    kept = re.compile(r"^ *class \w+\((LeafSystem|LeafSystem_.*|VectorSystem|Diagram)\)", re.MULTILINE)
    files = sorted(Path(diagrams.__file__).parent.rglob("*.py"))
    assert len(files) > 100
    assert [file.name for file in files if kept.search(file.read_text())] == []


def test_outputs_are_those_of_the_functions_given():
    class Two(PythonSystem):
        def __init__(self) -> None:
            super().__init__()
            self.factor = 3.0
            self.DeclareVectorOutputPort("once", 1, self.once)
            self.DeclareVectorOutputPort(
                "twice", 1, lambda context, output: output.SetFromVector([2 * self.factor])
            )

        def once(self, context, output) -> None:
            output.SetFromVector([self.factor])

    two = Two()
    context = two.CreateDefaultContext()
    values = [two.get_output_port(k).Eval(context) for k in (0, 1)]
    np.testing.assert_array_equal(values, [[3.0], [6.0]])


def test_a_weakly_held_method_is_called_while_its_object_lives():
    class Ear:
        def __init__(self) -> None:
            self.heard: list[str] = []

        def hear(self, word: str) -> None:
            self.heard.append(word)

    ear = Ear()
    hear = weakly(ear.hear)
    hear("yes")
    assert ear.heard == ["yes"]
    gone = weakref.ref(ear)
    del ear
    assert gone() is None
    hear("no")
