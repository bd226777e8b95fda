"""Algorithm 2 as a block: chooses the next push."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, EventStatus, State

from slipmap.diagrams.execution.clearance import Obstacle
from slipmap.diagrams.systems.loop_messages import CHOOSING, ExplorationPlan, LoopStatus
from slipmap.diagrams.systems.python_system import PythonSystem, held, read, replace_held
from slipmap.diagrams.systems.workers import begun
from slipmap.models.perception.seen_object import SeenObject
from slipmap.planners.action_selection import Choice, choose_push
from slipmap.planners.exploration import NoReachablePush
from slipmap.planners.settings import PokeSettings
from slipmap.planners.table_push import TablePush

PERIOD = 0.05


class Exploration(PythonSystem):
    """Chooses a push when the loop asks for one.

    Inputs:
    - `belief`: `Belief | None`; `object_pose`: `ObservedPose`; `seen_object`: `SeenObject | None`.
    - `status`: `LoopStatus`; in the mode `choosing` a plan of its number is made, and in `telling apart` one
      that best answers the question of `repair`, the `Repair` of a `Diagnosis`.
    Outputs:
    - `plan`: `ExplorationPlan | None`; it stands until the loop asks for another.

    The draws of a push depend on the seed and the push's number alone.

    Args:
        strategy: one of `slipmap.planners.settings.STRATEGIES`; pushes after the first `fit`, made to judge
            the belief, are random, and none of them is a tap.
        fit: pushes of the strategy.
        finger_radius: m.
        settings: what pushes to learn from are like.
        allowed: whether the arm can make a push of an object that lies somewhere.
        seed: of every draw.
        worker: who computes; this process if None, and then the simulation waits. It must be able to take
            `allowed` along.
        past: pushes that were made before.

    Example:
        >>> import slipmap
        >>> settings = slipmap.Scenario().pokes
        >>> block = slipmap.Exploration("random", 3, 0.008, settings, lambda obstacle, push: True, seed=0)
        >>> [block.get_output_port(i).get_name() for i in range(block.num_output_ports())]
        ['plan']
    """

    def __init__(
        self,
        strategy: str,
        fit: int,
        finger_radius: float,
        settings: PokeSettings,
        allowed: Callable[[Obstacle, TablePush], bool],
        seed: int,
        worker: Executor | None = None,
        past: Sequence[Choice] = (),
    ) -> None:
        super().__init__()
        self._strategy = strategy
        self._fit = fit
        self._finger_radius = finger_radius
        self._settings = settings
        self._allowed = allowed
        self._seed = seed
        self._worker = worker
        self.declare_inputs("belief", "object_pose", "seen_object", "status", "repair")
        self._plan = self.DeclareAbstractState(held(None))
        self._past = self.DeclareAbstractState(held(tuple(past)))
        self._job = self.DeclareAbstractState(held(None))
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._choose)
        self.declare_output_of("plan", self._plan)

    def _choose(self, context: Context, state: State) -> EventStatus:
        job, number, past = read(context, self._job) or (None, 0, ())
        if job is None:
            status: LoopStatus = self.input(context, "status")
            plan: ExplorationPlan | None = read(context, self._plan)
            pose = self.input(context, "object_pose")
            asked = status.mode in CHOOSING and (plan is None or plan.number != status.number)
            if not asked or not pose.valid:
                return EventStatus.DidNothing()
            number, past = status.number, read(context, self._past)
            if status.attempt > 0:
                past = past[:-1]  # the arm refused it
            strategy = self._strategy if status.push < self._fit else "random"
            question = None
            if status.mode == "telling apart":
                question = self.input(context, "repair").question
            seen: SeenObject = self.input(context, "seen_object")
            job = begun(
                self._worker,
                _selected,
                seen.grid,
                pose.pose,
                self._finger_radius,
                strategy=strategy,
                belief=self.input(context, "belief"),
                past=past,
                settings=self._settings,
                tap=self._settings.is_tap(status.push) and status.push < self._fit,
                question=question,
                allowed=partial(self._allowed, Obstacle(seen.grid, seen.cell_heights, pose.pose)),
                rng=np.random.default_rng([self._seed, status.push, status.attempt]),
            )
        if not job.done():
            replace_held(state, self._job, (job, number, past))
            return EventStatus.Succeeded()
        choice, reason = job.result()
        replace_held(state, self._job, None)
        replace_held(state, self._plan, ExplorationPlan(number, choice, reason))
        if choice is not None:
            replace_held(state, self._past, (*past, choice))
        return EventStatus.Succeeded()


def _selected(*args: Any, **kwargs: Any) -> tuple[Choice | None, str]:
    """As `choose_push`, or why there is none."""
    try:
        return choose_push(*args, **kwargs), ""
    except NoReachablePush as error:
        return None, str(error)
