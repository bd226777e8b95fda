"""What an identification and a prediction report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slipmap.models.inference.belief import Belief
from slipmap.models.physics.cell_grid import FloatArray


@dataclass(frozen=True, eq=False)
class Prediction:
    """One push as measured and as a belief predicts it from its first pose.

    Attributes:
        trial: name of the trial.
        role: `fit` or `heldout`.
        times: (S,) s after the first pose.
        measured: (S, 3) poses of the object.
        hypotheses: (K, S, 3) predicted poses.
        predicted: (S, 3) in the middle of the hypotheses, see `summaries.middle_poses`.
        final_add: mean distance of the cells at the end between `predicted` and measured, m.
        spread: probability-weighted mean ADD of the hypotheses from `predicted` at the end, m.
        no_motion_add: final ADD of an object that does not move, m.
        uniform_add: final ADD of the uniform object, m.
        start_sensitivity: how many metres the predicted end moves (ADD) for a metre of sideways shift of
            the start; large where the push starts near to balance and half a millimetre decides.
    """

    trial: str
    role: str
    times: FloatArray
    measured: FloatArray
    hypotheses: FloatArray
    predicted: FloatArray
    final_add: float
    spread: float
    no_motion_add: float
    uniform_add: float
    start_sensitivity: float


@dataclass(frozen=True)
class Quantity:
    """One physical quantity, what the belief says of it, and whether these pushes show it.

    Attributes:
        name: for a person, such as `centre of mass, x`.
        unit: SI; `-` where it has none.
        value: median over the belief.
        low: lower end of the 90 % interval.
        high: upper end.
        shown: whether the data leave less than half of the width that the prior has, or it was weighed.
        reason: why, or why not.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    shown: bool
    reason: str

    def __str__(self) -> str:
        """Name and interval: `total friction: 1.746 to 1.776 N`."""
        unit = "" if self.unit == "-" else f" {self.unit}"
        return f"{self.name}: {self.low:.4g} to {self.high:.4g}{unit}"


@dataclass(frozen=True, eq=False)
class Identification:
    """Result of `identify`.

    Attributes:
        belief: what was learnt.
        pushes: as measured and as predicted, those that taught and those that judge.
        quantities: what the pushes show, and what not.
        seconds: that it took.
        friction_laws: share of the belief by law of friction, the largest first; `plain` alone where no
            other was tried, empty where none was chosen among.
        without_effects: of `fit`, what the model without the effects learnt from the same pushes.
    """

    belief: Belief
    pushes: tuple[Prediction, ...]
    quantities: tuple[Quantity, ...]
    seconds: float
    friction_laws: Mapping[str, float] = field(default_factory=dict)
    without_effects: Identification | None = None

    def errors(self, role: str, of: str = "final_add") -> FloatArray:
        """Final ADD (m) of all pushes with a role; `of` may also be `no_motion_add` or `uniform_add`."""
        return np.array([getattr(push, of) for push in self.pushes if push.role == role])

    @property
    def effect_estimates(self) -> dict[str, dict[str, dict[str, Any]]]:
        """By effect and parameter: value (median), 90 % interval, unit, and whether the pushes show it."""
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
            more = {"effects": self.effect_estimates, "without_effects": plain}
        heldout = self.errors("heldout")
        of_trial = (
            "trial", "role", "final_add", "spread", "no_motion_add", "uniform_add", "start_sensitivity"
        )  # fmt: skip
        return {
            "fit_error_mean": mean(self.errors("fit")),
            "heldout_error_mean": mean(heldout),
            "heldout_error_median": float(np.median(heldout)) if len(heldout) else None,
            "no_motion_error_mean": mean(self.errors("heldout", "no_motion_add")),
            "uniform_error_mean": mean(self.errors("heldout", "uniform_add")),
            "trials": [{name: getattr(push, name) for name in of_trial} for push in self.pushes],
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
            "identifiable": [vars(quantity) for quantity in self.quantities],
            "seconds": self.seconds,
            "seed": self.belief.seed,
            **more,
        }
