"""What decides where no single effect is accepted, and the last word of the locked pushes."""

from types import SimpleNamespace

import numpy as np
import pytest

from slipmap.models.effects.library import LIBRARY
from slipmap.models.effects.probes import PROBES
from slipmap.models.inference.diagnosis import outcomes, procedure as steps
from slipmap.models.inference.diagnosis.locked import LockedErrors
from slipmap.models.inference.diagnosis.screening import Screening
from slipmap.models.inference.diagnosis.verdict_rules import (
    Objection,
    Remainder,
    Rules,
    far_above_noise,
    locked_pushes_object,
    locked_pushes_stay_off,
    not_outdone,
    objection,
    objections,
    with_better_predictors,
)
from slipmap.models.inference.results import holds_null

ALIKE = {"far": 50.0, "near": 50.0}
"""Gains on pushes left out."""


@pytest.mark.parametrize(
    ("before", "after", "off"),
    [(18.0, 17.7, True), (18.0, 16.0, False), (18.0, 1.5, False), (1.4, 1.4, False), (2.5, 2.6, True)],
)
def test_locked_pushes_that_stay_far_off_refute_an_answer(before, after, off):
    errors_of = [errors(*4 * [value]) for value in (before, after)]
    assert locked_pushes_stay_off(*errors_of) is off


def test_one_push_near_to_balance_does_not_refute_an_answer():
    before, after = (errors(*misfit) for misfit in ([2.4, 2.0, 10.2, 4.0], [1.1, 1.1, 15.1, 1.4]))
    assert after.total_misfit > before.total_misfit
    assert not locked_pushes_stay_off(before, after)


def test_without_locked_pushes_nothing_is_refuted():
    assert not locked_pushes_stay_off(None, None)


def errors(*misfits, spread=0.0):
    return LockedErrors(*3 * [np.array(misfits)], np.broadcast_to(spread, len(misfits)))


@pytest.mark.parametrize(("spread", "objects"), [((0.4, 0.4, 0.4, 6.0), False), (0.4, True)])
def test_a_push_that_is_left_open_does_not_object(spread, objects):
    """Near the noise, one that is missed by more with the effect than without, near balance or not."""
    before = errors(1.5, 1.4, 1.6, 3.0, spread=spread)
    after = errors(1.0, 0.9, 1.1, 4.6, spread=spread)
    assert locked_pushes_object(False, before, after) is objects
    # What only one of the models leaves open still counts.
    assert locked_pushes_object(False, before, errors(1.0, 0.9, 1.1, 4.6, spread=0.4))


def test_a_push_that_is_left_open_excuses_no_other():
    """The fourth one is worse, near the noise, whatever the fifth leaves open."""
    spread = (0.3, 0.3, 0.3, 0.3, 6.0)
    before, after = errors(*5 * [1.2], spread=spread), errors(0.4, 0.4, 0.4, 4.0, 1.2, spread=spread)
    assert locked_pushes_object(False, before, after)


def test_a_push_that_is_left_open_does_not_hold_the_others_off():
    spread = (0.4, 0.4, 0.4, 70.0)
    before, after = errors(1.5, 1.4, 1.6, 20.0, spread=spread), errors(1.0, 1.0, 1.1, 60.0, spread=spread)
    assert not locked_pushes_object(False, before, after) and not locked_pushes_stay_off(before, after)
    assert locked_pushes_stay_off(errors(1.5, 1.4, 1.6, 20.0), errors(1.0, 1.0, 1.1, 60.0))


def test_improvements_count_though_they_are_left_open():
    before = errors(4.6, 2.4, 1.8, 25.6, spread=(2.2, 2.0, 2.7, 8.7))
    after = errors(1.1, 1.1, 1.0, 2.4, spread=(1.1, 1.3, 2.3, 3.1))
    assert not locked_pushes_object(True, before, after)


