"""`ModelMonitor`: is the object still doing what the model says? Residual, misfit, and an alarm."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import Context
from scipy.special import chdtrc

from slipmap.diagrams.systems.multiverse_slider import Universes
from slipmap.diagrams.systems.python_system import PythonSystem, held, read
from slipmap.models.geometry import turned_to
from slipmap.models.inference import push_misfit
from slipmap.models.inference.error_model import ErrorModel
from slipmap.models.inference.observations import observe
from slipmap.models.inference.summaries import middle_poses
from slipmap.models.measurements import Trial
from slipmap.models.measurements.push_dataset import Noise
from slipmap.models.perception.seen_object import UNSEEN_ANGLE, angle_held
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.paper_notation import add

LEVEL = 0.01
"""At least 1/LEVEL pushes pass on average before a false alarm by evidence; of a right model so few end
outside the region that gives one at once."""

LEAST_P = 0.005
"""As evidence one push is not believed to be rarer, so that it takes three such pushes."""

MODEL_ERROR = 0.03
"""α, by which share of the way the model is off anyway; regions have what was learnt of that, if it was."""

FORCE_ERROR = 0.1
"""β, the same for the mean force of a push: in the simulated station without any hidden effect it was 2 to 5
% off, on a table tilted by 12° 30 to 80 %."""


@dataclass(frozen=True)
class Judged:
    """One push that was predicted and seen."""

    trial: int  # number of the push in the recording, from 0
    misfit: float  # see `slipmap.models.inference.push_misfit`
    p: float  # probability of a misfit as large if nothing is missing
    evidence: float  # E after this push
    alarm: bool  # whether it is given after this push
    error: float  # distance of the cells from the middle of the hypotheses (ADD), m
    allowed: float  # error in this direction up to which the push would not surprise, m
    surprising: bool  # whether it ended outside the 95 % region, see `Prediction.surprising`
    effects: tuple[str, ...] = ()  # that the model had
    moved: float = np.nan  # by how much the push moved the cells (ADD), m


@dataclass(frozen=True, eq=False)
class Watch:
    """What the monitor has seen."""

    trials: int  # trials looked at
    residual: FloatArray  # (3,) when the object was last seen beside the hypotheses
    judged: tuple[Judged, ...] = ()  # pushes that a belief had predicted, in order

    @property
    def misfit(self) -> float:
        """Of the last push that was judged; NaN before."""
        return self.judged[-1].misfit if self.judged else np.nan

    @property
    def evidence(self) -> float:
        """E; 1 before any push."""
        return self.judged[-1].evidence if self.judged else 1.0

    @property
    def joint_p(self) -> float:
        """Fisher's p of all pushes together that were judged with the effects of now: how often, if nothing
        is missing, theirs are as small by chance; 1 before any."""
        same = [push for push in self.judged if push.effects == self.judged[-1].effects]
        return float(chdtrc(2 * len(same), -2.0 * sum(np.log(max(push.p, 1e-12)) for push in same)))

    @property
    def alarm(self) -> bool:
        """Whether it is given now."""
        return bool(self.judged) and self.judged[-1].alarm

    def to_json(self) -> dict[str, Any]:
        """The alarm, the evidence, and each push that was judged."""
        pushes = [asdict(push) for push in self.judged]
        return {"alarm": self.alarm, "evidence": self.evidence, "pushes": pushes}

    def to_run(self) -> dict[str, Any]:
        """As plain data, for another process to go on from."""
        return {"trials": self.trials, **self.to_json()}

    @classmethod
    def of_run(cls, stored: dict[str, Any]) -> Watch:
        """What `to_run` stored.

        Raises:
            KeyError, TypeError: data of something else.
        """
        pushes = tuple(Judged(**{**push, "effects": tuple(push["effects"])}) for push in stored["pushes"])
        return cls(int(stored["trials"]), np.full(3, np.nan), pushes)


class ModelMonitor(PythonSystem):
    """Holds the predicted pose against the observed one.

    Inputs:
        universes: abstract, `Universes` of a `MultiverseSlider`, moved by the same finger, or None.
        object_pose: abstract, `ObservedPose`.
        trials: abstract, tuple of recorded `Trial`s, which begin and end with the object at rest.

    Outputs:
        residual: (3,) observed minus predicted pose (m, m, rad) when the object was last seen; NaN before.
        misfit: (1,) of the last push that was judged (`slipmap.models.inference.push_misfit`); NaN before.
        evidence: (1,) E of `slipmap.models.inference.push_misfit`.
        alarm: abstract bool. It is given when the evidence reaches 1/LEVEL, and taken back only when the
            evidence is down at 1 again, that is when pushes have been predicted as well as usual for a while.
            A push that ends outside the region of level 1 - LEVEL (`push_misfit.resting_region`) gives it at
            once, whatever the evidence. A model that is given other effects begins without evidence.
        watch: abstract, `Watch`, all of it.

    A push is judged when its record is complete, by where the object came to rest (on its way, the arm may
    hide it), and by the mean force that the finger needed, where that is recorded and the push was no tap.
    Pushes that no belief predicted do not count. An angle that cannot be seen (`angle_held`) is not judged.

    Args:
        sensors: noise of the recorded poses; position and angle are used.
        period: of looking, s.
        model_error: α, by which share of the way the model is off anyway.
        before: what an earlier process saw.

    Raises:
        ValueError: the noise of position or angle is not given.

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
        self.set_name("model_monitor")
        if sensors.position is None or sensors.angle is None:
            raise ValueError(f"ModelMonitor: noise of position and angle must be given, got {sensors}")
        self._error, self._error_held = (
            ErrorModel(push_misfit.pose_noise(sensors.position, angle), model_error, FORCE_ERROR)
            for angle in (sensors.angle, UNSEEN_ANGLE)
        )
        self.declare_inputs("universes", "object_pose", "trials")
        self._watch = self.DeclareAbstractState(held(before or Watch(0, np.full(3, np.nan))))
        after = {self.abstract_state_ticket(self._watch)}
        self.declare_vector_output("residual", 3, lambda context: self.watch(context).residual, after)
        self.declare_vector_output("misfit", 1, lambda context: [self.watch(context).misfit], after)
        self.declare_vector_output("evidence", 1, lambda context: [self.watch(context).evidence], after)
        self.declare_output("alarm", lambda context: self.watch(context).alarm, after, Value[bool](False))
        self.declare_output_of("watch", self._watch)
        self.declare_steps(period, self._watch, self._look)

    def watch(self, context: Context) -> Watch:
        """What has been seen so far."""
        return read(context, self._watch)

    def _look(self, context: Context, watch: Watch) -> Watch:
        universes, seen = self.input(context, "universes"), self.input(context, "object_pose")
        trials = self.input(context, "trials")
        if universes is not None and seen is not None and seen.valid:
            watch = replace(watch, residual=seen.pose - universes.mean_pose)
        if len(trials) > watch.trials:
            watch = replace(watch, trials=len(trials))
            if universes is not None:
                judged = self._judged(len(trials) - 1, trials[-1], universes, watch)
                watch = replace(watch, judged=(*watch.judged, judged))
        return watch

    def _judged(self, number: int, trial: Trial, universes: Universes, watch: Watch) -> Judged:
        belief = universes.belief
        start, end = trial.object_pose.values[[0, -1]]
        held = angle_held(trial)
        error = self._error_held if held else self._error
        observation = observe(trial, number)
        force = push_misfit.steady_force(observation)
        misfit, p = push_misfit.resting_misfit(
            start, end, universes.poses, belief.probability, error, belief.grid,
            None if force is None else (force, push_misfit.predicted_steady_forces(belief, observation)),
            taught=belief.taught,
        )  # fmt: skip
        effects = tuple(effect.name for effect in belief.slider.effects)
        same = not watch.judged or watch.judged[-1].effects == effects
        before = max(watch.evidence, 1.0) if same else 1.0
        evidence = before * push_misfit.bet(max(p, LEAST_P))
        region = push_misfit.resting_region(start, universes.poses, belief, error)
        seen = turned_to(end, region.middle[2])
        if held:  # it turned as far as nobody knows
            seen[2] = region.middle[2]
        middle = middle_poses(universes.poses, belief.probability, belief.grid)
        off, excess = float(add(seen, middle, belief.grid.centers)), region.excess(seen)
        by_evidence = evidence >= 1.0 / LEVEL or (same and watch.alarm and evidence > 1.0)
        return Judged(
            number, misfit, p, evidence, by_evidence or not region.holds(seen, 1.0 - LEVEL),
            off, off / max(excess, 1e-9), not region.holds(seen), effects,
            float(add(start, end, belief.grid.centers)),
        )  # fmt: skip
