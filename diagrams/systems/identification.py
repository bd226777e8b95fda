"""Learning as a block: recorded pushes in, belief out."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import partial

from pydrake.systems.framework import Context, EventStatus, State

from slipmap.diagrams.systems.measurement_logger import dataset_of
from slipmap.diagrams.systems.python_system import PythonSystem, held, read, replace_held
from slipmap.diagrams.systems.workers import begun
from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.identification import identify
from slipmap.models.inference.results import Identification as Learned
from slipmap.models.measurements import PushDataset, Trial
from slipmap.models.measurements.push_dataset import Noise, Table
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.robots import FINGER_RADIUS

PERIOD = 0.05

_NO_NOISE = Noise()


class Identification(PythonSystem):
    """Learns maps anew after each push that is to be learned from.

    Inputs:
    - `trials`: abstract, tuple of `Trial`: recorded pushes, the oldest first, as of a `TrialLogger` or a
      `MeasurementLogger`. Those with the role `fit` are learned from.
    - `cell_grid`: abstract, `CellGrid`: the object's cells and outline in its own frame, m; the argument
      `grid` if not connected.
    - `effects`: abstract, tuple of names of effects of the library that the model is given now; the argument
      if not connected. Where they change, all is learnt anew.
    Outputs:
    - `belief`: abstract, `Belief`, or None before the first push.
    - `learned`: abstract, int: number of pushes that it comes from; 0 where its effects are not those wanted.

    Without a worker the simulation waits while it computes, and to the clock of the diagram it takes no time.
    With one, the diagram goes on, and the same belief comes later.

    Args:
        make_dataset: makes trials and grid a dataset with all that is known of the place. If None, that is
            what the next five arguments say.
        grid: the object, where `cell_grid` is not connected.
        finger_radius: m; that of the robot's own finger by default.
        table: the table's top; unknown if None.
        gravity: m/s².
        noise: of the sensors; estimated from the rows where it is not given.
        method: of `identify`.
        effects: of the library, which the model is given; then `method` must be the default.
        hypotheses: K.
        seed: of every draw.
        learned: called with every belief as it forms and its number of pushes, for progress.
        worker: who computes; this process if None.

    Raises:
        EffectError: an unknown effect.

    Example:
        >>> import slipmap
        >>> grid, _ = slipmap.hammer()
        >>> learner = slipmap.Identification(grid=grid, finger_radius=0.008, hypotheses=6)
        >>> [learner.get_output_port(i).get_name() for i in range(learner.num_output_ports())]
        ['belief', 'learned']
    """

    def __init__(
        self,
        make_dataset: Callable[[Sequence[Trial], CellGrid], PushDataset] | None = None,
        *,
        grid: CellGrid | None = None,
        finger_radius: float = FINGER_RADIUS,
        table: Table | None = None,
        gravity: float = 9.81,
        noise: Noise = _NO_NOISE,
        method: str = "gauss-newton",
        effects: Sequence[str] = (),
        hypotheses: int = 20,
        seed: int = 0,
        learned: Callable[[Belief, int], None] | None = None,
        worker: Executor | None = None,
    ) -> None:
        super().__init__()
        self._make_dataset = make_dataset or partial(
            dataset_of,
            name="recorded",
            finger_radius=finger_radius,
            table=table,
            gravity=gravity,
            noise=noise,
        )
        self._grid = grid
        learning(effects, method)
        self._effects, self._method = tuple(effects), method
        self._options = {"hypotheses": hypotheses, "seed": seed}
        self._learned = learned
        self._worker = worker
        self.declare_inputs("trials", "cell_grid", "effects")
        self._belief = self.DeclareAbstractState(held((None, 0, self._effects)))
        self._job = self.DeclareAbstractState(held(None))
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._learn)
        self.declare_output_of("belief", self._belief, lambda learned: learned[0])
        after = {self.abstract_state_ticket(self._belief), self.GetInputPort("effects").ticket()}
        self.declare_output("learned", self._count, after)

    def _wanted(self, context: Context) -> tuple[str, ...]:
        given = self.optional_input(context, "effects")
        return self._effects if given is None else given

    def _count(self, context: Context) -> int:
        _, count, effects = read(context, self._belief)
        return int(count) if effects == self._wanted(context) else 0

    def _learn(self, context: Context, state: State) -> EventStatus:
        job, count, effects = read(context, self._job) or (None, 0, ())
        if job is None:
            trials = [trial for trial in self.input(context, "trials") if trial.role == "fit"]
            if len(trials) <= self._count(context) or not trials:
                return EventStatus.DidNothing()
            grid = self.optional_input(context, "cell_grid") or self._grid
            if grid is None:
                raise ValueError("Identification: connect the port cell_grid, or give the argument grid")
            count, effects = len(trials), self._wanted(context)
            learn = partial(learning(effects, self._method), **self._options)
            job = begun(self._worker, learn, self._make_dataset(trials, grid))
        if not job.done():
            replace_held(state, self._job, (job, count, effects))
            return EventStatus.Succeeded()
        belief = job.result().belief
        replace_held(state, self._job, None)
        replace_held(state, self._belief, (belief, count, effects))
        if self._learned is not None:
            self._learned(belief, count)
        return EventStatus.Succeeded()


def learning(effects: Sequence[str] = (), method: str = "gauss-newton") -> Callable[..., Learned]:
    """`identify`, with effects of the library if any; arguments beside these are still to be given.

    Raises:
        EffectError: an unknown effect.
    """
    return partial(identify, effects=effects_named(list(effects)), method=method, friction_laws=False)