@pytest.mark.parametrize(
    ("before", "after", "objects"),
    [
        ((1.5, 1.7), (0.9, 1.1), False),
        ((1.5, 1.7, 2.0), (1.4, 1.6, 1.9), False),  # a little, but in each push alike
        ((1.5, 1.7, 2.0), (1.5, 1.2, 1.9), True),  # a little, in one of them
        ((1.5, 1.5), (1.5, 1.5), True),  # nothing falls
        ((1.2, 2.0), (0.9, 2.3), True),  # near to the noise the root mean square has to fall, too
        # far from it one push near to balance does not decide
        ((2.4, 2.0, 10.2, 4.0), (1.1, 1.1, 15.1, 1.4), False),
        ((20.0, 20.0), (21.0, 21.0), True),
    ],
)
def test_locked_pushes_that_do_not_fall_veto_at_any_misfit(before, after, objects):
    assert locked_pushes_object(False, errors(*before), errors(*after)) is objects


TILT, MASS = (
    next(effect for effect in LIBRARY if effect.name == name) for name in ("table_tilt", "loose_mass")
)


def learned(effect, **intervals):
    """What is learned with an effect, which meets the ten open pushes to the noise."""
    told = {p.name: {"low": -1.0, "high": 1.0} for p in effect.parameters}
    told |= {name: {"low": low, "high": high} for name, (low, high) in intervals.items()}
    pushes = [
        SimpleNamespace(role="fit", errors=SimpleNamespace(misfit=misfit)) for misfit in 5 * (0.8, 1.25)
    ]
    pushes.append(SimpleNamespace(role="heldout", errors=SimpleNamespace(misfit=50.0)))
    return SimpleNamespace(effect_estimates={effect.name: told}, pushes=pushes)


@pytest.mark.parametrize(
    ("effect", "intervals", "holds"),
    [
        (TILT, {"down_x": (-0.01, 0.02), "down_y": (-0.02, 0.01)}, True),
        (TILT, {"down_x": (0.01, 0.02), "down_y": (-0.02, 0.01)}, False),
        (MASS, {"share": (0.0, 0.23), "rate": (6.0, 9.0), "damping": (0.1, 0.2)}, True),
        (MASS, {"share": (0.1, 0.23)}, False),
    ],
)
def test_an_interval_that_holds_nothing_at_all_vetoes(effect, intervals, holds):
    own = learned(effect, **intervals)
    assert holds_null(effect, own.effect_estimates[effect.name]) is holds
    said = objection((effect,), own, False, errors(20.0, 20.0), errors(2.0, 2.0))
    assert (said is not None) is holds


@pytest.mark.parametrize(
    ("after", "objects"),
    [
        ((2.9, 2.9), False),  # near to the noise
        ((3.5, 3.5), True),
        ((1.2, 9.0), True),
        ((1.0, 8.5), False),  # the typical one counts
    ],
)
def test_an_answer_that_only_describes_the_open_pushes_is_not_named(after, objects):
    """It misses the typical open push by once the noise."""
    own = learned(TILT, down_x=(0.01, 0.02), down_y=(-0.02, 0.01))
    said = objection((TILT,), own, False, errors(20.0, 20.0), errors(*after))
    assert (said == Objection("far behind")) is objects
    # The maps of few pushes may overfit.
    few = SimpleNamespace(effect_estimates=own.effect_estimates, pushes=own.pushes[1:])
    assert objection((TILT,), few, False, errors(20.0, 20.0), errors(*after)) is None
    # Locked pushes that are no further off than the open ones do not speak against it.
    for push in own.pushes:
        push.errors.misfit *= 4.0
    assert objection((TILT,), own, False, errors(20.0, 20.0), errors(*after)) is None


@pytest.mark.parametrize(
    ("share", "typical", "stays"),
    [
        ((0.1, 0.23), 2.1, True),
        ((0.1, 0.23), 4.0, False),
        ((0.0, 0.23), 2.1, True),
        ((0.0, 0.23), 4.0, False),
    ],
    ids=["as well", "worse", "its interval holds no effect", "that and worse"],
)
def test_locked_pushes_do_not_choose_between_effects_that_predict_them_alike(share, typical, stays):
    """Rough pushes must improve by more than their scatter, which one effect reaches and the other misses."""
    before = errors(10.0, 10.0)
    tilted = ((TILT,), learned(TILT, down_x=(0.01, 0.02), down_y=(-0.02, 0.01)), errors(2.0, 2.0))
    loose = ((MASS,), learned(MASS, share=share), errors(1.0, typical**2))
    assert locked_pushes_object(True, before, tilted[2]) is False
    assert locked_pushes_object(True, before, loose[2]) is True
    found = objections({"table_tilt": tilted, "loose_mass": loose}, True, before)
    assert list(found) == ([] if stays else ["loose_mass"])
    assert list(objections({"loose_mass": loose}, True, before)) == ["loose_mass"]


