"""`ModelMonitor`: checks whether the object still moves as the model predicts; residual, misfit and alarm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import Context

from slipmap.diagrams.systems.python_system import PythonSystem, held, read
from slipmap.models.geometry import turned_to
from slipmap.models.inference import push_misfit
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.error_model import ErrorModel
from slipmap.models.inference.observations import observe
from slipmap.models.inference.prediction import predicted_motion
from slipmap.models.measurements import Trial
from slipmap.models.measurements.push_dataset import Noise
from slipmap.models.perception.seen_object import UNSEEN_ANGLE, angle_held
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.paper_notation import add
from slipmap.models.settings import check_not_negative, check_positive

LEVEL = 0.01
"""Rate of false alarms: with a correct model, at least 1/LEVEL pushes pass on average before the evidence
gives one, and this share of pushes ends outside the region that gives one at once."""

LEAST_P = 0.005
"""Lower bound on a push's p in the evidence, so that an alarm by evidence takes three such pushes."""

MODEL_ERROR = 0.03
"""α, the model's usual error as a share of the path; regions use the learned value if there is one."""

FORCE_ERROR = 0.1
"""β, the same for the mean force of a push: in the simulated station it was off by 2 to 5 % without any
hidden effect, and by 30 to 80 % on a table tilted by 12°."""


@dataclass(frozen=True)
class Judged:
    """One push that was predicted and seen."""

    trial: int  # number of the push in the recording, from 0
    misfit: float  # see `slipmap.models.inference.push_misfit`
    p: float  # probability of a misfit at least as large if no effect is missing
    evidence: float  # E after this push
    alarm: bool  # whether the alarm is on after this push
    error: float  # distance of the cells from the hypotheses' central pose (ADD), m
    allowed: float  # largest error in this direction that would not surprise, m
    surprising: bool  # whether it ended outside the 95 % region, see `Prediction.surprising`
    effects: tuple[str, ...] = ()  # of the model at that time
    moved: float = np.nan  # how far the push moved the cells (ADD), m
    outside: bool = False  # whether it ended outside the region of level 1 - LEVEL

    @property
    def criterion(self) -> str:
        """By which criterion the alarm is on after this push, in words; empty where it is off."""
        if not self.alarm:
            return ""
        met = [f"outside its {100 * (1.0 - LEVEL):.0f} % region"] if self.outside else []
        if self.evidence >= 1.0 / LEVEL:
            met.append(f"evidence {self.evidence:.3g}, at least {1.0 / LEVEL:.0f}")
        return ", ".join(met) or "evidence still above 1"

    @property
    def cause(self) -> str:
        """The criterion together with the error; empty where the alarm is off."""
        numbers = f"ended {1e3 * self.error:.1f} mm off, {1e3 * self.allowed:.1f} mm allowed"
        return f"{numbers}; {self.criterion}" if self.alarm else ""


@dataclass(frozen=True, eq=False)
class Watch:
    """The monitor's observations and judgements so far."""

    trials: int  # trials examined
    residual: FloatArray  # (3,) when the object was last seen while there were hypotheses
    judged: tuple[Judged, ...] = ()  # pushes that a belief had predicted, in order

    @property
    def misfit(self) -> float:
        """Misfit of the last push judged; NaN before any."""
        return self.judged[-1].misfit if self.judged else np.nan

    @property
    def evidence(self) -> float:
        """E; 1 before any push."""
        return self.judged[-1].evidence if self.judged else 1.0

    @property
    def alarm(self) -> bool:
        """Whether the alarm is on."""
        return bool(self.judged) and self.judged[-1].alarm

    def to_json(self) -> dict[str, Any]:
        """The alarm, the evidence, and each judged push."""
        pushes = [asdict(push) for push in self.judged]
        return {"alarm": self.alarm, "evidence": self.evidence, "pushes": pushes}

    def up_to(self, trials: int) -> Watch:
        """What it was when so many trials had been recorded."""
        judged = tuple(push for push in self.judged if push.trial < trials)
        return replace(self, trials=min(self.trials, trials), judged=judged)

    def to_run(self) -> dict[str, Any]:
        """As plain data from which another process can continue."""
        return {"trials": self.trials, **self.to_json()}

    @classmethod
    def of_run(cls, stored: dict[str, Any]) -> Watch:
        """Restore what `to_run` stored.

        Raises:
            KeyError, TypeError: the data is not a stored `Watch`.
        """
        pushes = tuple(Judged(**{**push, "effects": tuple(push["effects"])}) for push in stored["pushes"])
        return cls(int(stored["trials"]), np.full(3, np.nan), pushes)


