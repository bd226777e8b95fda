"""One process of a soak: explores in a cell in lockstep until it is done, a fault stops it, or it is killed.

`soak.py` starts it as `python soak_session.py FOLDER`, with a task on
its standard input. Lines on its standard output say how far it is.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from slipmap.diagrams.testing.assertions import CommandLog
from slipmap.diagrams.testing.faults import Fault

PLANT, COMMANDS = "plant.npy", "commands.npy"

DOWNHILL = 0.03, -0.015  # rad; a tilt of 2°

_PAGE = resource.getpagesize() / 1e6  # MB
_KILLED = "killed"


@dataclass
class Task:
    """What a session is to do.

    Attributes:
        object_name: of the benchmark.
        pushes, checks, seed: of the exploration.
        adapt: whether the table is secretly tilted and the robot repairs its model; every push teaches then.
        faults: what goes wrong when, as (stage, push from 1, fault); a fault of None kills the process.
    """

    object_name: str
    pushes: int
    checks: int
    seed: int
    adapt: bool = False
    faults: list[tuple[str, int, Fault | None]] = field(default_factory=list)

    def to_json(self) -> str:
        """In one line."""
        return json.dumps(asdict(self))

    @staticmethod
    def of(text: str) -> Task:
        """From that line."""
        told: dict[str, Any] = json.loads(text)
        faults = [
            (stage, push, None if fault is None else Fault(**{**fault, "band": tuple(fault["band"])}))
            for stage, push, fault in told.pop("faults")
        ]
        return Task(**told, faults=faults)


def resident() -> float:
    """Memory of this process, MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE


def main(folder: Path, task: Task) -> None:
    """Explore, or go on exploring, in a folder."""
    from slipmap.diagrams.loops.exploration_loop import LoopOptions
    from slipmap.diagrams.loops.exploration_run import DOING, ExplorationFailed, explore
    from slipmap.diagrams.loops.run_folder import RUN, ExplorationFolder, resumed
    from slipmap.diagrams.station.hidden_effects import TableTilt
    from slipmap.diagrams.testing.cell import LOCKSTEP, Faults, small_scenario
    from slipmap.diagrams.testing.twins import LockstepCell

    # Few and large cells: what is soaked is the cell and what drives it, not how well it learns.
    options = LoopOptions(
        pushes=task.pushes + task.checks * task.adapt, checks=task.checks * (not task.adapt),
        strategy="random", cells=30, hypotheses=8, seed=task.seed, adapt=task.adapt,
    )  # fmt: skip
    scenario, before = small_scenario(LOCKSTEP), None
    scenario.object.name = task.object_name
    if task.adapt:
        scenario.hidden.table_tilt = TableTilt(*DOWNHILL)
    if (folder / RUN).exists():
        scenario, options, before = resumed(folder)
    plant = folder / PLANT
    cell = LockstepCell(scenario, np.load(plant) if plant.exists() else None)
    faults = Faults()
    faults._way = cell
    kills = {(stage, push) for stage, push, fault in task.faults if fault is None}
    for stage, push, fault in task.faults:
        if fault is not None:
            faults.when(stage, fault, push=push)
    said = ""

    def leave() -> None:
        if cell.positions is not None:
            np.save(plant, cell.positions)
        np.save(folder / COMMANDS, np.column_stack([cell.log().times, cell.log().q]))

    def watch(stage: str, done: int, total: int) -> None:
        nonlocal said
        faults.look(stage, done)
        doing = next((mode for mode, words in DOING.items() if stage.endswith(words)), "")
        if doing and stage != said:
            said = stage
            tell(recorded=done + (doing == "learning"), doing=doing, resident=resident(), time=cell.now)
        if kills and doing == "pushing" and any(done + 1 >= push for _, push in kills) and cell.now > 6.0:
            leave()
            tell(end=_KILLED, faults=[str(fault) for fault in faults.happened], time=cell.now)
            os.kill(os.getpid(), signal.SIGKILL)

    record = ExplorationFolder(folder, scenario, options, before)
    try:
        run = explore(scenario, options, hardware=cell, progress=watch, record=record, before=before)
        record.end()
        end = ""
    except ExplorationFailed as failure:
        end, run = str(failure), failure.run
    recorded = 0 if run is None else len(run.dataset.trials)
    repair = None if run is None else run.repair
    effects = [] if repair is None else list(repair.effects)
    leave()
    tell(
        end=end,
        recorded=recorded,
        effects=effects,
        faults=[str(fault) for fault in faults.happened],
        time=cell.now,
    )


def tell(**said: Any) -> None:
    """Write a line to the standard output."""
    print(json.dumps(said), flush=True)


def commands_of(folder: Path) -> CommandLog:
    """All commands of the session that last ran in a folder."""
    return CommandLog.of(np.load(folder / COMMANDS))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Task.of(sys.stdin.readline()))
