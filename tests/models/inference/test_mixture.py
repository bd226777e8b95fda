"""Pushes speak for the law of friction and the structure of maps that made them; a belief holds several."""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from slipmap.models.effects import LIBRARY, EffectError
from slipmap.models.effects.effect import columns_of
from slipmap.models.inference import mixture
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.comparison import compare_with_effects
from slipmap.models.inference.diagnosis.procedure import diagnose
from slipmap.models.inference.diagnosis.refits import EffectSearch
from slipmap.models.inference.diagnosis.several import fit_together
from slipmap.models.inference.friction_laws import (
    LAW_EFFECTS,
    beside_slope,
    combinations,
    effect_prior,
    laws_without,
)
from slipmap.models.inference.gauss_newton import fit
from slipmap.models.inference.hypotheses import FINE_ERROR, trusting
from slipmap.models.inference.identification import fit as slipmap_fit, identify
from slipmap.models.inference.mixture import (
    LEAST_SHARE,
    Explanation,
    _counts,
    bold_compared,
    explain,
    mixed_belief,
    shared_out,
)
from slipmap.models.inference.observations import Observation, observe_all
from slipmap.models.inference.prediction import uniform_maps
from slipmap.models.inference.prior import STRUCTURES
from slipmap.models.measurements import DatasetError, PushDataset, read_dataset
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.physics.rollout import Maps, RolloutError, Slider
from slipmap.planners.exploration import candidate_pushes

EFFECTS = {effect.name: effect for effect in LIBRARY}
HEIGHT = 0.05


LAWS = {"load_transfer": (0.5 * HEIGHT, 0.5 * HEIGHT), "impulse_friction": (1.0,)}


def made_by(recorded, *names: str, values=LAWS, heldout: int = 4) -> PushDataset:  # type: ignore[no-untyped-def]
    """Ten pushes, four of them held out, of the object of `recorded` under a law, or with some effects."""
    names = names if values is LAWS else tuple(values)
    rng = np.random.default_rng(8)
    effects = [EFFECTS[name] for name in names]
    grid = recorded.slider.grid
    pushes = [
        candidate.push([0.05, -0.02, 0.7])
        for candidate in candidate_pushes(grid, 0.006, rng, 10, length=(0.06, 0.1))
    ]
    truth = Maps(
        recorded.truth.mass,
        recorded.truth.mu,
        recorded.truth.mu_finger,
        np.array([[value for name in names for value in values[name]]]),
    )
    slider = Slider(grid, 0.006, effects=effects) if names else recorded.slider
    truth = truth if names else recorded.truth
    return record_pushes(
        slider, truth, pushes, rng, heldout=heldout, height=HEIGHT, mass=float(truth.mass.sum())
    )


@pytest.fixture(scope="module")
def leaning(recorded) -> PushDataset:  # type: ignore[no-untyped-def]
    return made_by(recorded, "impulse_friction")


@pytest.fixture(scope="module")
def fitted(leaning) -> list[Observation]:  # type: ignore[no-untyped-def]
    return [observation for observation in observe_all(leaning) if observation.role == "fit"]


@pytest.fixture(scope="module")
def every(leaning, fitted) -> list[Explanation]:  # type: ignore[no-untyped-def]
    return explain(leaning, fitted, None, lambda done, total: None, laws=LAW_EFFECTS)


@pytest.mark.parametrize("names", [(), ("load_transfer",), ("impulse_friction",)], ids="+".join)
def test_pushes_speak_for_the_law_that_made_them(recorded, names) -> None:  # type: ignore[no-untyped-def]
    dataset = made_by(recorded, *names)
    found = identify(dataset, hypotheses=8, friction_laws=True)
    likeliest, share = next(iter(found.friction_laws.items()))
    assert likeliest == (" + ".join(names) or "plain")
    assert share > 0.6
    assert sum(found.friction_laws.values()) == pytest.approx(1.0)
    assert found.to_json()["friction_laws"] == found.friction_laws
    plain = identify(dataset, hypotheses=8, friction_laws=False)
    assert plain.friction_laws == {"plain": 1.0}
    held, held_plain = found.errors("heldout").mean(), plain.errors("heldout").mean()
    assert held < 1.5e-3
    if names:
        assert held < 0.7 * held_plain


