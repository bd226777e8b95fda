"""Diagnosis as a block: when pushes surprise, it finds the effect that the model is missing and tries it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from slipmap.diagrams.systems.identification import learning
from slipmap.diagrams.systems.model_monitor import Watch
from slipmap.diagrams.systems.python_system import PythonSystem, held
from slipmap.diagrams.systems.workers import begun
from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.diagnosis import procedure
from slipmap.models.inference.prediction import predict
from slipmap.models.measurements import Trial
from slipmap.models.measurements.push_dataset import MakeDataset
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.settings import check_whole
from slipmap.planners.settings import RepairSettings
from slipmap.planners.telling_push import OF_FORCE, Question, robots_question

PERIOD = 0.05

TELLS = 1e-3
"""m by which errors with and without an effect must differ for a push to favour either: camera and finger are
off by a third of that."""

FAILED, TRIED, CLOSE = "failed", "tried", "close"
"""Verdicts in addition to those of a diagnosis: it raised an error; effects were tried on the next pushes;
they were, but did worse, though not by far, or made no difference."""

_OPEN = ("undecided", "unknown", FAILED, CLOSE)
"""Verdicts that speak neither for nor against effects that are on trial."""

_QUESTION = "question"  # what a diagnosis is begun for that finds a question again

_FAR, _FAR_BY = 2.0, 3.0
"""How many times larger, and by how many mm, errors with an effect must be for its first test to drop it."""


@dataclass(frozen=True)
class Finding:
    """The result of one diagnosis or one test of effects, and what the robot did about it."""

    pushes: int  # pushes examined
    verdict: str  # see `slipmap.models.inference.diagnosis.results.VERDICTS`; or `FAILED`, `TRIED`, `CLOSE`
    sentence: str  # the verdict in words
    effects: tuple[str, ...]  # of the model from then on
    action: str  # `adopts`, `keeps`, `drops`, `pushes on`, `goes on without`
    telling: str = ""  # what the next pushes are chosen to tell apart; empty if nothing
    rival: str = ""  # an effect that may be there instead of the last one; empty if none

    @property
    def model(self) -> str:
        """The effects in words: `table_tilt or tether`."""
        return either(self.effects, self.rival)


@dataclass(frozen=True)
class Repair:
    """The effects that the model is given, and the findings behind them."""

    trials: int = 0  # recorded pushes that have been dealt with
    effects: tuple[str, ...] = ()  # that the model should have
    wanted: int = 0  # total pushes to learn from that it asks for
    findings: tuple[Finding, ...] = ()
    question: Question | None = None  # what the next push is to tell apart
    asks_again: bool = False  # whether the question about effects on trial has yet to be found again
    given: tuple[str, ...] = ()  # effects that the model had from the start
    rival: str = ""  # see `Finding`

    @property
    def model(self) -> str:
        """The effects in words: `table_tilt or tether`."""
        return either(self.effects, self.rival)

    @property
    def tried(self) -> Finding | None:
        """The adoption of effects that no later finding has tested or reversed. To be named again is no
        test."""
        for finding in reversed(self.findings):
            if finding.action == "adopts":
                return finding
            if finding.verdict == TRIED or finding.action in ("drops", "goes on without"):
                break
        return None

    @property
    def tested_at(self) -> int:
        """Pushes recorded when effects were last adopted or tested; 0 if none are on trial."""
        tested = [one.pushes for one in self.findings if one.verdict == CLOSE]
        return 0 if self.tried is None else max([self.tried.pushes, *tested])

    def to_json(self) -> dict[str, Any]:
        """As plain data, for people and programs."""
        findings = [asdict(finding) for finding in self.findings]
        return {"effects": list(self.effects), "rival": self.rival, "findings": findings}

    def to_run(self) -> dict[str, Any]:
        """As plain data from which another process can continue; the question is left out."""
        return {"trials": self.trials + self.asks_again, "wanted": self.wanted, **self.to_json()}

    @classmethod
    def of_run(cls, stored: dict[str, Any]) -> Repair:
        """Restore what `to_run` stored. If the last finding left a question, its pushes are diagnosed again
        to ask it.

        Raises:
            KeyError, TypeError: the data is not a stored `Repair`.
        """
        findings = tuple(Finding(**{**one, "effects": tuple(one["effects"])}) for one in stored["findings"])
        trials, effects = int(stored["trials"]), tuple(stored["effects"])
        wanted, rival = int(stored["wanted"]), str(stored.get("rival", ""))
        last = findings[-1] if findings else None
        if last is not None and last.action == "pushes on" and last.telling and last.pushes == trials:
            return cls(trials - 1, effects, wanted, findings[:-1], rival=rival)
        found = cls(trials, effects, wanted, findings, rival=rival)
        if last is not None and last.telling and found.tried is not None:
            return replace(found, trials=trials - 1, asks_again=True)
        return found


@dataclass(frozen=True, eq=False)
class _Answer:
    """The result of a diagnosis, small enough to pass between processes."""

    verdict: str
    sentence: str
    # names and numbers of parameters of each rival's effects, without those `OF_FORCE`
    rivals: tuple[tuple[tuple[str, int], ...], ...] = ()
    p: float = 0.0  # of their largest gain
    # gains of the effects that leave nothing unexplained, in the answer or not, nats; not those `OF_FORCE`
    explaining: Mapping[str, float] = field(default_factory=dict)
    question: Question | None = None


class Diagnosis(PythonSystem):
    """Investigates the monitor's alarms and repairs the model.

    Inputs:
    - `trials`: tuple of recorded `Trial`s, the oldest first; `cell_grid`: `CellGrid` of the object.
    - `watch`: `Watch` of a `ModelMonitor` that has the same trials.
    Outputs:
    - `repair`: `Repair`; `effects`, `rival`: its names, for an `Identification`.

    All pushes are diagnosed when the monitor raises an alarm or is in doubt, and every few pushes even if
    none was surprising: a late camera, for example, does not change where objects come to rest. One effect is
    adopted, or two that are needed together; among effects that the pushes cannot tell apart, the simplest.
    Where another effect explains the pushes better than that, it is its rival: hypotheses have one or the
    other. Near the middle of a table, a tether acts like a tilt.
    Effects of the force sensor are not adopted, as they move nothing. If the verdict is `undecided` and the
    best effect gains more than is likely by chance, the block asks for another push and states which models
    it should tell apart (`Repair.question`). If the effect is unknown, or nothing seems to be missing, the
    robot continues without one; surprising pushes widen its intervals as it learns.

    Adopted effects are tested on the next pushes. If a model with them predicts these no better, along the
    way and at the end, than one without, both learned from all pushes before each, the effects are dropped;
    after a first close call, or if they make no difference, these and as many pushes again decide. If these
    pushes surprise, all are diagnosed again, and an effect that is no longer named is dropped, unless the new
    verdict is undecided or unknown and the test is still to come or was passed. An exception raised by a
    diagnosis becomes its finding, and the robot continues with its present model.

    Args:
        make_dataset: combines trials and grid into a dataset with everything known about the setup.
        settings: how many pushes it may ask for, and when.
        pushes: number of exploration pushes, to which these are added.
        effects: that the model has from the start and always keeps.
        seed: of every draw.
        before: an earlier process's result; pushes already dealt with do not start a diagnosis.
        worker: runs the computation; if None, this process does, and the simulation waits.

    Raises:
        EffectError: an unknown effect.
        ValueError: `pushes` or `seed` is no whole number, or too small.

    Example:
        >>> import slipmap
        >>> block = slipmap.Diagnosis(lambda trials, grid: None, slipmap.Scenario().repair, pushes=5)
        >>> [block.get_output_port(i).get_name() for i in range(block.num_output_ports())]
        ['repair', 'effects', 'rival']
    """

    def __init__(
        self,
        make_dataset: MakeDataset,
        settings: RepairSettings,
        *,
        pushes: int,
        effects: Sequence[str] = (),
        seed: int = 0,
        before: Repair | None = None,
        worker: Executor | None = None,
    ) -> None:
        super().__init__()
        effects_named(effects)
        check_whole("Diagnosis: pushes", pushes, 1)
        check_whole("Diagnosis: seed", seed, 0)
        self._make_dataset = make_dataset
        self._settings, self._most = settings, pushes + settings.pushes
        self._given, self._seed, self._worker = tuple(effects), seed, worker
        self.declare_inputs("trials", "cell_grid", "watch")
        start = replace(before or Repair(effects=self._given), given=self._given)
        self._state = self.DeclareAbstractState(held((start, None)))
        self.declare_steps(PERIOD, self._state, self._next)
        self.declare_output_of("repair", self._state, lambda state: state[0])
        self.declare_output_of("effects", self._state, lambda state: state[0].effects)
        self.declare_output_of("rival", self._state, lambda state: state[0].rival)

    def _next(self, context: Context, now: tuple[Repair, Any]) -> tuple[Repair, Any]:
        repair, job = now
        if job is None:
            trials, watch = self.input(context, "trials"), self.input(context, "watch")
            if not repair.trials < len(trials) == watch.trials:
                return now
            task: Any = None
            rest: tuple[Any, ...]
            due = repair.tested_at + self._settings.probation
            if repair.asks_again and len(trials) < due:
                asked = trials[: repair.findings[-1].pushes]
                begins = begun(
                    self._worker,
                    _diagnosed,
                    self._make_dataset,
                    asked,
                    self.input(context, "cell_grid"),
                    self._seed,
                )
                return repair, (repair.trials + 1, begins, _QUESTION)
            if repair.tried is not None and len(trials) >= due:
                models = ((repair.effects, repair.rival), self._without(repair))
                task, rest = _errors_of, (repair.tried.pushes, models, self._seed)
            elif self._doubtful(repair, len(trials), watch):
                if len(trials) < self._settings.fewest:
                    return self._pushing_on(replace(repair, trials=len(trials))), None
                task, rest = _diagnosed, (self._seed,)
            if task is None:
                return replace(repair, trials=len(trials)), None
            grid = self.input(context, "cell_grid")
            begins = begun(self._worker, task, self._make_dataset, trials, grid, *rest)
            job = (len(trials), begins, "diagnosis" if task is _diagnosed else "test of the effects")
        count, result, what = job
        if not result.done():
            return repair, job
        if what == _QUESTION:
            question = None if result.exception() else result.result().question
            return replace(repair, trials=count, question=question, asks_again=False), None
        try:
            answer = result.result()
        except Exception as error:  # whatever it is, the robot can go on with the model that it has
            sentence = f"The {what} failed: {error or type(error).__name__}."
            return self._concluded(repair, count, _Answer(FAILED, sentence)), None
        if isinstance(answer, _Answer):
            return self._concluded(repair, count, answer), None
        return self._tried(repair, count, answer), None

    def _doubtful(self, repair: Repair, count: int, watch: Watch) -> bool:
        """Whether to diagnose the pushes: they surprised, the answer is open, or a check is due."""
        if watch.alarm or watch.evidence >= self._settings.doubt:
            return True
        if repair.tried is not None:
            return False
        last = repair.findings[-1] if repair.findings else None
        due = last is None or last.action == "pushes on" or count >= last.pushes + self._settings.every
        return due and count >= self._settings.fewest

    def _concluded(self, repair: Repair, count: int, found: _Answer) -> Repair:
        """The repair after a diagnosis of `count` pushes."""
        named: tuple[str, ...] = ()
        if found.verdict in ("effect", "ambiguous"):
            # Effects of the force sensor alone leave an empty rival, the simplest: nothing needs adopting.
            simplest = min(found.rivals, key=lambda rival: sum(size for _, size in rival))
            sets = [{name for name, _ in rival} - set(self._given) for rival in found.rivals]
            named = tuple(name for name, _ in simplest if name not in self._given)
            if not named and set(repair.effects) - set(self._given) in sets:  # still in the running
                named = tuple(name for name in repair.effects if name not in self._given)
        effects, question = (*self._given, *named), found.question
        rival = self._rival_of(named, found.explaining)
        is_open = found.verdict == "undecided" and found.p <= self._settings.chance
        if found.verdict == FAILED:
            effects, rival, question = repair.effects, repair.rival, None
        elif not named and (
            (found.verdict != "adequate" and self._confirmed(repair))
            or (found.verdict in _OPEN and repair.tried is not None)
        ):
            # Something else is wrong as well, but pushes have shown, or will, whether these effects help.
            effects, rival = repair.effects, repair.rival
        if named:
            new_rival = bool(rival) and rival != repair.rival and repair.tried is None
            action = "keeps" if set(effects) == set(repair.effects) and not new_rival else "adopts"
        elif effects != repair.effects:
            action = "drops"
        elif is_open and count < self._most:
            action = "pushes on"
        else:
            action = "goes on without" if effects == self._given else "keeps"
        if action == "goes on without":
            question = None
        telling = "" if question is None else question.words
        sentence = found.sentence
        if named and rival:
            sentence += f" {rival} explains these pushes better than {named[0]}, so the model has either."
        finding = Finding(count, found.verdict, sentence, effects, action, telling, rival)
        after = _after(repair, finding, question)
        if action == "adopts":
            return replace(after, wanted=min(max(after.wanted, count + self._settings.probation), self._most))
        return self._pushing_on(after) if is_open else after

    def _rival_of(self, named: Sequence[str], explaining: Mapping[str, float]) -> str:
        """The rival of a single effect: the one that explains the pushes better, if there is one."""
        others = {name: gain for name, gain in explaining.items() if name not in self._given}
        if len(named) != 1 or named[0] not in others:
            return ""
        best = max(others, key=lambda name: (others[name], name == named[0]))
        return "" if best == named[0] else best

    def _tried(self, repair: Repair, count: int, errors: Sequence[tuple[float, float]]) -> Repair:
        """The repair after effects were tested on pushes.

        Args:
            count: pushes recorded so far.
            errors: of each push since they were adopted, with the effects and without, m.
        """
        telling = [pair for pair in errors if abs(pair[0] - pair[1]) > TELLS]
        own, other = (1e3 * np.mean([pair[k] for pair in telling or errors]) for k in (0, 1))
        judging = len(telling or errors)
        pushes = "1 push was" if judging == 1 else f"{judging} pushes were"
        said = f"With {repair.model}, {pushes} {own:.1f} mm off on average; without, {other:.1f} mm."
        effects, rival, action = repair.effects, repair.rival, "keeps"
        verdict, wanted = TRIED, repair.wanted
        assert repair.tried is not None
        first = repair.tested_at == repair.tried.pushes
        if not telling:
            said += f" That decides nothing{', so the test goes on' * first}."
            verdict = CLOSE if first else TRIED
        elif own >= other:
            if first and (own < _FAR * other or own < other + _FAR_BY):
                said += " That is close, so the test goes on."
                verdict, wanted = CLOSE, min(max(wanted, count + self._settings.probation), self._most)
            else:
                (effects, rival), action = self._without(repair), "drops"
        finding = Finding(count, verdict, said, effects, action, rival=rival)
        return replace(_after(repair, finding), wanted=wanted)

    def _confirmed(self, repair: Repair) -> bool:
        """Whether the present effects were tested on pushes and kept."""
        return any(
            one.verdict == TRIED and one.action == "keeps" and one.effects == repair.effects
            for one in repair.findings
        )

    def _without(self, repair: Repair) -> tuple[tuple[str, ...], str]:
        """The model's effects and their rival before it adopted those on trial."""
        assert repair.tried is not None
        place = repair.findings.index(repair.tried)
        before = repair.findings[place - 1] if place else None
        return (self._given, "") if before is None else (before.effects, before.rival)

    def _pushing_on(self, repair: Repair) -> Repair:
        return replace(repair, wanted=min(max(repair.wanted, repair.trials + 1), self._most))


