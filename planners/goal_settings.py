"""What a goal at the table's edge must be like; a user tunes it in a scenario file."""

# Annotations stay objects: Drake's YAML reader looks at them.
from dataclasses import dataclass


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
        for name, least, largest in (
            ("epsilon", 0.0, 0.5),
            ("margin", 0.0, 0.1),
            ("samples", 1, 1_000_000),
            ("count", 1, 1_000_000),
            ("clearance", 0.001, 0.05),
            ("least_contact", 0.005, 0.1),
            ("tolerance", 0.0, 0.02),
            ("friction", 0.01, 2.0),
            ("mass", 0.001, 100.0),
        ):
            if not least <= getattr(self, name) <= largest:
                raise ValueError(
                    f"goals: {name} must lie between {least} and {largest}, got {getattr(self, name)}"
                )