def test_laws_of_many_pushes_are_chosen_on_some_and_fitted_to_all(
    leaning, fitted, every, monkeypatch
) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setattr("slipmap.models.inference.mixture._COMPARED", 2)
    said: list[float] = []
    progress = lambda done, total: said.append(done / total)  # noqa: E731
    chosen = explain(leaning, fitted, None, progress, laws=LAW_EFFECTS)
    assert said == sorted(said) and said[-1] == 1.0
    for one in chosen:
        assert list(one.likelihood.observations) == fitted
    assert sum(one.share for one in chosen) == pytest.approx(1.0)
    # Two pushes say too little, so that some explanations that six would rule out are fitted to all six.
    best = max(every, key=lambda one: one.log_evidence)
    (same,) = [one for one in chosen if (one.law, one.structure) == (best.law, best.structure)]
    assert same.best.cost[0] == pytest.approx(best.best.cost[0], rel=0.05)
    belief = mixed_belief(leaning, chosen, 4, 0, lambda *_: None)
    assert belief.settings["laws_chosen_on"] == 2

    # What cannot be fitted to all pushes is left out.
    own, able, chosen_on_two = mixture.fit_with_trust, 1, []
    compared = mixture._compared

    def compared_once(*given, **more):  # type: ignore[no-untyped-def]
        chosen_on_two.extend(() if chosen_on_two else compared(*given, **more))
        return chosen_on_two

    def fit(prior, observations, *rest, **more):  # type: ignore[no-untyped-def]
        nonlocal able
        if len(observations) == len(fitted):
            able -= 1
            if able < 0:
                raise RolloutError("broken")
        return own(prior, observations, *rest, **more)

    monkeypatch.setattr(mixture, "_compared", compared_once)
    monkeypatch.setattr(mixture, "fit_with_trust", fit)
    (left,) = explain(leaning, fitted, None, progress, laws=LAW_EFFECTS)
    assert left.share == 1.0 and len(chosen) > 1
    with pytest.raises(RolloutError, match="broken"):
        explain(leaning, fitted, None, progress, laws=LAW_EFFECTS)


def test_explanations_chosen_with_long_steps_are_fitted_with_the_usual_ones(
    leaning, fitted, every, monkeypatch
) -> None:  # type: ignore[no-untyped-def]
    for one in every:
        assert list(one.likelihood.observations) == fitted
        with_steps = fit(one.likelihood, one.best.z, offsets=one.best.offsets)
        assert one.best.cost[0] == pytest.approx(with_steps.cost[0], rel=2e-3)
    monkeypatch.setattr(type(fitted[0]), "with_long_steps", property(lambda self: self))
    slow = explain(leaning, fitted, None, lambda done, total: None, laws=LAW_EFFECTS)
    assert [(one.law, one.structure) for one in every] == [(one.law, one.structure) for one in slow]
    for one, other in zip(every, slow, strict=True):
        assert one.share == pytest.approx(other.share, abs=0.05)
        assert one.model_error == other.model_error


def test_a_belief_of_several_laws_is_kept(recorded, tmp_path) -> None:  # type: ignore[no-untyped-def]
    """A single push leaves the law open."""
    belief = identify(recorded.dataset.with_fit_pushes(1), hypotheses=9, friction_laws=True).belief
    assert len(belief) == 9 and belief.probability.sum() == pytest.approx(1.0)
    assert [effect.name for effect in belief.effects] == ["impulse_friction"]
    shares = belief.settings["friction_laws"]
    assert set(shares) == {"plain", "impulse_friction"}
    leaning = belief.maps.effects[:, 0] > 0.5
    # Hypotheses of the plain law have the effect at its null.
    assert np.all(belief.maps.effects[~leaning] == 0.0)
    assert belief.probability[leaning].sum() == pytest.approx(shares["impulse_friction"], abs=1e-3)
    belief.save(tmp_path / "belief.npz")
    again = Belief.load(tmp_path / "belief.npz")
    assert np.array_equal(again.maps.effects, belief.maps.effects)
    assert [effect.name for effect in again.effects] == ["impulse_friction"]