def test_an_interval_that_holds_no_effect_drops_what_leaves_locked_pushes_far_off():
    before = errors(3.1, 3.1)
    tilted = ((TILT,), learned(TILT, down_x=(0.01, 0.02), down_y=(-0.02, 0.01)), errors(2.73, 2.73))
    loose = ((MASS,), learned(MASS, share=(0.0, 0.23)), errors(2.95, 2.95))
    assert list(objections({"table_tilt": tilted, "loose_mass": loose}, False, before)) == ["loose_mass"]


def test_an_effect_of_a_pair_must_have_an_amplitude():
    before, told = errors(10.0, 10.0), learned(TILT, down_x=(0.01, 0.02), down_y=(-0.02, 0.01))
    both = SimpleNamespace(
        effect_estimates=told.effect_estimates | learned(MASS, share=(0.0, 0.23)).effect_estimates,
        pushes=told.pushes,
    )
    rivals = {"alone": ((TILT,), told, errors(2.0, 2.0)), "both": ((TILT, MASS), both, errors(2.1, 2.1))}
    assert list(objections(rivals, False, before)) == ["both"]


def test_locked_pushes_object_to_an_effect_that_predicts_them_worse_than_none():
    before = errors(1.5, 1.5)
    tilted = ((TILT,), learned(TILT, down_x=(0.01, 0.02), down_y=(-0.02, 0.01)), errors(1.45, 1.45))
    loose = ((MASS,), learned(MASS, share=(0.1, 0.23)), errors(1.55, 1.55))
    assert list(objections({"table_tilt": tilted, "loose_mass": loose}, False, before)) == ["loose_mass"]


def test_a_rival_that_something_speaks_against_leaves_the_set():
    names = ("table_tilt", "loose_mass")
    rivals = tuple(SimpleNamespace(effects=(effect,)) for effect in (TILT, MASS))
    both = outcomes.one_of(rivals)
    assert (both.verdict, both.effects) == ("ambiguous", names)
    screening = SimpleNamespace(candidates=(PROBES[0],), gain=np.array([9.0]))

    def left(**objections):
        return outcomes.without_those_objected_to(both, objections, None, screening)

    assert left() is both
    weak, null = Objection("not better"), Objection("holds null")
    off, behind = Objection("stays off"), Objection("far behind")
    one = left(table_tilt=weak)
    assert (one.verdict, one.effects) == ("effect", ("loose_mass",))
    assert one.objections == {"table_tilt": "the locked pushes are not clearly predicted better with it"}
    none = left(table_tilt=weak, loose_mass=null)
    assert (none.verdict, none.effects, none.rivals) == ("undecided", (), ())
    assert "table_tilt or loose_mass" in none.sentence
    assert "better with table_tilt, and the 90 % interval of loose_mass is consistent" in none.sentence
    three = {"table_tilt": weak, "tether": weak, "loose_mass": null}
    said = left(**three).sentence
    assert "not clearly predicted better with table_tilt or tether, and the 90 % interval of loose" in said
    far = left(table_tilt=off, loose_mass=off)
    assert (far.verdict, far.depends_on is None) == ("unknown", False)
    assert "would explain something, but" in far.sentence and "with either as without" in far.sentence
    described = left(table_tilt=behind, loose_mass=behind)
    assert described.verdict == "unknown"
    assert "would explain much, but with either, the" in described.sentence
    assert "but with table_tilt, the locked pushes" in left(table_tilt=behind, loose_mass=null).sentence
    held = left(table_tilt=null, loose_mass=null)
    assert "but the 90 % interval of either is consistent" in held.sentence


