"""Learning as a block: recorded pushes in, belief out."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from diagrams.systems.held import held, read, replace_held
from models.inference.belief import Belief
from models.inference.identification import identify
from models.measurements import PushDataset, Trial
from models.physics.cell_grid import CellGrid

PERIOD = 0.05

MakeDataset = Callable[[Sequence[Trial], CellGrid], PushDataset]


class Identification(LeafSystem):
    """Learns maps anew after each push that is to be learned from.

    .. pydrake_system::

        name: Identification
        input_ports:
        - records
        - cell_grid
        output_ports:
        - belief
        - learned

    - `records`: tuple of `Trial`; `cell_grid`: `CellGrid | None`.
    - `belief`: `Belief | None`; `learned`: number of pushes that it comes from.

    The simulation waits while it computes; to the clock of the diagram it takes no time.

    Args:
        make_dataset: puts trials and grid together with what else is known of the cell.
        method: of `identify`.
        hypotheses: K.
        seed: of every draw.
        learned: called with every belief as it forms, for progress.
    """

    def __init__(
        self,
        make_dataset: MakeDataset,
        *,
        method: str = "gauss-newton",
        hypotheses: int = 20,
        seed: int = 0,
        learned: Callable[[Belief, int], None] | None = None,
    ) -> None:
        super().__init__()
        self._make_dataset = make_dataset
        self._method = method
        self._hypotheses = hypotheses
        self._seed = seed
        self._learned = learned
        self.DeclareAbstractInputPort("records", Value[object](()))
        self.DeclareAbstractInputPort("cell_grid", Value[object](None))
        self._belief = self.DeclareAbstractState(held((None, 0)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._learn)
        for index, name in enumerate(("belief", "learned")):
            self.DeclareAbstractOutputPort(
                name,
                lambda: Value[object](None),
                lambda context, output, index=index: output.set_value(read(context, self._belief)[index]),
                {self.abstract_state_ticket(self._belief)},
            )

    def _learn(self, context: Context, state: State) -> EventStatus:
        records: tuple[Trial, ...] = self.GetInputPort("records").Eval(context)
        trials = [trial for trial in records if trial.role == "fit"]
        _, done = read(context, self._belief)
        if len(trials) <= done:
            return EventStatus.DidNothing()
        grid = self.GetInputPort("cell_grid").Eval(context)
        dataset = self._make_dataset(trials, grid)
        result = identify(dataset, method=self._method, hypotheses=self._hypotheses, seed=self._seed)
        replace_held(state, self._belief, (result.belief, len(trials)))
        if self._learned is not None:
            self._learned(result.belief, len(trials))
        return EventStatus.Succeeded()
