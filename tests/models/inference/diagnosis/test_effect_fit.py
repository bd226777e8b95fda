"""Maps and effects learned together, against the truth beside a dataset."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
import yaml

import slipmap
from slipmap.models.effects import Effect, EffectError, Parameter
from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.diagnosis import fitting
from slipmap.models.inference.diagnosis.fitting import Fitter
from slipmap.models.inference.diagnosis.procedure import diagnose
from slipmap.models.inference.error_model import sensor_noise
from slipmap.models.inference.identifiability import effect_quantities
from slipmap.models.inference.identification import identify
from slipmap.models.inference.observations import observe_all
from slipmap.models.measurements import read_dataset
from slipmap.models.physics.rollout import RolloutError


@pytest.mark.parametrize(
    ("value", "shown"), [(0.03, True), (0.009, False)], ids=["clear of zero", "not clear of zero"]
)
def test_an_effect_clear_of_its_zero_is_shown_however_wide_its_interval(value: float, shown: bool) -> None:
    """A tilt that keeps three quarters of its prior's width, with an interval that holds zero or not."""
    (effect,) = effects_named(["table_tilt"])
    values = np.array([[value, 0.0], [value, 0.0]])
    belief = SimpleNamespace(parameters_of=lambda name: (values, np.array([0.5, 0.5])))
    prior = SimpleNamespace(
        size=2,
        plain=0,
        slider=SimpleNamespace(effects=(effect,)),
        effect_deviations=lambda hessian: np.array([0.003, 0.003]),
    )
    information = SimpleNamespace(hessian=[0.8 * np.eye(2)])
    found = effect_quantities(belief, effect, SimpleNamespace(prior=prior), information)
    assert [quantity.shown for quantity in found] == [shown, False]
    assert not shown or found[0].reason.startswith("not 0, where the effect vanishes")


def test_intervals_hold_the_truth(shared_data: Path) -> None:
    folder = shared_data / "effects" / "public-latency"
    truth = yaml.safe_load(folder.with_name("public-latency.truth.yaml").read_text())["object"]
    dataset = read_dataset(folder)
    few = replace(dataset, trials=dataset.trials[:8])
    fitted = identify(few, ["sensor_latency"], hypotheses=10)
    told = {quantity.name: quantity for quantity in fitted.quantities}
    values = {
        "sensor_latency: latency": 0.06,
        "total mass": truth["total_mass"],
        "total friction": 9.81 * float(np.dot(truth["mass"], truth["mu"])),
        "centre of mass, x": truth["com"][0],
        "centre of mass, y": truth["com"][1],
    }
    for quantity, value in values.items():
        assert told[quantity].low < value < told[quantity].high, quantity


def test_sizes_hold_the_truth_where_the_strict_fit_is_too_sure(shared_data: Path) -> None:
    """A tilt is in proportion to the mass, of which forces tell more than they know."""
    dataset = read_dataset(shared_data / "effects" / "public-tilt")
    few = replace(dataset, trials=dataset.trials[:16])
    found = diagnose(few, effects=effects_named(["table_tilt", "sensor_latency"]), quick=True)
    tilt, direction = 0.05235988, 1.178213
    truth = {"down_x": tilt * np.cos(direction), "down_y": tilt * np.sin(direction)}
    assert found.verdict == "effect"
    sizes = {size.name: size for size in found.candidates[0].parameters}
    for name, value in truth.items():
        assert sizes[name].low < value < sizes[name].high
        assert sizes[name].high - sizes[name].low < 0.85 * tilt


def test_starts_that_fail_together_are_tried_one_by_one(monkeypatch) -> None:
    """One that cannot be rolled out spoils the fit of all; the better of those that can is kept."""
    dataset, _ = slipmap.simulated_hammer(seed=1, fit=1, heldout=0)
    fitter = Fitter(dataset, observe_all(dataset), sensor_noise(dataset))
    base = fitter.from_scratch(lambda done, total: None)
    costs = iter([5.0, 3.0])
    tried = []

    def fitted(effects, likelihood, starts, mean, iterations, worth):
        tried.append(len(starts))
        if len(starts) > 1:
            raise RolloutError("a made-up failure")
        return SimpleNamespace(cost=next(costs))

    monkeypatch.setattr(fitting, "_fitted", fitted)
    effects = effects_named(["table_tilt"])
    found = fitter.with_effects(effects, base.likelihood.error, base, np.zeros(2), afresh=True)
    assert tried == [2, 1, 1] and found.cost == 3.0


class Explosive(Effect):
    name = "explosive"
    sentence = "A force that explodes."
    parameters = (Parameter("size", "N", "of the force", -5.0, 5.0, 0.2, 0.0),)

    def force(self, body, p):  # type: ignore[no-untyped-def]
        return p.size * sp.exp(3000 * (body.x**2 + body.y**2 + 0.1)), 0, 0


def test_an_effect_whose_derivatives_overflow_is_refused_without_warnings() -> None:
    dataset, _ = slipmap.simulated_hammer(seed=1, fit=2, heldout=0)
    with pytest.raises(EffectError, match=r"explosive cannot be computed .* derivatives overflow"):
        identify(dataset, [Explosive()], hypotheses=2)


def test_effects_of_a_force_sensor_that_measured_nothing_are_no_candidates() -> None:
    dataset, _ = slipmap.simulated_hammer(seed=1, fit=2, heldout=0)
    silent = replace(dataset, trials=tuple(replace(trial, ft_wrench=None) for trial in dataset.trials))
    with pytest.raises(EffectError, match="no force was measured; name another effect"):
        diagnose(silent, effects=["force_bias"], quick=True)