@pytest.mark.parametrize(
    ("misfit", "far"),
    [
        ((1.4, 1.5, 1.6), False),
        ((1.4, 1.4, 12.0), False),
        ((9.0, 11.0, 35.0), True),
        ((9.0, 11.0, 35.0, 1e3, 0.0), True),  # one push touched nothing
    ],
)
def test_a_typical_misfit_far_above_the_noise_is_not_adequate(misfit, far):
    found = far_above_noise(np.array(misfit))
    assert (found is not None) is far
    if far:
        said = outcomes.far_off(None, found)
        assert said.verdict == "undecided" and "not adequate" in said.sentence and "15 times" in said.sentence


def made_inquiry(monkeypatch, gain, found=(), misfit=1.5, fault=None, vanishes=False, refitted=1000.0):
    """An inquiry in which the largest gain is `gain` nats and no single effect is accepted."""
    candidates = (LIBRARY[0], PROBES[0])
    first = SimpleNamespace(candidates=candidates, gain=np.array([1.0, gain]))
    inquiry = object.__new__(steps.Inquiry)
    base, plain = (SimpleNamespace(likelihood=SimpleNamespace(error=of)) for of in ("base", "best refit"))
    refits = SimpleNamespace(plain=plain, fits={"some": None}, gains={"some": refitted}, order=["some"])
    monkeypatch.setattr(steps, "refit_candidates", lambda *arguments, **options: refits)
    for name, value in {
        "rules": SimpleNamespace(
            missing=lambda screening: True, vanishes=lambda screening, gains: vanishes
        ),
        "_nothing_found": lambda: outcomes.nothing_missing(None),
        "fitter": None, "base": base, "effects": (), "scene": None, "draws": 0, "report": print,
        "fault": fault,
        "accepted": [], "unseen": None, "only_a_trace": False, "_ask_every_effect": lambda: first,
        "_found_better_base": lambda: False,
        "_disagreement": lambda: None, "misfit": lambda fitted=None: np.array([misfit]),
        "left": {"some": Remainder(None, 0.0, None, True)},
        "_ask_what_is_left": lambda: None, "rest": {"some": first}, "_pairs": lambda rest: list(found),
    }.items():  # fmt: skip
        setattr(inquiry, name, value)
    return inquiry


def verdict(*arguments, **options):
    return made_inquiry(*arguments, **options).run()


@pytest.mark.parametrize(("gain", "said"), [(15.0, "undecided"), (40.0, "undecided"), (60.0, "unknown")])
def test_only_a_clear_finding_is_called_unknown(monkeypatch, gain, said):
    assert verdict(monkeypatch, gain).verdict == said


@pytest.mark.parametrize(
    ("on_top", "said"),
    [(None, "explains. It behaves"), (LIBRARY[1].name, f"but {LIBRARY[1].name} on top gains 133 more. What"),
     (PROBES[0].name, "Nearest comes some (6963 nats when refitted). What is left then behaves like this")],
)  # fmt: skip
def test_the_unknown_is_told_with_the_effect_that_comes_nearest(monkeypatch, on_top, said):
    """Two effects of the library together must not be called one that it lacks, without a word on them."""
    inquiry = made_inquiry(monkeypatch, 60.0, refitted=6963.0)
    inquiry.effects, inquiry.left = LIBRARY[:2], {"some": Remainder(on_top, 133.0, 0.01, False)}
    assert said in inquiry.run().sentence


def test_a_finding_that_vanishes_and_leaves_nothing_clear_is_adequate(monkeypatch):
    inquiry = made_inquiry(monkeypatch, 15.0, vanishes=True, refitted=22.0)
    assert inquiry.run().verdict == "adequate"
    assert inquiry.error == "base"  # that of the answer, not of the effect that was refitted
    assert verdict(monkeypatch, 15.0, vanishes=True, refitted=60.0).verdict == "undecided"


def test_pushes_that_are_missed_by_far_do_not_show_too_little(monkeypatch):
    assert "too faint" in verdict(monkeypatch, 15.0).sentence
    assert "not adequate" in verdict(monkeypatch, 15.0, misfit=40.0).sentence