def test_every_structure_is_tried_with_a_law_that_is_likelier_than_the_plain_one(recorded) -> None:  # type: ignore[no-untyped-def]
    """Where the pushes are explained well, and smooth maps are tried too."""
    dataset = made_by(recorded, values={"load_transfer": (0.012, 0.012)}, heldout=1)
    dataset = replace(dataset, height=0.024)
    told: list[float] = []
    found = identify(dataset, hypotheses=4, progress=lambda stage, done, total: told.append(done / total))
    assert next(iter(found.friction_laws)) == "load_transfer"
    assert found.belief.settings["model_errors"] == [FINE_ERROR]
    assert max(told) <= 1.0


def test_a_law_does_not_stand_in_for_the_effect_that_is_judged(recorded) -> None:  # type: ignore[no-untyped-def]
    """`identify` finds load transfer by itself, so its errors cannot tell what that effect is worth."""
    dataset = made_by(recorded, "load_transfer").with_fit_pushes(5)
    by_itself = identify(dataset, hypotheses=2)
    assert by_itself.friction_laws["load_transfer"] > 0.8
    result = slipmap_fit(dataset, ["load_transfer"], hypotheses=8)
    assert result.without_effects is not None and result.verdict == "for"
    assert not any("load_transfer" in law for law in result.without_effects.friction_laws)
    compared, _ = compare_with_effects(dataset, ["load_transfer"])
    assert compared.totals["heldout"].model.final_add > 2.0 * by_itself.errors("heldout").mean()
    found = diagnose(dataset, effects=["load_transfer", "viscous_friction"], quick=True)
    assert found.effect == "load_transfer" and found.before is not None and found.after is not None
    assert found.after.total_misfit < 0.6 * found.before.total_misfit
    assert not any("load_transfer" in law for law in found.without_effects.friction_laws)


def test_laws_consist_of_what_is_allowed_and_not_given(recorded) -> None:  # type: ignore[no-untyped-def]
    dataset = made_by(recorded)
    transfer, lean = (EFFECTS[name] for name in LAW_EFFECTS)
    assert combinations(dataset, ()) == [(lean,), (transfer,), (transfer, lean)]
    assert combinations(dataset, (), laws_without([transfer, EFFECTS["skate"]])) == [(lean,)]
    assert combinations(dataset, [lean], laws_without([transfer])) == []
    assert laws_without([EFFECTS["skate"]]) == LAW_EFFECTS and laws_without([lean, transfer]) == ()


@pytest.mark.parametrize(
    "laws",
    ["load_transfer", b"", ["viscous_friction"], ["load_transfer", "plain"], None, 1, iter(())],
)
def test_unknown_laws_are_refused(recorded, laws) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(
        ValueError, match="True, False or a list with names of load_transfer, impulse_friction, got"
    ):
        identify(recorded.dataset, hypotheses=2, friction_laws=laws)


@pytest.mark.parametrize("missing", ["height", "mass"])
def test_without_height_or_mass_nothing_is_said_of_load_transfer(recorded, missing) -> None:  # type: ignore[no-untyped-def]
    dataset = made_by(recorded, "load_transfer")
    found = identify(replace(dataset, **{missing: None}), hypotheses=4, friction_laws=True)
    assert not any("load_transfer" in name for name in found.friction_laws)


SLOPE = {"down_x": 0.12, "down_y": -0.08}


def on_a_slope(recorded, **options) -> PushDataset:  # type: ignore[no-untyped-def]
    """Pushes where gravity and the finger act above a sloping table; neither mass nor height is stated."""
    values = {"table_tilt": tuple(SLOPE.values()), "load_transfer": (0.01, 0.015)}
    return replace(made_by(recorded, values=values, **options), height=None, mass=None)


