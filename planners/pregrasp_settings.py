"""What planning pushes, and the whole pre-grasp procedure, are like; a user tunes them in a scenario file."""

# Annotations stay objects: Drake's YAML reader looks at them.
from dataclasses import dataclass, field

from planners.goal_settings import GoalSettings
from planners.poke_settings import PokeSettings
from planners.strategies import STRATEGIES


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
        for name, least, largest in (
            ("candidates", 4, 10_000),
            ("refinements", 0, 10_000),
            ("cone", 0.0, 80.0),
            ("longest", 0.01, 1.0),
            ("lengths", 2, 500),
            ("approach", 1e-3, 0.1),
            ("speed", 1e-3, 1.0),
            ("scenarios", 1, 1000),
            ("position_noise", 0.0, 0.05),
            ("angle_noise", 0.0, 20.0),
            ("tolerance", 1e-3, 0.5),
            ("tolerance_angle", 0.1, 180.0),
            ("margin", 0.0, 0.1),
            ("fall_cost", 0.0, 1e6),
        ):
            if not least <= getattr(self, name) <= largest:
                raise ValueError(
                    f"push.{name} must lie between {least} and {largest}, got {getattr(self, name)}"
                )


@dataclass
class PregraspSettings:
    """The whole procedure (Algorithm 4).

    Attributes:
        explorations: pushes to learn from.
        strategy: how these are chosen, one of `planners.strategies.STRATEGIES`.
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
        for name, least, largest in (
            ("explorations", 1, 1000),
            ("hypotheses", 2, 10_000),
            ("pushes", 1, 1000),
            ("patience", 1, 1000),
            ("refusals", 1, 1000),
        ):
            if not least <= getattr(self, name) <= largest:
                raise ValueError(
                    f"pregrasp.{name} must lie between {least} and {largest}, got {getattr(self, name)}"
                )
        if self.strategy not in STRATEGIES:
            raise ValueError(
                f"pregrasp.strategy must be one of {', '.join(STRATEGIES)}, got {self.strategy!r}"
            )
        self.poke.check()
        self.goals.check()
        self.push.check()
