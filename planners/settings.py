"""Settings of planning: pushes to learn from, goals, and pushes towards a goal.

Users tune them in a scenario file. This module imports quickly, so that help texts can quote from it.
"""

# Annotations stay objects, because Drake's YAML reader inspects them.
from dataclasses import dataclass, field

from slipmap.models.settings import CheckedSettings, check_choice, check_ranges, within

STRATEGIES = ("random", "most-different", "most-distinctive")
"""Strategies of Algorithm 2, see `slipmap.planners.action_selection`."""

METHODS = ("probabilistic", "deterministic", "uniform", "true")
"""Methods of planning, see `slipmap.planners.pregrasp.planning_belief`: with all hypotheses; with one drawn
at random; with a uniform object; with the truth."""

NEGLIGIBLE = 1e-4
"""Probability below which a hypothesis is not simulated."""


@dataclass
class RepairSettings(CheckedSettings):
    """How a robot diagnoses pushes that surprise its model."""

    _section = "repair: "

    pushes: int = within(10, 0, 100)  # most pushes that it may ask for in addition to those of exploration
    # the monitor's evidence at which pushes are diagnosed; an alarm takes 100
    doubt: float = within(10.0, 1.0, 100.0)
    every: int = within(5, 1, 100)  # pushes after which they are diagnosed again even without a surprise
    # p of the largest gain up to which an undecided diagnosis is worth another push
    chance: float = within(0.5, 0.0, 1.0)
    fewest: int = within(5, 5, 100)  # fewest pushes that are worth a diagnosis
    # pushes that test an effect just adopted; if they surprise, it is diagnosed again
    probation: int = within(2, 1, 100)


@dataclass
class GoalSettings(CheckedSettings):
    """Requirements on goals at the table's edge."""

    _section = "goals: "

    # largest probability that the object falls there (the paper's failure threshold)
    epsilon: float = within(0.1, 0.0, 0.5)
    # a hypothesis counts as falling when its centre of mass is less than this inside the support, m; allow
    # here for an overconfident belief
    margin: float = within(0.005, 0.0, 0.1)
    samples: int = within(2000, 1, 1_000_000)  # poses to try
    count: int = within(100, 1, 1_000_000)  # most goals to keep, the best ones
    clearance: float = within(0.005, 0.001, 0.05)  # of the gripper from table and object until it closes, m
    least_contact: float = within(0.015, 0.005, 0.1)  # shortest length over which the pins hold, m
    # heights that differ by less count as equal when the upper pin comes down, m
    tolerance: float = within(0.003, 0.0, 0.02)
    friction: float = within(0.2, 0.01, 2.0)  # lowest friction coefficient between pins and object
    mass: float = within(1.0, 0.001, 100.0)  # assumed mass of the object if none is given, kg


@dataclass
class PokeSettings:
    """Pushes to learn from; a scenario file calls them pokes."""

    # shortest, longest: distance that the finger travels after first touch, m
    shortest: float = 0.04
    longest: float = 0.08
    # slowest, fastest: speed of the finger, m/s
    slowest: float = 0.04
    fastest: float = 0.08
    # share of the pushes that are taps: the finger touches the object gently, speeds up, and stops short, so
    # that the object slides on by itself. Slow pushes alone do not determine the centre of mass.
    taps: float = within(0.8, 0.0, 1.0)
    tap_speed: float = within(0.3, 0.05, 2.0)  # of the finger in a tap, m/s
    approach: float = within(0.015, 1e-3, 0.1)  # distance that the finger travels before first touch, m
    cone: float = within(25.0, 0.0, 80.0)  # largest angle between direction and inward normal, deg
    candidates: int = within(60, 1, 10_000)  # size of the set to choose from
    region: float = within(0.1, 0.01, 1.0)  # largest distance of the object's centroid from `center`, m
    center: list[float] = field(default_factory=lambda: [0.0, 0.0])  # x and y of the region, world, m

    def is_tap(self, number: int) -> bool:
        """Whether push `number`, from 0, is a tap; taps are spread evenly after a slow first push."""
        return int((number + 1) * self.taps + 1e-9) > int(number * self.taps + 1e-9)

    def check(self) -> None:
        """Raise ValueError, naming the field, for an invalid number."""
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
    """How a push towards a goal is chosen (Algorithm 3)."""

    _section = "pushes: "

    # lines along which pushes are simulated first, each with all its lengths
    candidates: int = within(64, 4, 10_000)
    refinements: int = within(32, 0, 10_000)  # lines simulated next, near the best of these
    cone: float = within(25.0, 0.0, 80.0)  # largest angle between a push and the inward normal, deg
    longest: float = within(0.28, 0.01, 1.0)  # longest distance that the finger travels after first touch, m
    lengths: int = within(28, 2, 500)  # number of lengths to compare, evenly spread up to `longest`
    approach: float = within(0.02, 1e-3, 0.1)  # distance that the finger travels before first touch, m
    speed: float = within(0.08, 1e-3, 1.0)  # of the finger, m/s
    # smallest number of scenarios; fewer hypotheses are simulated several times with different noise
    scenarios: int = within(20, 1, 1000)
    # standard deviation of the finger's position, m
    position_noise: float = within(0.002, 0.0, 0.05)
    angle_noise: float = within(1.0, 0.0, 20.0)  # standard deviation of the push's direction, deg
    # distance from the goal, as seen, that is near enough, m; the paper has 20 mm, less an allowance for
    # perception
    tolerance: float = within(0.018, 1e-3, 0.5)
    # angle from the goal that is near enough, deg; the paper has 15
    tolerance_angle: float = within(13.5, 0.1, 180.0)
    # distance of the centre of mass from the edge of its support below which an object counts as falling, m
    margin: float = within(0.005, 0.0, 0.1)
    fall_cost: float = within(30.0, 0.0, 1e6)  # number of pushes that is as bad as a fall


@dataclass
class PregraspSettings:
    """The whole procedure (Algorithm 4)."""

    explorations: int = within(5, 1, 1000)  # pushes to learn from
    strategy: str = "most-distinctive"  # how these are chosen, one of `slipmap.planners.settings.STRATEGIES`
    hypotheses: int = within(20, 2, 10_000)  # K of the belief
    poke: PokeSettings = field(default_factory=PokeSettings)  # the pushes to learn from
    goals: GoalSettings = field(default_factory=GoalSettings)  # requirements on goals at the table's edge
    push: PushSettings = field(default_factory=PushSettings)  # how pushes towards the goal are chosen
    pushes: int = within(20, 1, 1000)  # most pushes in all towards goals
    patience: int = within(6, 1, 1000)  # most pushes towards any one goal before it is given up
    refusals: int = within(10, 1, 1000)  # most pushes that the robot may refuse in a row

    def check(self) -> None:
        """Raise ValueError, naming the field, for an invalid number."""
        check_ranges(self, "pregrasp.")
        check_choice("pregrasp.strategy", self.strategy, STRATEGIES)
        self.poke.check()
        self.goals.check()
        self.push.check()
