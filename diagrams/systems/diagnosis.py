"""Diagnosis as a block: where pushes surprise the model, it finds out which effects to add."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from typing import Any

from pydrake.systems.framework import Context

from slipmap.diagrams.systems.python_system import PythonSystem, held
from slipmap.diagrams.systems.workers import begun
from slipmap.models.inference.diagnosis import procedure
from slipmap.models.measurements import PushDataset, Trial
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.planners.settings import RepairSettings

PERIOD = 0.05


@dataclass(frozen=True)
class Finding:
    """What came of one diagnosis, and what the robot did about it."""

    pushes: int  # that were diagnosed
    verdict: str  # see `slipmap.models.inference.diagnosis.results.VERDICTS`
    sentence: str  # that says so
    effects: tuple[str, ...]  # that the model has from then on
    action: str  # `adopts`, `keeps`, `drops`, `pushes on`, `goes on without`


@dataclass(frozen=True)
class Repair:
    """Which effects the model is given, and how that came about."""

    trials: int = 0  # recorded pushes up to which the question is settled
    effects: tuple[str, ...] = ()  # that the model is to have
    wanted: int = 0  # pushes to learn from that it asks for, altogether
    findings: tuple[Finding, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return {"effects": list(self.effects), "findings": [asdict(finding) for finding in self.findings]}


class Diagnosis(PythonSystem):
    """Looks into alarms of the monitor, and repairs the model.

    Inputs:
    - `trials`: tuple of recorded `Trial`s, the oldest first; `cell_grid`: `CellGrid` of the object.
    - `watch`: `Watch` of a `ModelMonitor` that has the same trials.
    Outputs:
    - `repair`: `Repair`; `effects`: its tuple of names, for an `Identification`.

    While pushes end as predicted, all stays as it is. Where the monitor gives an alarm, or is in doubt, all
    pushes are diagnosed. One effect, or
    two that are needed together, are adopted; of effects that these pushes cannot tell apart, the simplest.
    Where the answer is `undecided` another push is asked for. Where the effect is unknown, and where nothing
    is missing after all, the robot goes on without: what surprised it widens its intervals as it learns. An
    adopted effect after which pushes still surprise is looked into with all others again, and dropped where
    it is not named any more.

    Args:
        make_dataset: makes trials and grid a dataset with all that is known of the place.
        settings: how many pushes it may ask for, and when it asks.
        pushes: of exploring, to which these come.
        effects: that the model has from the start, and keeps whatever is found.
        seed: of every draw.
        settled: pushes that were recorded before, which are not looked into by themselves.
        worker: who computes; this process if None, and then the simulation waits.

    Example:
        >>> import slipmap
        >>> block = slipmap.Diagnosis(lambda trials, grid: None, slipmap.Scenario().repair, pushes=5)
        >>> [block.get_output_port(i).get_name() for i in range(block.num_output_ports())]
        ['repair', 'effects']
    """

    def __init__(
        self,
        make_dataset: Callable[[Sequence[Trial], CellGrid], PushDataset],
        settings: RepairSettings,
        *,
        pushes: int,
        effects: Sequence[str] = (),
        seed: int = 0,
        settled: int = 0,
        worker: Executor | None = None,
    ) -> None:
        super().__init__()
        self._make_dataset = make_dataset
        self._settings, self._most = settings, pushes + settings.pushes
        self._given, self._seed, self._worker = tuple(effects), seed, worker
        self.declare_inputs("trials", "cell_grid", "watch")
        self._state = self.DeclareAbstractState(held((Repair(settled, tuple(effects)), None)))
        self.declare_steps(PERIOD, self._state, self._next)
        self.declare_output_of("repair", self._state, lambda state: state[0])
        self.declare_output_of("effects", self._state, lambda state: state[0].effects)

    def _next(self, context: Context, now: tuple[Repair, Any]) -> tuple[Repair, Any]:
        repair, job = now
        if job is None:
            trials, watch = self.input(context, "trials"), self.input(context, "watch")
            if not repair.trials < len(trials) == watch.trials:
                return now
            if not watch.alarm and watch.evidence < self._settings.doubt:
                return replace(repair, trials=len(trials)), None
            if len(trials) < self._settings.fewest:
                return self._pushing_on(replace(repair, trials=len(trials))), None
            teaching = [replace(trial, role="fit") for trial in trials]
            dataset = self._make_dataset(teaching, self.input(context, "cell_grid"))
            job = (len(trials), begun(self._worker, procedure.diagnose, dataset, seed=self._seed))
        count, result = job
        return (self._concluded(repair, count, result.result()), None) if result.done() else (repair, job)

    def _concluded(self, repair: Repair, count: int, found: procedure.Diagnosis) -> Repair:
        """The repair after a diagnosis of so many pushes."""
        effects: tuple[str, ...] = ()
        if found.verdict in ("effect", "ambiguous"):
            rivals = [rival.effects for rival in found.rivals]
            simplest = min(rivals, key=lambda rival: sum(len(effect.parameters) for effect in rival))
            effects = tuple(effect.name for effect in simplest if effect.name not in self._given)
        named, effects = bool(effects), (*self._given, *effects)
        if named:
            action = "keeps" if set(effects) == set(repair.effects) else "adopts"
        elif repair.effects != self._given:
            action = "drops"
        else:
            action = "pushes on" if found.verdict == "undecided" and count < self._most else "goes on without"
        finding = Finding(count, found.verdict, found.sentence, effects, action)
        after = replace(repair, trials=count, effects=effects, findings=(*repair.findings, finding))
        if action == "adopts":
            return replace(after, wanted=min(max(after.wanted, count + self._settings.probation), self._most))
        return self._pushing_on(after) if found.verdict == "undecided" else after

    def _pushing_on(self, repair: Repair) -> Repair:
        return replace(repair, wanted=min(max(repair.wanted, repair.trials + 1), self._most))
