"""Learning as a block: recorded pushes in, belief out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import partial

from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, State

from slipmap.diagrams.systems.python_system import PythonSystem, held, read, replace_held
from slipmap.diagrams.systems.workers import begun
from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.identification import identify
from slipmap.models.inference.results import Identification as Learned
from slipmap.models.measurements import PushDataset, Trial
from slipmap.models.physics.cell_grid import CellGrid

PERIOD = 0.05

MakeDataset = Callable[[Sequence[Trial], CellGrid], PushDataset]


class Identification(PythonSystem):
    """Learns maps anew after each push that is to be learned from.

    .. pydrake_system::

        name: Identification
        input_ports:
        - trials
        - cell_grid
        output_ports:
        - belief
        - learned

    - `trials`: tuple of `Trial`; `cell_grid`: `CellGrid | None`.
    - `belief`: `Belief | None`; `learned`: number of pushes that it comes from.

    Without a worker the simulation waits while it computes, and to the clock of the diagram it takes no time.
    With one, the diagram goes on, and the same belief comes later.

    Args:
        make_dataset: puts trials and grid together with what else is known of the cell.
        method: of `identify`.
        effects: of the library, which the model is given; then `method` does not count.
        hypotheses: K.
        seed: of every draw.
        learned: called with every belief as it forms, for progress.
        worker: who computes; this process if None.
    """

    def __init__(
        self,
        make_dataset: MakeDataset,
        *,
        method: str = "gauss-newton",
        effects: Sequence[str] = (),
        hypotheses: int = 20,
        seed: int = 0,
        learned: Callable[[Belief, int], None] | None = None,
        worker: Executor | None = None,
    ) -> None:
        super().__init__()
        self._make_dataset = make_dataset
        self._learn_from = learning(effects, method)
        self._hypotheses = hypotheses
        self._seed = seed
        self._learned = learned
        self._worker = worker
        self.DeclareAbstractInputPort("trials", Value[object](()))
        self.DeclareAbstractInputPort("cell_grid", Value[object](None))
        self._belief = self.DeclareAbstractState(held((None, 0)))
        self._job = self.DeclareAbstractState(held(None))
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._learn)
        for index, name in enumerate(("belief", "learned")):
            self.DeclareAbstractOutputPort(
                name,
                lambda: Value[object](None),
                lambda context, output, index=index: output.set_value(read(context, self._belief)[index]),
                {self.abstract_state_ticket(self._belief)},
            )

    def _learn(self, context: Context, state: State) -> EventStatus:
        job, count = read(context, self._job) or (None, 0)
        if job is None:
            recorded: tuple[Trial, ...] = self.GetInputPort("trials").Eval(context)
            trials = [trial for trial in recorded if trial.role == "fit"]
            if len(trials) <= read(context, self._belief)[1]:
                return EventStatus.DidNothing()
            dataset = self._make_dataset(trials, self.GetInputPort("cell_grid").Eval(context))
            count = len(trials)
            job = begun(
                self._worker, self._learn_from, dataset, hypotheses=self._hypotheses, seed=self._seed,
            )  # fmt: skip
        if not job.done():
            replace_held(state, self._job, (job, count))
            return EventStatus.Succeeded()
        belief = job.result().belief
        replace_held(state, self._job, None)
        replace_held(state, self._belief, (belief, count))
        if self._learned is not None:
            self._learned(belief, count)
        return EventStatus.Succeeded()


def learning(effects: Sequence[str] = (), method: str = "gauss-newton") -> Callable[..., Learned]:
    """`identify`, or `fit_effects` with effects of the library; arguments beside these are still to be given.

    Raises:
        EffectError: an unknown effect.
    """
    if not effects:
        return partial(identify, method=method)
    from slipmap.models.inference.diagnosis.effect_fit import fit_effects

    return partial(fit_effects, effects=effects_named(list(effects)))
