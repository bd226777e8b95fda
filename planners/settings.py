"""Settings of planning: what exploring pushes, goals, and pushes to a goal are like.

A user tunes them in a scenario file. This module loads quickly, so that help texts can name what is in it.
"""

# Annotations stay objects: Drake's YAML reader looks at them.
from dataclasses import dataclass, field

STRATEGIES = ("random", "most-different", "most-distinctive")
"""Of Algorithm 2, see `slipmap.planners.action_selection`."""

METHODS = ("probabilistic", "deterministic", "uniform", "true")
"""Of planning, see `slipmap.planners.pregrasp.planning_belief`: with all hypotheses; with one of them, drawn;
with every cell the same; with the truth."""


def check_ranges(settings: object, called: str, **ranges: tuple[float, float]) -> None:
    """Refuse settings with a field outside of its range, which is (least, largest).

    Args:
        settings: whose fields are checked.
        called: what stands before a field's name in the message.
        ranges: by the field's name.

    Raises:
        ValueError: names the field.
    """
    for name, (least, largest) in ranges.items():
        value = getattr(settings, name)
        if not least <= value <= largest:
            raise ValueError(f"{called}{name} must lie between {least} and {largest}, got {value}")


@dataclass
class GoalSettings:
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

    epsilon: float = 0.1
    margin: float = 0.005
    samples: int = 2000
    count: int = 100
    clearance: float = 0.005
    least_contact: float = 0.015
    tolerance: float = 0.003
    friction: float = 0.2
    mass: float = 1.0

    def check(self) -> None:
        """Raise ValueError, naming the field, where a number makes no sense."""
        check_ranges(
            self,
            "goals: ",
            epsilon=(0.0, 0.5),
            margin=(0.0, 0.1),
            samples=(1, 1_000_000),
            count=(1, 1_000_000),
            clearance=(0.001, 0.05),
            least_contact=(0.005, 0.1),
            tolerance=(0.0, 0.02),
            friction=(0.01, 2.0),
            mass=(0.001, 100.0),
        )


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
    taps: float = 0.8
    tap_speed: float = 0.3
    approach: float = 0.015
    cone: float = 25.0
    candidates: int = 60
    region: float = 0.1
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
        check_ranges(
            self,
            "pokes: ",
            taps=(0.0, 1.0),
            tap_speed=(0.05, 2.0),
            approach=(1e-3, 0.1),
            cone=(0.0, 80.0),
            candidates=(1, 10_000),
            region=(0.01, 1.0),
        )
        if len(self.center) != 2 or not all(abs(value) < 10.0 for value in self.center):
            raise ValueError(f"pokes: center must be x and y in m, got {self.center}")


@dataclass
class PushSettings:
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

    candidates: int = 64
    refinements: int = 32
    cone: float = 25.0
    longest: float = 0.28
    lengths: int = 28
    approach: float = 0.02
    speed: float = 0.08
    scenarios: int = 20
    position_noise: float = 0.002
    angle_noise: float = 1.0
    tolerance: float = 0.018
    tolerance_angle: float = 13.5
    margin: float = 0.005
    fall_cost: float = 30.0

    def check(self) -> None:
        """Raise ValueError, naming the field, where a number makes no sense."""
        check_ranges(
            self,
            "push.",
            candidates=(4, 10_000),
            refinements=(0, 10_000),
            cone=(0.0, 80.0),
            longest=(0.01, 1.0),
            lengths=(2, 500),
            approach=(1e-3, 0.1),
            speed=(1e-3, 1.0),
            scenarios=(1, 1000),
            position_noise=(0.0, 0.05),
            angle_noise=(0.0, 20.0),
            tolerance=(1e-3, 0.5),
            tolerance_angle=(0.1, 180.0),
            margin=(0.0, 0.1),
            fall_cost=(0.0, 1e6),
        )


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

    explorations: int = 5
    strategy: str = "most-distinctive"
    hypotheses: int = 20
    poke: PokeSettings = field(default_factory=PokeSettings)
    goals: GoalSettings = field(default_factory=GoalSettings)
    push: PushSettings = field(default_factory=PushSettings)
    pushes: int = 20
    patience: int = 6
    refusals: int = 10

    def check(self) -> None:
        """Raise ValueError, naming the field, where a number makes no sense."""
        check_ranges(
            self,
            "pregrasp.",
            explorations=(1, 1000),
            hypotheses=(2, 10_000),
            pushes=(1, 1000),
            patience=(1, 1000),
            refusals=(1, 1000),
        )
        if self.strategy not in STRATEGIES:
            raise ValueError(
                f"pregrasp.strategy must be one of {', '.join(STRATEGIES)}, got {self.strategy!r}"
            )
        self.poke.check()
        self.goals.check()
        self.push.check()
