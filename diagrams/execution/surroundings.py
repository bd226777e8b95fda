"""What the arm keeps away from while it pushes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diagrams.execution.clearance import ArmClearance, Obstacle
from diagrams.execution.motion import MotionRefused, Plan
from planners.table_push import TablePush

APART = 0.005
"""Distance that the arm keeps from table and object, but for the finger while it is low, m."""

_EVERY = 0.08  # s between the postures that are looked at


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Table, the arm's own stand and base, and the object.

    Attributes:
        clearance: of the arm at its table.
        obstacle: the object where it lies before the push; None if there is none.
    """

    clearance: ArmClearance
    obstacle: Obstacle | None = None

    def check(self, plan: Plan, push: TablePush) -> None:
        """Refuse a push during which the arm comes too near to something.

        While it is pushed the object is taken to lie where it lay, and as far from there as the finger came.

        Raises:
            MotionRefused: how near, and when.
        """
        pushing = [phase.mode for phase in plan.phases].index("pushing")
        for number, phase in enumerate(plan.phases):
            times = np.linspace(0.0, phase.duration, max(int(np.ceil(phase.duration / _EVERY)), 4) + 1)
            share = times / phase.duration if number == pushing else np.full_like(times, number > pushing)
            distance = self.clearance.of_pushing(
                phase.trajectory.vector_values(times).T,
                self.obstacle,
                np.outer(share, push.end - push.begin),
                low=0 < number < len(plan.phases) - 1,
            )
            if distance < APART:
                raise MotionRefused(
                    f"while {phase.mode} the arm would come as near as {1e3 * distance:.0f} mm to the object,"
                    f" the table or itself, of which {1e3 * APART:.0f} mm are kept"
                )