@pytest.mark.parametrize(
    ("gain", "locked", "said"),
    [(15.0, 1.1, "adequate"), (15.0, 1.4, "undecided"), (40.0, 1.1, "undecided"), (60.0, 1.1, "unknown")],
)
def test_a_trace_that_locked_pushes_do_not_show_is_adequate(monkeypatch, gain, locked, said):
    inquiry = made_inquiry(monkeypatch, gain)
    assert inquiry.in_view_of(np.full(8, locked), inquiry.run()).verdict == said


def test_only_locked_pushes_make_a_trace_adequate(monkeypatch):
    inquiry = made_inquiry(monkeypatch, 15.0, misfit=1.0)
    assert inquiry.in_view_of(None, inquiry.run()).verdict == "undecided"
    named = outcomes.one_of([SimpleNamespace(effects=(LIBRARY[0],))])
    assert inquiry.in_view_of(np.ones(8), named) is named


def test_locked_pushes_missed_by_far_are_not_adequate(monkeypatch):
    inquiry = made_inquiry(monkeypatch, 15.0)
    said = inquiry.in_view_of(np.full(8, 15.0), outcomes.nothing_missing(None))
    assert "not adequate" in said.sentence
    inquiry.unseen = "3 pushes"
    blind = outcomes.nothing_visible(inquiry.base, "3 pushes")
    said = inquiry.in_view_of(np.full(8, 15.0), blind)
    assert "by 15 times" in said.sentence and "3 pushes could not show why" in said.sentence
    assert inquiry.in_view_of(np.full(8, 1.5), blind) is blind
    assert inquiry.in_view_of(np.full(8, 4.0), blind) is blind  # few pushes leave the maps open
    inquiry.misfit = lambda: np.array([4.0])
    assert "could not show why" in inquiry.in_view_of(np.full(8, 4.0), blind).sentence


@pytest.mark.parametrize(("with_it", "most"), [(5.0, True), (30.0, False)])
def test_an_effect_that_explains_most_though_something_remains_is_told(monkeypatch, with_it, most):
    inquiry = made_inquiry(monkeypatch, 15.0)
    inquiry.left = {"some": SimpleNamespace(rejected_by="another")}
    inquiry.refits = SimpleNamespace(fits={"some": object()}, order=["some"], gains={})
    inquiry.first = SimpleNamespace(by_name={"some": 33.0})
    inquiry.rules = SimpleNamespace(beyond_chance=lambda screening, gain: gain > 8)
    monkeypatch.setattr(inquiry, "misfit", lambda fitted=None: np.array([with_it if fitted else 40.0]))
    said = inquiry._too_faint()
    assert (said.verdict, said.effects, said.rivals) == ("undecided", (), ())
    assert ("some explains most of it (with it, 5.0 times), but something remains" in said.sentence) is most
    assert ("no effect that was tried" in said.sentence) is not most


def test_records_that_contradict_themselves_come_first(monkeypatch):
    found = verdict(monkeypatch, 90.0, [pair(0, 2)], misfit=40.0, fault="12 mm deep: is theta's sign right?")
    assert found.verdict == "undecided" and found.effects == () and "theta's sign" in found.sentence
    # What is met to the noise cannot be so wrong.
    assert verdict(monkeypatch, 90.0, [pair(0, 2)], fault="12 mm deep").effects == names(0, 2)


def pair(first, second):
    return SimpleNamespace(effects=(LIBRARY[first], LIBRARY[second]))


def names(*indices):
    return tuple(LIBRARY[i].name for i in indices)


def test_a_pair_is_named_though_neither_gains_much_alone(monkeypatch):
    """Two effects may hide each other from the first question, which asks for one."""
    outcome = verdict(monkeypatch, 40.0, [pair(0, 1)])
    assert (outcome.verdict, outcome.together) == ("effect", True)
    assert outcome.effects == names(0, 1)


def test_the_same_pair_found_twice_is_one(monkeypatch):
    assert verdict(monkeypatch, 90.0, [pair(1, 0), pair(0, 1)]).effects == names(1, 0)


