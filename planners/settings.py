"""Settings of planning: what exploring pushes, goals, and pushes to a goal are like.

A user tunes them in a scenario file. This module loads quickly, so that help texts can name what is in it.
"""

# Annotations stay objects: Drake's YAML reader looks at them.
from dataclasses import dataclass, field

from slipmap.models.settings import CheckedSettings, check_ranges, within

STRATEGIES = ("random", "most-different", "most-distinctive")
"""Of Algorithm 2, see `slipmap.planners.action_selection`."""

METHODS = ("probabilistic", "deterministic", "uniform", "true")
"""Of planning, see `slipmap.planners.pregrasp.planning_belief`: with all hypotheses; with one of them, drawn;
with every cell the same; with the truth."""


@dataclass
class GoalSettings(CheckedSettings):
    """Which poses at the edge are goals.

    Attributes:
        epsilon: largest probability that the object falls there (the paper's failure threshold).
        margin: a hypothesis counts as falling when its centre of mass is less than this inside the
            support, m; what a belief is too sure of belongs here.
        samples: poses that are tried.
        count: goals that are kept at most, the best ones.
        clearance: of the gripper from table and object until it closes, m.
        least_contact: shortest length over which the pins hold, m.
        tolerance: heights that differ by less count as one when the upper pin comes down, m.
        friction: least friction coefficient between pins and object.
        mass: what the object is taken to weigh where no mass is given, kg.
    """

    _section = "goals: "

    epsilon: float = within(0.1, 0.0, 0.5)
    margin: float = within(0.005, 0.0, 0.1)
    samples: int = within(2000, 1, 1_000_000)
    count: int = within(100, 1, 1_000_000)
    clearance: float = within(0.005, 0.001, 0.05)
    least_contact: float = within(0.015, 0.005, 0.1)
    tolerance: float = within(0.003, 0.0, 0.02)
    friction: float = within(0.2, 0.01, 2.0)
    mass: float = within(1.0, 0.001, 100.0)


@dataclass
class PokeSettings:
    """What pushes to learn from are like; a scenario file calls them pokes.

    Attributes:
        shortest, longest: way of the finger after first touch, m.
        slowest, fastest: speed of the finger, m/s.
        taps: share of the pushes that are taps: the finger touches the object gently, speeds up, and stops
            short, so that the object slides on by itself. Slow pushes alone leave the centre of mass open.
        tap_speed: of the finger in a tap, m/s.
        approach: way of the finger before first touch, m.
        cone: largest angle between direction and inward normal, deg.
        candidates: size of the set to choose from.
        region: the object's middle is kept within so far of `center`, m.
        center: x and y of the region, world, m.
    """

    shortest: float = 0.04
    longest: float = 0.08
    slowest: float = 0.04
    fastest: float = 0.08
    taps: float = within(0.8, 0.0, 1.0)
    tap_speed: float = within(0.3, 0.05, 2.0)
    approach: float = within(0.015, 1e-3, 0.1)
    cone: float = within(25.0, 0.0, 80.0)
    candidates: int = within(60, 1, 10_000)
    region: float = within(0.1, 0.01, 1.0)
    center: list[float] = field(default_factory=lambda: [0.0, 0.0])

    def is_tap(self, number: int) -> bool:
        """Whether a push, counted from 0, is a tap; taps are spread evenly, a slow push comes first."""
        return int((number + 1) * self.taps + 1e-9) > int(number * self.taps + 1e-9)

    def check(self) -> None:
        """Raise ValueError, naming the field, where a number makes no sense."""
        for low, high in (("shortest", "longest"), ("slowest", "fastest")):
            if not 0 < getattr(self, low) <= getattr(self, high) < 10.0:
                raise ValueError(
                    f"pokes: {low} and {high} must be positive, in this order and below 10, got"
                    f" {getattr(self, low)} and {getattr(self, high)}"
                )
        check_ranges(self, "pokes: ")
        if len(self.center) != 2 or not all(abs(value) < 10.0 for value in self.center):
            raise ValueError(f"pokes: center must be x and y in m, got {self.center}")


@dataclass
class PushSettings(CheckedSettings):
    """How a push towards a goal is chosen (Algorithm 3).

    Attributes:
        candidates: lines along which a push is imagined at first, each with all its lengths.
        refinements: lines imagined next, near the best of these.
        cone: largest angle between a push and the inward normal, deg.
        longest: way of the finger after first touch, m.
        lengths: of pushes that are compared, evenly spread up to `longest`.
        approach: way of the finger before first touch, m.
        speed: of the finger, m/s.
        scenarios: least number of hypotheses; fewer are imagined several times, each with another noise.
        position_noise: one standard deviation of where the finger really goes, m.
        angle_noise: the same of the push's direction, deg.
        tolerance: distance from the goal, as seen, that is near enough, m. The paper has 20 mm; perception
            takes its share of that.
        tolerance_angle: angle from the goal that is near enough, deg; the paper has 15.
        margin: distance of the centre of mass from the edge of its support below which an object counts as
            falling, m.
        fall_cost: pushes that are as bad as a fall.
    """

    _section = "push."

    candidates: int = within(64, 4, 10_000)
    refinements: int = within(32, 0, 10_000)
    cone: float = within(25.0, 0.0, 80.0)
    longest: float = within(0.28, 0.01, 1.0)
    lengths: int = within(28, 2, 500)
    approach: float = within(0.02, 1e-3, 0.1)
    speed: float = within(0.08, 1e-3, 1.0)
    scenarios: int = within(20, 1, 1000)
    position_noise: float = within(0.002, 0.0, 0.05)
    angle_noise: float = within(1.0, 0.0, 20.0)
    tolerance: float = within(0.018, 1e-3, 0.5)
    tolerance_angle: float = within(13.5, 0.1, 180.0)
    margin: float = within(0.005, 0.0, 0.1)
    fall_cost: float = within(30.0, 0.0, 1e6)


@dataclass
class PregraspSettings:
    """The whole procedure (Algorithm 4).

    Attributes:
        explorations: pushes to learn from.
        strategy: how these are chosen, one of `slipmap.planners.settings.STRATEGIES`.
        hypotheses: K of the belief.
        poke: what the pushes to learn from are like.
        goals: what goals at the table's edge must be like.
        push: how pushes towards the goal are chosen.
        pushes: most pushes towards a goal.
        patience: most pushes towards one and the same goal; then it is left out.
        refusals: most pushes that the robot may refuse in a row.
    """

    explorations: int = within(5, 1, 1000)
    strategy: str = "most-distinctive"
    hypotheses: int = within(20, 2, 10_000)
    poke: PokeSettings = field(default_factory=PokeSettings)
    goals: GoalSettings = field(default_factory=GoalSettings)
    push: PushSettings = field(default_factory=PushSettings)
    pushes: int = within(20, 1, 1000)
    patience: int = within(6, 1, 1000)
    refusals: int = within(10, 1, 1000)

    def check(self) -> None:
        """Raise ValueError, naming the field, where a number makes no sense."""
        check_ranges(self, "pregrasp.")
        if self.strategy not in STRATEGIES:
            raise ValueError(
                f"pregrasp.strategy must be one of {', '.join(STRATEGIES)}, got {self.strategy!r}"
            )
        self.poke.check()
        self.goals.check()
        self.push.check()