def _after(repair: Repair, finding: Finding, question: Question | None = None) -> Repair:
    """The repair once a finding was made."""
    return Repair(
        finding.pushes,
        finding.effects,
        repair.wanted,
        (*repair.findings, finding),
        question,
        given=repair.given,
        rival=finding.rival,
    )


def _diagnosed(make: MakeDataset, trials: Sequence[Trial], grid: CellGrid, seed: int) -> _Answer:
    """Diagnose pushes; runs in a worker."""
    dataset = make([replace(trial, role="fit") for trial in trials], grid)
    found = procedure.diagnose(dataset, seed=seed)
    rivals = tuple(
        tuple((one.name, len(one.parameters)) for one in rival.effects if one.name not in OF_FORCE)
        for rival in found.rivals
    )
    p = min(
        (one.p_value for one in found.candidates if one.p_value is not None and one.name not in OF_FORCE),
        default=0.0,
    )
    explaining = {
        one.name: one.fitted_gain
        for one in found.candidates
        if one.explains and one.fitted_gain is not None and one.name not in OF_FORCE
    }
    return _Answer(found.verdict, found.sentence, rivals, p, explaining, robots_question(found, dataset))


def either(effects: Sequence[str], rival: str) -> str:
    """Effects of a model in words, with the rival of the last one."""
    return " and ".join(effects) + f" or {rival}" * bool(rival)