def test_a_slope_shifts_load_where_the_height_of_the_finger_is_stated(recorded) -> None:  # type: ignore[no-untyped-def]
    """Without the heights the slope is sure and wrong."""
    level = on_a_slope(recorded)
    stated = identify(replace(level, finger_height=0.004), ["table_tilt"]).effect_estimates
    unstated = identify(level, ["table_tilt"]).effect_estimates

    def holds(slope) -> bool:  # type: ignore[no-untyped-def]
        return all(slope[key]["low"] <= true <= slope[key]["high"] for key, true in SLOPE.items())

    assert sorted(stated) == ["load_transfer", "table_tilt"] and holds(stated["table_tilt"])
    assert sorted(unstated) == ["table_tilt"] and not holds(unstated["table_tilt"])


def test_hypotheses_have_effects_or_their_rivals(recorded, tmp_path) -> None:  # type: ignore[no-untyped-def]
    """Three short pushes on a slope hardly tell it from a tether; ten rule out that nothing is there."""
    sloping = replace(made_by(recorded, values={"table_tilt": tuple(SLOPE.values())}, heldout=0), mass=0.6)
    learned = partial(identify, hypotheses=12, friction_laws=False)
    few = learned(sloping.with_fit_pushes(3), ["table_tilt"], rivals=[["tether"]])
    belief, tilt, tether = few.belief, EFFECTS["table_tilt"], EFFECTS["tether"]
    assert {effect.name for effect in belief.effects} == {"table_tilt", "tether"}
    columns = [belief.maps.effects[:, columns_of(effect, belief.effects)] for effect in (tilt, tether)]
    has = [(own != effect.nulls).any(axis=1) for own, effect in zip(columns, (tilt, tether), strict=True)]
    assert np.all(has[0] != has[1]) and 0 < has[0].sum() < 12
    shares = belief.settings["rivals"]
    assert shares.keys() == {"table_tilt", "tether"}
    assert belief.probability[has[0]].sum() == pytest.approx(shares["table_tilt"])
    # What is said of an effect is said of the hypotheses that have it.
    belief.save(tmp_path / "belief.npz")
    for one in (belief, Belief.load(tmp_path / "belief.npz")):
        values, probability = one.parameters_of("table_tilt")
        assert np.array_equal(values, columns[0][has[0]]) and probability.sum() == pytest.approx(1.0)
        assert np.array_equal(one.has("tether"), has[1])
        with pytest.raises(ValueError, match="has no effect 'skate', but"):
            one.has("skate")
    # The uniform object has the effects of one model, not a share of each.
    uniform = uniform_maps(belief).effects[0]
    own = [(uniform[columns_of(one, belief.effects)] != one.nulls).any() for one in (tilt, tether)]
    assert sum(own) == 1
    slope = few.effect_estimates["table_tilt"]
    assert slope["down_x"]["low"] <= np.median(values[:, 0]) <= slope["down_x"]["high"]
    assert sorted(few.effect_estimates) == ["table_tilt", "tether"]
    assert few.errors("fit").max() < 1e-3

    alone = learned(sloping, ["table_tilt"])
    ruled_out = learned(sloping, ["table_tilt"], rivals=[[]])
    assert np.array_equal(ruled_out.belief.maps.effects, alone.belief.maps.effects)
    assert [str(one) for one in ruled_out.quantities] == [str(one) for one in alone.quantities]
    assert "rivals" not in ruled_out.belief.settings
    # The right one takes over, also where it is the rival.
    taken_over = learned(sloping, [], rivals=[["table_tilt"]])
    assert [effect.name for effect in taken_over.belief.effects] == ["table_tilt"]