class ModelMonitor(PythonSystem):
    """Compares the predicted pose with the observed one.

    Inputs:
        universes: abstract, `Universes` of a `MultiverseSlider` with the same finger and trials, or None.
        object_pose: abstract, `ObservedPose`.
        trials: abstract, tuple of recorded `Trial`s, which start and end with the object at rest.

    Outputs:
        residual: (3,) observed minus predicted pose (m, m, rad) when the object was last seen; NaN before.
        misfit: (1,) of the last push judged (`slipmap.models.inference.push_misfit`); NaN before.
        evidence: (1,) E of `slipmap.models.inference.push_misfit`.
        alarm: abstract bool. It is raised when the evidence reaches 1/LEVEL, and cleared only when the
            evidence is back at 1, that is, when pushes have been predicted as well as usual for a while. A
            push that ends outside the region of level 1 - LEVEL (`push_misfit.resting_region`) raises it at
            once, whatever the evidence. When the model's effects change, the evidence starts again.
        watch: abstract, `Watch`, all of these together.

    A push is judged when its recording is complete: by the pose at which the object came to rest (the arm may
    hide it on the way), and by the mean force of the finger if that was recorded and the push was not a tap.
    The belief that held when the push began predicts both from the recording, as `predict` does. Where the
    hypotheses in motion ended does not count: they are pushed by the finger as they learn of it, which may
    be late. Pushes that no belief predicted do not count, nor does one whose hypotheses are gone because two
    others have begun since (`Universes.of_trial`). An angle that cannot be seen (`angle_held`) is not judged.

    Args:
        sensors: noise of the recorded poses; position and angle are used.
        period: of updates, s.
        model_error: α, the model's usual error as a share of the path.
        before: state left by an earlier process.

    Raises:
        ValueError: the noise of position or angle is not given, the period is not positive, or the
            model's error is negative.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(fit=1, heldout=0)
        >>> monitor = slipmap.ModelMonitor(dataset.noise)
        >>> [monitor.get_output_port(i).get_name() for i in range(monitor.num_output_ports())]
        ['residual', 'misfit', 'evidence', 'alarm', 'watch']
    """

    def __init__(
        self,
        sensors: Noise,
        period: float = 0.05,
        model_error: float = MODEL_ERROR,
        before: Watch | None = None,
    ) -> None:
        super().__init__()
        check_positive("ModelMonitor: period", period, "s")
        check_not_negative("ModelMonitor: model_error", model_error, "of the path")
        if sensors.position is None or sensors.angle is None:
            raise ValueError(f"ModelMonitor: noise of position and angle must be given, got {sensors}")
        self._error, self._error_held = (
            ErrorModel(push_misfit.pose_noise(sensors.position, angle), model_error, FORCE_ERROR)
            for angle in (sensors.angle, UNSEEN_ANGLE)
        )
        self.declare_inputs("universes", "object_pose", "trials", trials=Sequence)
        self._watch = self.DeclareAbstractState(held(before or Watch(0, np.full(3, np.nan))))
        after = {self.abstract_state_ticket(self._watch)}
        self.declare_vector_output("residual", 3, lambda context: self.watch(context).residual, after)
        self.declare_vector_output("misfit", 1, lambda context: [self.watch(context).misfit], after)
        self.declare_vector_output("evidence", 1, lambda context: [self.watch(context).evidence], after)
        self.declare_output("alarm", lambda context: self.watch(context).alarm, after, Value[bool](False))
        self.declare_output_of("watch", self._watch)
        self.declare_steps(period, self._watch, self._look)

    def watch(self, context: Context) -> Watch:
        """The observations and judgements so far."""
        return read(context, self._watch)

    def latest(self, context: Context) -> Watch:
        """The watch that the next update will leave if a trial was recorded since the last one, else the
        present one. So a trial can be stored together with its judgement, before anything learns from it."""
        watch = self.watch(context)
        return self._look(context, watch) if len(self.input(context, "trials")) > watch.trials else watch

    def _look(self, context: Context, watch: Watch) -> Watch:
        universes, seen = self.input(context, "universes"), self.input(context, "object_pose")
        trials = self.input(context, "trials")
        if universes is not None and seen is not None and seen.valid:
            watch = replace(watch, residual=seen.pose - universes.mean_pose)
        for number in range(watch.trials, len(trials)):
            watch = replace(watch, trials=number + 1)
            pushed = None if universes is None else universes.of_trial(number)
            if pushed is not None:
                judged = self._judged(number, trials[number], pushed.belief, watch)
                watch = replace(watch, judged=(*watch.judged, judged))
        return watch

    def _judged(self, number: int, trial: Trial, belief: Belief, watch: Watch) -> Judged:
        held = angle_held(trial)
        error = self._error_held if held else self._error
        observation = observe(trial, number, reach=belief.grid.reach)
        (motion,) = predicted_motion(belief, [observation])
        start, seen, ends = observation.push.start_pose, observation.poses[-1], motion.poses[:, -1]
        force = push_misfit.steady_force(observation)
        misfit, p = push_misfit.resting_misfit(
            start, seen, ends, belief.probability, error, belief.grid,
            None if force is None else (force, push_misfit.steady_forces(motion, observation)),
            taught=belief.taught,
        )  # fmt: skip
        effects = tuple(effect.name for effect in belief.slider.effects)
        same = not watch.judged or watch.judged[-1].effects == effects
        before = max(watch.evidence, 1.0) if same else 1.0
        evidence = before * push_misfit.bet(max(p, LEAST_P))
        region = push_misfit.resting_region(observation, ends, belief, error, self._error.noise)
        seen = turned_to(seen, region.middle[2])
        if held:  # its rotation is unknown
            seen[2] = region.middle[2]
        off = float(add(seen, motion.middle_poses[-1], belief.grid.centers))
        excess = region.excess(seen)
        by_evidence = evidence >= 1.0 / LEVEL or (same and watch.alarm and evidence > 1.0)
        outside = not region.holds(seen, 1.0 - LEVEL)
        # Either suffices. Evidence adds up small errors that recur, but takes three pushes, however far off
        # one of them ends; the region finds at once a model that is far off, but no error that stays within.
        alarm = by_evidence or outside
        return Judged(
            number, misfit, p, evidence, alarm, off, off / max(excess, 1e-9), not region.holds(seen), effects,
            float(add(start, observation.poses[-1], belief.grid.centers)), outside,
        )  # fmt: skip
