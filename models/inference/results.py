"""Results of an identification."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slipmap.models.effects.effect import Effect
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.prediction import Prediction
from slipmap.models.inference.push_errors import Paired
from slipmap.models.inference.summaries import decimals
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.settings import check_choice, check_kind


@dataclass(frozen=True)
class Quantity:
    """One physical quantity, its value in the belief, and whether the pushes determine it."""

    name: str  # display name, such as `centre of mass, x`
    unit: str  # SI; `-` where it has none
    value: float  # median over the belief
    low: float  # lower end of the 90 % interval
    high: float  # upper end
    shown: bool  # whether the pushes determine it, see `slipmap.models.inference.identifiability`
    reason: str  # why, or why not

    def __str__(self) -> str:
        """Name, value and interval, as precise as that: `total friction: 1.761 N (1.746 to 1.776)`."""
        unit = "" if self.unit == "-" else f" {self.unit}"
        value, low, high = self.numbers(self.value)
        return f"{self.name}: {value}{unit} ({low} to {high})"

    def numbers(self, *values: float, factor: float = 1.0) -> tuple[str, ...]:
        """Values and the ends of the interval, times a factor, with as many digits as the interval justifies.

        Where the interval spans decades, each number has two significant figures instead; where it has no
        width, four.
        """
        low, high = factor * self.low, factor * self.high
        if high - low <= 1e-9 * abs(high):
            return tuple(f"{factor * number:.4g}" for number in (*values, self.low, self.high))
        decades = low > 0 and high > 5 * low
        return tuple(
            f"{number:z.{decimals(number if decades else high - low)}f}"
            for number in (*(factor * value for value in values), low, high)
        )


@dataclass(frozen=True, eq=False)
class Identification:
    """Result of `identify`.

    Attributes:
        belief: what was learned.
        pushes: all pushes, fitted and held out, as measured and as predicted.
        quantities: what the pushes determine, and what they leave open.
        seconds: run time.
        friction_laws: share of the belief by law of friction, the largest first; only `plain` where no other
            was tried, empty for the method `paper`.
        share_of_known: where maps were known beforehand, the weight of the model with these maps against one
            with free maps; 0 where the pushes contradict them.
        without_effects: for `fit`, what the model without the effects, also among its laws of friction,
            learned from the same pushes.
        dataset: the pushes as they were measured, fitted and held out.
    """

    belief: Belief
    pushes: tuple[Prediction, ...]
    quantities: tuple[Quantity, ...]
    seconds: float
    friction_laws: Mapping[str, float] = field(default_factory=dict)
    share_of_known: float | None = None
    without_effects: Identification | None = None
    dataset: PushDataset | None = None

    def __repr__(self) -> str:
        errors = ", ".join(
            f"{1e3 * self.errors(role).mean():.2f} mm over {len(self.errors(role))} {role} pushes"
            for role in ("fit", "heldout")
            if len(self.errors(role))
        )
        return f"Identification({self.belief!r}; mean ADD at the end {errors})"

    def errors(self, role: str, of: str = "final_add") -> FloatArray:
        """Final ADD (m) of the pushes with a role, (B,), empty where there are none.

        Args:
            role: `fit`, or `heldout` for the pushes that were held out.
            of: whose error: `final_add` for the model, `no_motion_add` or `uniform_add`.

        Raises:
            ValueError: another role or error.
        """
        check_choice("errors: role", role, ("fit", "heldout"))
        check_choice("errors: of", of, ("final_add", "no_motion_add", "uniform_add"))
        return np.array([getattr(push, of) for push in self.pushes if push.role == role])

    @property
    def judges(self) -> str:
        """Role of the pushes that judge: `heldout`, or `fit` where none were held out."""
        return "heldout" if any(push.role == "heldout" for push in self.pushes) else "fit"

    @property
    def with_and_without(self) -> Paired | None:
        """For `fit`, how the effects change the misfit of the pushes that judge."""
        if self.without_effects is None:
            return None
        first, second = (
            np.array([push.errors.misfit for push in learned.pushes if push.role == self.judges])
            for learned in (self.without_effects, self)
        )
        return Paired.of(first, second)

    @property
    def verdict(self) -> str:
        """For `fit`, whether the pushes speak `for` or `against` the effects, or leave it `undecided`.

        They speak for them where the misfit of those that judge falls, and the interval of each effect
        excludes its null.
        """
        paired = self.with_and_without
        assert paired is not None
        return "undecided" if paired.verdict == "for" and self.without_clear_size else paired.verdict

    @property
    def without_clear_size(self) -> tuple[str, ...]:
        """Names of the requested effects whose intervals include no effect at all, see `holds_null`."""
        told = self.effect_estimates
        names = (effect for effect in self.belief.effects if effect.name in told)
        return tuple(effect.name for effect in names if holds_null(effect, told[effect.name]))

    @property
    def effect_estimates(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Value (median), 90 % interval, unit and whether shown, by requested effect and parameter."""
        facts = {quantity.name: quantity for quantity in self.quantities}
        return {
            effect.name: {
                p.name: {
                    key: getattr(facts[f"{effect.name}: {p.name}"], key)
                    for key in ("value", "low", "high", "unit", "shown")
                }
                for p in effect.parameters
            }
            for effect in self.belief.effects
            if any(f"{effect.name}: {p.name}" in facts for p in effect.parameters)
        }

    def to_json(self) -> dict[str, object]:
        """The machine-readable result; lengths in m, null where there is nothing to average."""

        def mean(values: FloatArray) -> float | None:
            return float(values.mean()) if len(values) else None

        more: dict[str, object] = {}
        if self.without_effects is not None:
            plain = {
                f"{role}_error_mean": mean(self.without_effects.errors(role)) for role in ("fit", "heldout")
            }
            paired = self.with_and_without
            assert paired is not None
            more = {
                "effects": self.effect_estimates,
                "without_effects": plain,
                "misfit_with_over_without": {**paired.to_json(), "verdict": self.verdict},
            }
        heldout = self.errors("heldout")
        return {
            "fit_error_mean": mean(self.errors("fit")),
            "heldout_error_mean": mean(heldout),
            "heldout_error_median": float(np.median(heldout)) if len(heldout) else None,
            "no_motion_error_mean": mean(self.errors("heldout", "no_motion_add")),
            "uniform_error_mean": mean(self.errors("heldout", "uniform_add")),
            "trials": [push.to_json() for push in self.pushes],
            "hypotheses": [
                {
                    "probability": float(self.belief.probability[k]),
                    "mass": float(self.belief.maps.mass[k].sum()),
                    "center_of_mass": self.belief.centers_of_mass[k].tolist(),
                    "friction_force": float(self.belief.friction_forces[k]),
                    "mu_finger": float(self.belief.maps.mu_finger[k]),
                }
                for k in range(len(self.belief))
            ],
            "friction_laws": dict(self.friction_laws),
            **({} if self.share_of_known is None else {"share_of_known_maps": self.share_of_known}),
            "identifiable": [vars(quantity) for quantity in self.quantities],
            "seconds": self.seconds,
            "seed": self.belief.seed,
            **more,
        }


def holds_null(effect: Effect, told: Mapping[str, Mapping[str, Any]]) -> bool:
    """Whether the 90 % interval of each of an effect's amplitudes contains its null (no effect).

    Args:
        told: `low` and `high` of its parameters by name, as in `Identification.effect_estimates`.
    """
    amplitudes = [parameter for parameter in effect.parameters if parameter.null is not None]
    return all(told[p.name]["low"] <= p.center <= told[p.name]["high"] for p in amplitudes)


def belief_of(learned: Belief | Identification) -> Belief:
    """A belief, or that of the result of `identify`.

    Raises:
        TypeError: something else.
    """
    belief = learned.belief if isinstance(learned, Identification) else learned
    check_kind("belief", belief, Belief, "such as slipmap.identify(dataset).belief")
    return belief
