"""What Song and Boularias (IROS 2020) report, read off their figures and tables."""

from __future__ import annotations

STABLE_GOALS: dict[str, tuple[float, float]] = {
    "probabilistic": (100.0, 100.0),
    "deterministic": (44.0, 78.0),
    "uniform": (35.0, 54.0),
}
"""Figure 5: stable among the goals chosen, %, from the worst object to the best; real objects."""

_OBJECTS = ("book", "box", "hammer", "wrench", "snack", "spray_gun")
_PERCENT = {
    "probabilistic": (87, 91, 100, 97, 81, 89),
    "deterministic": (64, 73, 79, 77, 61, 65),
    "uniform": (42, 56, 58, 58, 42, 41),
    "true": (87, 96, 98, 96, 76, 89),
}
PREGRASP_SUCCESS: dict[str, dict[str, float]] = {
    name: {method: float(shares[index]) for method, shares in _PERCENT.items()}
    for index, name in enumerate(_OBJECTS)
}
"""Figure 6 (a): object, method, success in %; simulated in Bullet."""

PREGRASP_ACTIONS: dict[str, float] = {
    "probabilistic": 6.27,
    "deterministic": 5.69,
    "uniform": 6.05,
    "true": 5.46,
}
"""Figure 6 (b): mean number of pushes."""

WHOLE_PROCEDURE: dict[str, dict[str, float]] = {
    "hammer": {"probabilistic": 100.0, "deterministic": 80.0, "uniform": 30.0}
}
"""Figure 7: object, method, successful grasps in %; real robot, 10 starts."""
