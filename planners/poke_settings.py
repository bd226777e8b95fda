"""What exploring pushes are like; a user tunes them in a scenario file."""

# Annotations stay objects: Drake's YAML reader looks at them.
from dataclasses import dataclass, field


@dataclass
class PokeSettings:
    """What pokes are like.

    Attributes:
        shortest, longest: way of the finger after first touch, m.
        slowest, fastest: speed of the finger, m/s.
        taps: share of the pokes that are taps: the finger touches the object gently, speeds up, and stops
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
        """Whether a poke, counted from 0, is a tap; they are spread evenly, slow ones come first."""
        return int((number + 1) * self.taps + 1e-9) > int(number * self.taps + 1e-9)

    def check(self) -> None:
        """Raise ValueError, naming the field, where a number makes no sense."""
        for low, high in (("shortest", "longest"), ("slowest", "fastest")):
            if not 0 < getattr(self, low) <= getattr(self, high) < 10.0:
                raise ValueError(
                    f"pokes: {low} and {high} must be positive, in this order and below 10, got"
                    f" {getattr(self, low)} and {getattr(self, high)}"
                )
        for name, least, largest in (
            ("taps", 0.0, 1.0),
            ("tap_speed", 0.05, 2.0),
            ("approach", 1e-3, 0.1),
            ("cone", 0.0, 80.0),
            ("candidates", 1, 10_000),
            ("region", 0.01, 1.0),
        ):
            if not least <= getattr(self, name) <= largest:
                raise ValueError(
                    f"pokes: {name} must lie between {least} and {largest}, got {getattr(self, name)}"
                )
        if len(self.center) != 2 or not all(abs(value) < 10.0 for value in self.center):
            raise ValueError(f"pokes: center must be x and y in m, got {self.center}")
