"""Identification as a block: recorded pushes in, belief out."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import partial

from pydrake.systems.framework import Context, EventStatus, State

from slipmap.diagrams.systems.python_system import PythonSystem, held, read, replace_held
from slipmap.diagrams.systems.workers import begun
from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.identification import check_draws, check_method, identify
from slipmap.models.inference.results import Identification as Learned
from slipmap.models.measurements.push_dataset import MakeDataset, Noise, Table, dataset_of
from slipmap.models.measurements.trial import in_order
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.robots import FINGER_RADIUS
from slipmap.models.settings import check_finger_radius, check_kind, check_positive

PERIOD = 0.05

_NO_NOISE = Noise()


class Identification(PythonSystem):
    """Relearns the maps after each push to learn from.

    Inputs:
    - `trials`: abstract, tuple of `Trial`: recorded pushes, oldest first, for example from a `TrialLogger` or
      a `MeasurementLogger`. Those with the role `fit` are learned from.
    - `cell_grid`: abstract, `CellGrid`: the object's cells and outline in its own frame, m; if not connected,
      the argument `grid`.
    - `effects`: abstract, tuple of the names of library effects that the model has now; if not connected, the
      argument. When they change, everything is learned again.
    - `rival`: abstract, name of an effect that may be there instead of the last of these; none if empty or
      not connected.
    Outputs:
    - `belief`: abstract, `Belief`, or None before the first push.
    - `learned`: abstract, int: number of pushes that it was learned from; 0 while its effects are outdated.

    Without a worker, the simulation waits for the computation, which takes no time on the diagram's clock.
    With one, the diagram keeps running and the same belief arrives later.

    Args:
        make_dataset: combines trials and grid into a dataset with everything known about the setup. If None,
            the next six arguments describe the setup.
        grid: the object, if `cell_grid` is not connected.
        finger_radius: m; by default that of the robot's own finger.
        mass: of the object, kg, if it was weighed.
        table: the table top; unknown if None.
        gravity: m/s².
        noise: of the sensors; estimated from the rows if not given.
        method: of `identify`.
        effects: of the library, given to the model; they require the default `method`.
        friction_laws: as for `identify`, whether to weigh other laws of friction too, so that a belief may
            have their effects beside those given. Without them learning takes less time, which the robot's
            own loops need: they learn after each push.
        hypotheses: K.
        seed: of every draw.
        learned: called with each new belief and its number of pushes, for progress.
        worker: runs the computation; this process if None.

    Raises:
        EffectError: an unknown effect.
        TypeError, ValueError: an unknown method, effects with one that does not support them, too few
            hypotheses, or an argument that cannot be what it is to be.

    Example:
        >>> import slipmap
        >>> grid, _ = slipmap.hammer()
        >>> learner = slipmap.Identification(grid=grid, finger_radius=0.008, hypotheses=6)
        >>> [learner.get_output_port(i).get_name() for i in range(learner.num_output_ports())]
        ['belief', 'learned']
    """

    def __init__(
        self,
        make_dataset: MakeDataset | None = None,
        *,
        grid: CellGrid | None = None,
        finger_radius: float = FINGER_RADIUS,
        mass: float | None = None,
        table: Table | None = None,
        gravity: float = 9.81,
        noise: Noise = _NO_NOISE,
        method: str = "gauss-newton",
        effects: Sequence[str] = (),
        friction_laws: bool = True,
        hypotheses: int = 20,
        seed: int = 0,
        learned: Callable[[Belief, int], None] | None = None,
        worker: Executor | None = None,
    ) -> None:
        super().__init__()
        if make_dataset is not None and not callable(make_dataset):
            raise TypeError(
                "Identification: make_dataset must be a function of trials and cells that returns a"
                f" PushDataset, got a {type(make_dataset).__name__}; slipmap.identify learns from a dataset"
            )
        self._make_dataset = make_dataset or partial(
            dataset_of,
            name="recorded",
            finger_radius=finger_radius,
            mass=mass,
            table=table,
            gravity=gravity,
            noise=noise,
        )
        self._grid = grid
        if grid is not None:
            check_kind("Identification: grid", grid, CellGrid, "such as slipmap.cells_from_polygon makes")
        check_finger_radius("Identification: finger_radius", finger_radius)
        check_positive("Identification: gravity", gravity, "m/s²")
        if mass is not None:
            check_positive("Identification: mass", mass, "kg")
        learning(effects, method)
        check_draws(hypotheses, seed)
        self._effects, self._method = tuple(effects), method
        self._options = {"friction_laws": friction_laws, "hypotheses": hypotheses, "seed": seed}
        self._learned = learned
        self._worker = worker
        self.declare_inputs("trials", "cell_grid", "effects", "rival", trials=Sequence, cell_grid=CellGrid)
        self._belief = self.DeclareAbstractState(held((None, 0, (self._effects, ""))))
        self._job = self.DeclareAbstractState(held(None))
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._learn)
        self.declare_output_of("belief", self._belief, lambda learned: learned[0])
        inputs = (self.GetInputPort(name).ticket() for name in ("effects", "rival"))
        self.declare_output("learned", self._count, {self.abstract_state_ticket(self._belief), *inputs})

    def _wanted(self, context: Context) -> tuple[tuple[str, ...], str]:
        """Effects of the model, and the rival of the last one."""
        given = self.optional_input(context, "effects")
        rival = self.optional_input(context, "rival") or ""
        return self._effects if given is None else given, rival

    def _count(self, context: Context) -> int:
        _, count, model = read(context, self._belief)
        return int(count) if model == self._wanted(context) else 0

    def _learn(self, context: Context, state: State) -> EventStatus:
        job, count, model = read(context, self._job) or (None, 0, ((), ""))
        if job is None:
            trials = [trial for trial in in_order(self.input(context, "trials")) if trial.role == "fit"]
            if len(trials) <= self._count(context) or not trials:
                return EventStatus.DidNothing()
            grid = self.optional_input(context, "cell_grid") or self._grid
            if grid is None:
                raise ValueError("Identification: connect the port cell_grid, or give the argument grid")
            count, model = len(trials), self._wanted(context)
            effects, rival = model
            learn = partial(learning(effects, self._method, rival), **self._options)
            job = begun(self._worker, learn, self._make_dataset(trials, grid))
        if not job.done():
            replace_held(state, self._job, (job, count, model))
            return EventStatus.Succeeded()
        belief = job.result().belief
        replace_held(state, self._job, None)
        replace_held(state, self._belief, (belief, count, model))
        if self._learned is not None:
            self._learned(belief, count)
        return EventStatus.Succeeded()


def learning(
    effects: Sequence[str] = (), method: str = "gauss-newton", rival: str = ""
) -> Callable[..., Learned]:
    """`identify` with effects of the library and a method; the other arguments remain to be given.

    If there is a rival, it may be there instead of the last effect.

    Only Coulomb's law of friction is tried, as in the robot's own loops, unless they include
    `friction_laws=True`.

    Raises:
        EffectError: an unknown effect.
        ValueError: an unknown method, or effects with one that does not support them.
    """
    check_method(method, effects)
    rivals = [effects_named([*effects[:-1], rival])] if rival else []
    return partial(
        identify, effects=effects_named(effects), method=method, friction_laws=False, rivals=rivals
    )