def test_pairs_that_explain_as_much_are_not_told_apart(monkeypatch):
    outcome = verdict(monkeypatch, 90.0, [pair(0, 2), pair(1, 2)])
    assert (outcome.verdict, outcome.together) == ("ambiguous", False)
    assert outcome.effects == names(0, 2, 1)
    assert len(outcome.rivals) == 2


@pytest.mark.parametrize(
    ("far", "near", "kept"),
    [
        (2192.0, 2169.0, ["far", "near"]),
        (2192.0, 2100.0, ["far"]),
        (100.0, 91.0, ["far"]),
        (100.0, 93.0, ["far", "near"]),
    ],
)
def test_what_leaves_nothing_beats_what_explains_clearly_less(far, near, kept):
    left = {"far": Remainder(None, 1.0, None, True), "near": Remainder(None, 20.0, None, False)}
    assert not_outdone(["far", "near"], left, {"far": far, "near": near}, ALIKE) == kept


def test_what_explains_less_stays_where_it_leaves_nothing_either():
    left = {name: Remainder(None, 1.0, None, True) for name in ("far", "near")}
    assert not_outdone(["far", "near"], left, {"far": 100.0, "near": 70.0}, ALIKE) == ["far", "near"]


@pytest.mark.parametrize(
    ("gain", "predicts", "joins"), [(1519.0, 52.8, True), (1519.0, 18.0, False), (1390.0, 52.8, False)]
)
def test_what_leaves_a_little_joins_where_it_predicts_better(gain, predicts, joins):
    found = with_better_predictors(
        ["tether"], {"tether": 1562.0, "table_tilt": gain}, {"tether": 18.9, "table_tilt": predicts}
    )
    assert found == (["tether", "table_tilt"] if joins else ["tether"])


def test_few_nats_separate_no_faint_effects():
    """Errors of grid, contact and outline gain as much for an effect with more parameters."""
    for gain, names in ((55.0, ["tether", "table_tilt"]), (44.0, ["tether"])):  # 10 and 21 nats less
        found = with_better_predictors(
            ["tether"], {"tether": 65.0, "table_tilt": gain}, {"tether": 16.8, "table_tilt": 17.6}
        )
        assert found == names
    # What gains to first order and not when refitted is no effect.
    gone = with_better_predictors(["a"], {"a": 21.0, "b": 1.5}, {"a": 20.5, "b": 20.6})
    assert gone == ["a"]


def test_a_closer_fit_does_not_beat_what_predicts_better():
    left = {"far": Remainder(None, 5.0, None, True), "near": Remainder(None, 13.0, None, False)}
    gains = {"far": 1132.0, "near": 1107.0}
    assert not_outdone(["far", "near"], left, gains, {"far": 20.0, "near": 51.0}) == ["far", "near"]
    assert not_outdone(["far", "near"], left, gains, {"far": 51.0, "near": 20.0}) == ["far"]


@pytest.mark.parametrize(
    ("left", "own", "rejected"),
    [
        (31.7, 2574.0, True),  # a magnet taken for a patch of friction
        (28.6, 976.0, True),
        (18.2, 1699.0, False),  # the true effect, whose exact form differs
        (20.1, 1889.0, False),
        (22.0, 1100.0, False),
        (26.0, 1100.0, True),
        (107.0, 23579.0, False),
        (11.4, 382.0, False),
        (18.0, 382.0, True),
        (7.9, 60.0, False),
    ],
)
def test_what_is_left_rejects_by_its_share_and_by_its_size(left, own, rejected):
    rest = SimpleNamespace(candidates=(LIBRARY[0], PROBES[0]), gain=np.array([1.0, left]))
    said = Rules(LIBRARY, simulated=False).remainder(rest, own)
    assert said.rejected_by == (PROBES[0].name if rejected else None)
    assert said.gain == left