def test_a_rival_that_cannot_be_fitted_is_left_out(recorded, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    dataset = made_by(recorded, heldout=0).with_fit_pushes(2)
    own = EffectSearch.find

    def fails(search, effects, *rest):  # type: ignore[no-untyped-def]
        if EFFECTS["tether"] in effects:
            raise DatasetError("it cannot be fitted")
        return own(search, effects, *rest)

    monkeypatch.setattr(EffectSearch, "find", fails)
    found = identify(dataset, ["table_tilt"], hypotheses=2, friction_laws=False, rivals=[["tether"]])
    assert [effect.name for effect in found.belief.effects] == ["table_tilt"]
    with pytest.raises(DatasetError, match="cannot be fitted"):
        identify(dataset, ["tether"], hypotheses=2, rivals=[["table_tilt"]])

    def nothing_to_start_from(*_):  # type: ignore[no-untyped-def]
        raise DatasetError("it cannot be computed")

    with monkeypatch.context() as context:
        context.setattr(EffectSearch, "of", nothing_to_start_from)
        found = identify(dataset, hypotheses=2, friction_laws=False, rivals=[["table_tilt"], ["tether"]])
        assert not found.belief.effects
        with pytest.raises(DatasetError, match="cannot be computed"):
            identify(dataset, ["table_tilt"], hypotheses=2)
    with pytest.raises(ValueError, match="does not support effects"):
        identify(dataset, method="paper", rivals=[["tether"]])
    for wrong, said in (("tether", "list of lists"), (["tether"], r"write \[\['tether'\]\]")):
        with pytest.raises(EffectError, match=said):
            identify(dataset, rivals=wrong)


def test_more_rivals_than_hypotheses(recorded) -> None:  # type: ignore[no-untyped-def]
    """Some get none; sets that are given twice count once."""
    dataset = made_by(recorded, heldout=0).with_fit_pushes(2)
    rivals = [["tether"], ["loose_mass"], ["table_tilt"], ["tether"]]
    found = identify(dataset, ["table_tilt"], hypotheses=2, friction_laws=False, rivals=rivals)
    assert len(found.belief) == 2 and len(found.belief.settings.get("rivals", "one")) <= 3
    assert set(found.effect_estimates) == {effect.name for effect in found.belief.effects}


def test_friction_counts_with_the_effects_that_a_hypothesis_has(recorded, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    """Also those of the less likely rival, here made to change friction tenfold."""
    field = EFFECTS["table_friction_field"]

    def tenfold(self, place, values):  # type: ignore[no-untyped-def]
        return np.where((values != self.nulls).any(axis=1), 10.0, 1.0)

    monkeypatch.setattr(type(field), "level", tenfold)
    dataset = made_by(recorded, values={"table_friction_field": (3.0, 0.0, 0.0, 0.0, 0.0, 0.1)}, heldout=0)
    found = identify(
        dataset.with_fit_pushes(2), ["table_tilt"], hypotheses=8, friction_laws=False, rivals=[[field]]
    )
    belief = found.belief
    assert [effect.name for effect in belief.effects] == ["table_tilt", field.name]
    factor = np.where(belief.has(field.name), 10.0, 1.0)
    forces = belief.friction_forces * factor
    (total,) = (fact for fact in found.quantities if fact.name == "total friction")
    assert total.low < 1.5 * forces[factor == 1.0].max() and total.high > forces[factor == 10.0].min()
    assert forces[factor == 10.0].min() > 3.0 * forces[factor == 1.0].max()


def test_two_datasets_on_a_slope_shift_load_like_one(recorded, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    """And what the model without a slope leaves is no error of the model with it."""
    both = on_a_slope(recorded, heldout=0)
    monkeypatch.setattr("slipmap.models.inference.diagnosis.several.learn", lambda dataset, *rest, **more: 0)

    def holds(height: float | None) -> bool:
        parts = [
            replace(both, trials=both.trials[k::2], name=f"half {k}", finger_height=height) for k in (0, 1)
        ]
        found = fit_together(parts, ["table_tilt"])
        assert all([one.name for one in half.alone] == list(SLOPE) for half in found.datasets)
        return all(one.low <= SLOPE[one.name] <= one.high for one in found.parameters)

    assert holds(0.004) and not holds(None)


def test_what_a_slope_brings_is_known_by_name(recorded) -> None:  # type: ignore[no-untyped-def]
    """Effects that come from another process are copies."""
    dataset = replace(made_by(recorded), finger_height=0.004)
    slope, load = pickle.loads(pickle.dumps([EFFECTS["table_tilt"], EFFECTS["load_transfer"]]))
    assert beside_slope([slope], dataset) == (EFFECTS["load_transfer"],)
    assert beside_slope([slope, load], dataset) == beside_slope([EFFECTS["tether"]], dataset) == ()


def test_two_hypotheses_follow_two_laws(recorded) -> None:  # type: ignore[no-untyped-def]
    dataset = made_by(recorded).with_fit_pushes(1)
    found = identify(dataset, hypotheses=2, friction_laws=True)
    assert len(found.belief) == len(found.friction_laws) == 2
    assert sum(found.friction_laws.values()) == pytest.approx(1.0)


def test_a_law_that_cannot_be_refitted_is_left_out(recorded, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    from slipmap.models.inference import mixture

    refits = mixture.refits

    def failing(ladder, *rest, **options):  # type: ignore[no-untyped-def]
        if ladder[0][0].prior.slider.effects:
            raise RolloutError("model 0, push 0: not solved")
        return refits(ladder, *rest, **options)

    monkeypatch.setattr(mixture, "refits", failing)
    found = identify(recorded.dataset.with_fit_pushes(1), hypotheses=6, friction_laws=True)
    assert found.friction_laws == {"plain": pytest.approx(1.0)}
    assert found.belief.effects == ()
    assert found.belief.probability.sum() == pytest.approx(1.0)


def explained(
    law: str,
    structure: str,
    evidence: float,
    alpha: float = 0.005,
    pushes: int = 10,
    cost_per_row: float = 0.5,
) -> Explanation:
    """Pushes that count as five rows each."""
    likelihood: Any = SimpleNamespace(
        settings=trusting(alpha), observations=[None] * pushes, rows_counted=5.0 * pushes
    )
    best: Any = SimpleNamespace(push_cost=np.full((1, pushes), 5.0 * cost_per_row))
    return Explanation(law, structure, [(likelihood, best)], evidence)


def shares(*every: Explanation) -> dict[str, float]:
    return {f"{one.law} {one.structure}": one.share for one in shared_out(every)}


def test_what_could_not_be_fitted_has_no_share() -> None:
    assert shares(explained("plain", "own", 10.0), explained("a", "own", -np.inf)) == {"plain own": 1.0}


def test_shares_follow_the_tempered_evidence() -> None:
    found = shares(
        explained("plain", "own", 10.0), explained("a", "own", 14.0), explained("b", "own", 14.0 - 20.0)
    )
    # T is 5; the third, e^-4 of the first, is below the least share.
    assert np.exp(-4) < LEAST_SHARE
    assert list(found) == ["a own", "plain own"]
    assert found["a own"] == pytest.approx(1 / (1 + np.exp(-4.0 / 5.0)))
    assert sum(found.values()) == pytest.approx(1.0)


def test_the_further_the_model_is_off_the_less_evidence_tells() -> None:
    exact = shares(explained("plain", "own", 10.0), explained("a", "own", 14.0))
    off = shares(explained("plain", "own", 10.0, 0.04), explained("a", "own", 14.0, 0.04))
    assert off["a own"] == pytest.approx(1 / (1 + np.exp(-4.0 / 40.0)))
    assert off["a own"] < exact["a own"] - 0.1


def test_few_pushes_do_not_speak_for_wild_maps_that_merely_follow_them() -> None:
    def of(pushes: int, alpha: float, cost_per_row: float = 0.5) -> dict[str, float]:
        return shares(
            explained("plain", "uneven", 10.0, 0.1, pushes),
            explained("plain", "few points", 900.0, alpha, pushes, cost_per_row),
        )

    assert of(5, 0.015) == {"plain uneven": 1.0}
    assert of(5, 0.005) == {"plain few points": 1.0}
    # The smallest alpha is the best, and yet residuals are larger than it allows.
    assert of(5, 0.005, cost_per_row=2.0) == {"plain uneven": 1.0}
    assert of(8, 0.015) == {"plain few points": 1.0}


@pytest.mark.parametrize("structure", ["smooth", "few points"])
def test_pushes_speak_for_the_structure_that_made_them(recorded, structure) -> None:  # type: ignore[no-untyped-def]
    """An object that is even, and one that stands on three cells."""
    rng = np.random.default_rng(3)
    grid = recorded.slider.grid
    n = len(grid)
    mass = np.full((1, n), 1.0 / n)
    if structure == "few points":
        feet = [int(np.argmin(grid.centers @ d)) for d in ([1.0, 1.0], [-1.0, 0.2], [0.2, -1.0])]
        mass[:] = 0.02 / n
        mass[0, feet] = 0.98 / 3
    truth = Maps(mass, np.full((1, n), 0.3), np.array([0.3]))
    pushes = [c.push([0.0, 0.0, 0.3]) for c in candidate_pushes(grid, 0.006, rng, 14, length=(0.05, 0.1))]
    dataset = record_pushes(recorded.slider, truth, pushes, rng, heldout=4, mass=1.0)
    found = identify(dataset, friction_laws=False)
    shares = found.belief.settings["structures"]
    own = ("smooth", "uniform") if structure == "smooth" else (structure,)
    assert sum(shares.get(name, 0.0) for name in own) > 0.5

    def arm(load: np.ndarray) -> float:
        center = load @ grid.centers / load.sum()
        return float(load @ np.hypot(*(grid.centers - center).T) / load.sum())

    fact = next(q for q in found.quantities if q.name.startswith("friction arm"))
    assert fact.value == pytest.approx(arm(truth.mass[0]), rel=0.01)
    if structure == "few points":
        # Smooth maps alone are sure of another arm.
        tame = identify(dataset, prior_settings=STRUCTURES["smooth"], friction_laws=False)
        wrong = next(q for q in tame.quantities if q.name.startswith("friction arm"))
        assert wrong.value < 0.97 * arm(truth.mass[0])


@pytest.mark.parametrize(
    ("shares", "hypotheses", "counts"),
    [
        ([1.0], 7, [7]),
        ([0.9, 0.1], 20, [18, 2]),
        ([0.5, 0.3, 0.2], 5, [3, 1, 1]),
        ([0.4, 0.3, 0.2, 0.1], 4, [1, 1, 1, 1]),
    ],
)
def test_hypotheses_are_shared_out(shares, hypotheses, counts) -> None:  # type: ignore[no-untyped-def]
    assert _counts(np.array(shares), hypotheses) == counts


def test_heights_are_expected_at_half_the_object(recorded) -> None:  # type: ignore[no-untyped-def]
    effects = [EFFECTS["load_transfer"], EFFECTS["impulse_friction"]]
    dataset = replace(made_by(recorded), height=0.04)
    means, deviations = effect_prior(effects, dataset)
    assert means == pytest.approx([0.02, 0.02, 1.0])
    assert deviations == pytest.approx([0.006, 0.002, 0.01])
    means, deviations = effect_prior(effects, replace(dataset, finger_height=0.004))
    assert means == pytest.approx([0.009, 0.02, 1.0])
    assert deviations == pytest.approx([0.005, 0.002, 0.01])


def test_the_authors_simulator_leans_and_loads_the_front(shared_data) -> None:  # type: ignore[no-untyped-def]
    """Over its datasets the plain law leaves 17 to 19 mm."""
    errors, plain = [], []
    for name in ("book_p9", "box_p0", "hammer_p0"):
        dataset = read_dataset(shared_data / "bullet" / name).with_fit_pushes(5)
        result = identify(dataset, friction_laws=True)
        plain.append(result.friction_laws.get("plain", 0.0))
        held = result.errors("heldout")
        assert held.mean() < 0.5 * result.errors("heldout", "uniform_add").mean()
        assert held.mean() < 0.2 * result.errors("heldout", "no_motion_add").mean()
        errors.append(held.mean())
    assert np.mean(errors) < 12e-3
    assert np.mean(plain) < 0.3


@pytest.mark.parametrize(
    ("pushes", "exact_law", "structure", "compared"),
    [
        (7, None, "uneven", False),
        (7, "load_transfer", "smooth", False),
        (7, "plain", "smooth", True),
        (8, None, "uneven", True),
        (3, None, "own", True),
    ],
)
def test_maps_that_vary_strongly_are_compared_with_enough_or_exact_pushes(
    pushes, exact_law, structure, compared
):
    one: Any = SimpleNamespace(
        likelihood=SimpleNamespace(observations=[None] * pushes),
        exact=exact_law is not None,
        law=exact_law or "plain",
        structure=structure,
    )
    assert bold_compared([one]) is compared
