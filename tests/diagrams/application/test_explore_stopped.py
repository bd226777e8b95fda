"""Ctrl-C while the robot explores: what was pushed until then is kept, and can be gone on with."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import Diagram
from test_command_line import ENVIRONMENT, hear_ctrl_c

from slipmap.diagrams.loops import exploration_run
from slipmap.diagrams.loops.exploration_loop import LoopOptions
from slipmap.diagrams.loops.exploration_run import ExplorationStopped, LoopEnd, explore
from slipmap.diagrams.loops.run_folder import ExplorationFolder, resumed
from slipmap.diagrams.station.scenario import Scenario, read_scenario
from slipmap.diagrams.systems import identification
from slipmap.diagrams.systems.loop_messages import LoopStatus
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.identification import identify
from slipmap.models.inference.results import Identification as Learned
from slipmap.models.measurements import read_dataset

pytestmark = pytest.mark.usefixtures("renderer")

# Long steps and small pictures, for speed: these tests ask what is kept, not how well it was learned.
COARSE = "simulation: {time_step: 0.01}\ncamera: {rate: 5.0, width: 480, height_pixels: 360}\n"


def test_ctrl_c_in_the_second_push_leaves_the_first(tmp_path: Path) -> None:
    cell, out, result = tmp_path / "cell.yaml", tmp_path / "out", tmp_path / "result.json"
    cell.write_text(COARSE, encoding="utf-8")
    command = [sys.executable, "-m", "slipmap", "explore", "--scenario", cell, "--pushes", "3"]
    command += ["--checks", "0", "--output", out, "--json", result]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    with subprocess.Popen(
        [str(word) for word in command], env=ENVIRONMENT, text=True, preexec_fn=hear_ctrl_c, **pipes
    ) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("exploring: 1 of 3"):
                process.send_signal(signal.SIGINT)
                break
        said = process.stderr.read()
        code = process.wait(timeout=60)
    assert code == 130 and "Traceback" not in said
    assert "stopped after 1 of 3 pushes" in said and f"slipmap explore --resume {out}" in said
    assert len(read_dataset(out / "pushes").trials) == 1
    assert len(Belief.load(out / "belief.npz").probability) == 20
    assert json.loads(result.read_text(encoding="utf-8"))["failure"] == "stopped after 1 of 3 pushes."
    _, options, before = resumed(out)
    assert options.pushes == 3 and len(before.trials) == 1
    again = subprocess.run(
        [str(word) for word in command], env=ENVIRONMENT, text=True, capture_output=True, timeout=60
    )
    assert again.returncode == 2 and "holds an interrupted run with pushes recorded: 1" in again.stderr
    assert f"slipmap explore --resume {out}" in again.stderr
    assert len(resumed(out)[2].trials) == 1


def test_the_push_after_which_it_is_stopped_is_judged_as_in_a_run_that_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C, or worse, while the simulation waits for what is learned from the second push."""
    (tmp_path / "cell.yaml").write_text(COARSE, encoding="utf-8")
    cell, options = read_scenario(tmp_path / "cell.yaml"), LoopOptions(pushes=2, cells=20, hypotheses=4)
    whole = explore(cell, options)
    calls, kept = [], []

    def stopped(*arguments: Any, **settings: Any) -> Learned:
        calls.append(settings)
        if len(calls) == 2:
            kept.append(resumed(tmp_path)[2].watch)
            raise KeyboardInterrupt
        return identify(*arguments, **settings)

    monkeypatch.setattr(identification, "identify", stopped)
    with pytest.raises(ExplorationStopped) as told:
        explore(cell, options, record=ExplorationFolder(tmp_path, cell, options))
    assert [push.trial for push in whole.watch.judged] == [1]
    assert told.value.run is not None and told.value.run.watch.judged == whole.watch.judged
    scenario, options, before = resumed(tmp_path)
    for watch in (*kept, before.watch):
        assert watch is not None and (watch.trials, watch.judged) == (2, whole.watch.judged)
    again = explore(scenario, options, before=before)
    assert again.watch.judged == whole.watch.judged
    # No push was left to choose, and still it is known where the true object lies under the cells.
    np.testing.assert_allclose(again.X_SO, whole.X_SO, atol=5e-3)
    assert again.truth() is not None


def test_who_does_not_want_to_learn_when_stopped_does_not_wait_for_it(monkeypatch) -> None:
    def fails(*arguments: object) -> None:
        raise AssertionError("it learns")

    end = LoopEnd(LoopStatus("pushing", 1), None, None, True, 1.0, 0.0)  # type: ignore[arg-type]
    monkeypatch.setattr(exploration_run, "run_loop", lambda *arguments: end)
    monkeypatch.setattr(exploration_run, "explored", fails)
    with pytest.raises(ExplorationStopped, match="stopped at push 2 of 3") as stopped:
        explore(Scenario(), LoopOptions(pushes=2, checks=1), learn_when_stopped=False)
    assert stopped.value.run is None


@pytest.mark.parametrize("learn", [False, True])
def test_pushes_that_a_repair_asked_for_are_counted(monkeypatch, learn: bool) -> None:
    end = LoopEnd(LoopStatus("pushing", 6, of=8), None, None, True, 1.0, 0.0)  # type: ignore[arg-type]
    run = SimpleNamespace(dataset=SimpleNamespace(trials=[None] * 6))
    monkeypatch.setattr(exploration_run, "run_loop", lambda *arguments: end)
    monkeypatch.setattr(exploration_run, "explored", lambda *arguments: run)
    told = "stopped after 6 of 8 pushes" if learn else "stopped at push 7 of 8"
    with pytest.raises(ExplorationStopped, match=told):
        explore(Scenario(), LoopOptions(pushes=4, adapt=True), learn_when_stopped=learn)


def test_a_real_cell_that_ctrl_c_stops_is_looked_at_once_more_with_its_final_status(monkeypatch) -> None:
    status = LoopStatus("failed", 1, reason="stopped")

    def stopped(loop: Diagram, supervisor: str, last: object, longest: float, watch: Callable) -> LoopEnd:
        context = loop.CreateDefaultContext()
        watch(status, context)
        return LoopEnd(status, context, None, True, 1.0, 0.0)

    monkeypatch.setattr(exploration_run, "run_loop", stopped)
    with pytest.raises(ExplorationStopped, match="stopped after 0 of 3 pushes"):
        explore(Scenario(), LoopOptions(pushes=2, checks=1))