@pytest.mark.parametrize(
    ("gain", "refitted", "by_chance", "how"),
    [
        (30.0, 40.0, 1.0, "stands"),
        (15.0, 40.0, 1.0, "faintly"),
        (15.0, 40.0, 16.0, ""),
        (15.0, 25.0, 1.0, ""),
    ],
)
def test_a_faint_finding_is_left_to_the_locked_pushes(gain, refitted, by_chance, how):
    effect, rules = LIBRARY[0], Rules(LIBRARY, simulated=True)
    chance = np.full((1, 199), by_chance)
    first = Screening((effect,), np.array([gain]), np.zeros(1), chance, chance, np.ones(1))
    assert rules.stands(first, effect.name, refitted) is (how == "stands")
    assert how == "stands" or rules.stands_faintly(first, effect.name, refitted) is (how == "faintly")
    # Two pushes of which one is hardly helped: that may be chance.
    before, after = errors(4.0, 4.0), errors(1.0, 3.9)
    assert locked_pushes_object(True, before, after) and not locked_pushes_object(False, before, after)


@pytest.mark.parametrize(
    ("gains", "probe", "vanishes"),
    [
        ((0.0, 22.0), 1.0, True),  # the second gains no more than chance to first order
        ((6.0, 0.0), 1.0, False),
        ((0.0, 0.0), 30.0, False),  # a probe's gain, which is not refitted, stays
        ((0.0, 0.0), 15.0, True),  # unless it may come from errors of grid and contact
    ],
)
def test_a_gain_that_a_refit_does_not_find_again_does_not_count(gains, probe, vanishes):
    effects, rules = LIBRARY[:2], Rules(LIBRARY, simulated=True)
    chance = np.full((3, 199), 7.0)
    first = Screening(
        (*effects, PROBES[0]), np.array([10.0, 5.0, probe]), np.zeros(3), chance, chance, np.ones(3)
    )
    assert rules.missing(first)
    refitted = {effect.name: gain for effect, gain in zip(effects, gains, strict=True)}
    assert rules.vanishes(first, refitted) is vanishes
    assert not rules.vanishes(first, {})  # not refitted


def pair_inquiry(monkeypatch, gains, alone, tried=LIBRARY[1:2], complete=(True,), left=(1.2,)):
    """An inquiry in which a first effect gains `alone` nats, and a pair with each tried one `gains`.

    Whether a pair completes the explanation, and its misfit in units of noise, are given by turns.
    """
    inquiry = object.__new__(steps.Inquiry)
    first = SimpleNamespace(cost=1000.0 - alone, effects=LIBRARY[:1])
    made = [
        SimpleNamespace(cost=1000.0 - gain, effects=(*LIBRARY[:1], effect), misfit=misfit)
        for gain, effect, misfit in zip(gains, tried, left, strict=True)
    ]
    turns = iter(complete)
    asked = []

    def pairs(fitter, fitted, screening, effects, scene):
        asked.append(screening)
        yield from (pair for pair in made if pair.effects[-1] in effects and pair.on_top is screening)

    for pair in made:
        pair.on_top, pair.screening = "first", f"pair with {pair.effects[-1].name}"
    monkeypatch.setattr(steps, "pairs", pairs)
    for name, value in {
        # Under its own error model, the cost of the model without effects says nothing.
        "base": SimpleNamespace(cost=-500.0), "fitter": None, "effects": LIBRARY, "scene": None,
        "refits": SimpleNamespace(
            plain=SimpleNamespace(cost=1000.0), gains={"some": alone, LIBRARY[0].name: alone},
            fits={"some": first, LIBRARY[0].name: first, "another": first},
        ),
        "report": print, "asked": asked, "made": made,
        "rules": SimpleNamespace(completes=lambda rest, first, second: next(turns)),
        "_screen": lambda pair: pair.screening,
        "misfit": lambda fitted: np.array([getattr(fitted, "misfit", 30.0)]),
    }.items():  # fmt: skip
        setattr(inquiry, name, value)
    return inquiry


@pytest.mark.parametrize(("together", "named"), [(60.0, 0), (120.0, 1)])
def test_a_pair_has_to_gain_much_together(monkeypatch, together, named):
    inquiry = pair_inquiry(monkeypatch, [together], 30.0)
    assert len(inquiry._pairs({"some": "first"})) == named