def has_model(has: Sequence[str], effects: Sequence[str], rival: str) -> bool:
    """Whether a belief that has some effects includes those of a model, or its rival instead of the last."""
    *others, last = effects or ("",)
    return not effects or (set(others) <= set(has) and (last in has or (bool(rival) and rival in has)))


def _errors_of(
    make: MakeDataset,
    trials: Sequence[Trial],
    grid: CellGrid,
    count: int,
    models: tuple[tuple[tuple[str, ...], str], tuple[tuple[str, ...], str]],
    seed: int,
) -> list[tuple[float, float]]:
    """Errors, m, of the pushes after the first `count`, each predicted by two models with these effects and
    their rival, learned from all pushes before it.

    Of a push, the larger one of its mean error (ADD) along the way and that at the end: a late camera, for
    example, does not change where objects come to rest.
    """

    def error(model: tuple[tuple[str, ...], str], before: int) -> float:
        effects, rival = model
        taught = make([replace(trial, role="fit") for trial in trials[:before]], grid)
        (push,) = predict(
            learning(effects, rival=rival)(taught, seed=seed).belief, make([trials[before]], grid)
        )
        return max(push.errors.mean_add, push.final_add)

    with_them, without = models
    return [(error(with_them, k), error(without, k)) for k in range(count, len(trials))]