def test_what_gains_on_top_of_a_pair_is_tried_in_its_place(monkeypatch):
    """A force that is mirrored and turned looks like unequal gains, until these are added."""
    inquiry = pair_inquiry(
        monkeypatch, [120.0, 400.0], 30.0, LIBRARY[1:3], complete=(False, True), left=(1.2, 1.2)
    )
    inquiry.made[1].on_top = inquiry.made[0].screening
    assert inquiry._pairs({"some": "first"}) == [inquiry.made[1]]
    assert inquiry.asked == ["first", inquiry.made[0].screening]


@pytest.mark.parametrize(
    ("gain_on_top", "first_misfit", "pair_gain", "pair_misfit", "named"),
    [
        (149.0, 2.0, 200.0, 1.2, True),  # much gains on top of 27 000 nats
        (20.0, 2.0, 200.0, 1.2, False),
        (20.0, 30.0, 200.0, 1.2, True),  # little, but pushes are missed by far
        (20.0, 30.0, 200.0, 20.0, False),  # and still are
        (5.0, 30.0, 200.0, 1.2, False),
    ],
)
def test_one_effect_that_leaves_much_is_named_with_a_second(
    monkeypatch, gain_on_top, first_misfit, pair_gain, pair_misfit, named
):
    name = LIBRARY[0].name
    inquiry = pair_inquiry(monkeypatch, [27000.0 + pair_gain], 27000.0, left=[pair_misfit])
    inquiry.refits.fits[name].misfit = first_misfit

    def found(screening, floor, probe_floor):
        return 0 if gain_on_top > floor else None

    inquiry.rules.found = found
    inquiry.accepted, inquiry.rest = [name], {name: "first"}
    said = inquiry.second_beside_first(list)
    assert (said is not None and said.together) is named
    inquiry.accepted = [name, "another"]  # on top of which nothing was tried
    assert inquiry.second_beside_first(list) is None


@pytest.mark.parametrize(
    ("misfit", "first", "two", "named"),
    [
        (30.0, 0, True, "theirs"),
        (30.0, 0, False, None),  # although much gains on top, and a pair would halve the misfit
        (30.0, 2, True, "own"),  # of another first effect
        (2.0, 0, True, "own"),  # near the noise, the strict fit decides
    ],
)
def test_where_pushes_are_missed_by_far_a_forgiving_fit_decides_on_a_second(
    monkeypatch, misfit, first, two, named
):
    name = LIBRARY[0].name
    inquiry = pair_inquiry(monkeypatch, [27200.0], 27000.0)
    inquiry.refits.fits[name].misfit = misfit
    inquiry.rules.found = lambda screening, floor, probe_floor: 0
    inquiry.accepted, inquiry.rest = [name], {name: "first"}
    pair = outcomes.two_at_once([SimpleNamespace(effects=(LIBRARY[first], LIBRARY[3]))])
    single = outcomes.one_of([SimpleNamespace(effects=(LIBRARY[first],))])
    said = inquiry.second_beside_first(lambda: [pair, single] if two else [single])
    expected = {"theirs": pair, "own": outcomes.two_at_once(inquiry.made[:1]), None: None}[named]
    assert (said is None) if expected is None else said.effects == expected.effects


@pytest.mark.parametrize(
    ("left", "first", "second", "complete"),
    [(10.0, 300.0, 250.0, True), (40.0, 300.0, 250.0, False), (40.0, 10696.0, 400.0, True),
     (40.0, 10696.0, 150.0, False), (60.0, 10696.0, 400.0, False), (0.0, 300.0, 15.0, False)],
)  # fmt: skip
def test_a_pair_may_leave_what_its_first_effect_leaves_by_itself(left, first, second, complete):
    chance = np.full((1, 199), 5.0)
    rest = Screening(LIBRARY[:1], np.array([left]), np.zeros(1), chance, chance, np.ones(1))
    assert Rules(LIBRARY, simulated=True).completes(rest, first, second) is complete


@pytest.mark.parametrize(("error", "words"), [(0.1, "about 10 % of"), (0.25, "25 % or more of")])
def test_the_largest_model_error_that_is_tried_may_be_larger(error, words):
    base = SimpleNamespace(likelihood=SimpleNamespace(error=SimpleNamespace(motion=error)))
    assert f"large, {words} the distance moved" in outcomes.scatter(base).sentence
