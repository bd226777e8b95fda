"""Answers of the open pushes before the locked ones; the models that judge them lack what is judged."""

from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from slipmap.models.effects import LIBRARY, Effect
from slipmap.models.inference.diagnosis import outcomes
from slipmap.models.inference.diagnosis.judging import Learning, judged, laws_beside
from slipmap.models.inference.friction_laws import LAW_EFFECTS
from slipmap.models.progress import silent

EFFECTS = {effect.name: effect for effect in LIBRARY}
TILT, TRANSFER = EFFECTS["table_tilt"], EFFECTS["load_transfer"]


@dataclass(frozen=True, eq=False)
class Model:
    """What a diagnosis needs of a fit."""

    effects: tuple[Effect, ...]
    cost: float = 0.0


def learned_with(effects, laws, shares, null):
    """Misfits of 5, times 0.3 where load shifts, and 0.7 on a slope."""
    shifting = TRANSFER in effects or "load_transfer" in laws
    misfit = 5.0 * (shares if shifting else 1.0) * (0.7 if TILT in effects else 1.0)
    by_law = "load_transfer" in laws and TRANSFER not in effects
    pushes = [
        SimpleNamespace(
            role=role, spread_misfit=0.0,
            errors=SimpleNamespace(mean_add=1e-3, final_add=1e-3, misfit=misfit * factor),
        )
        for role, factor in (("heldout", 0.95), ("heldout", 1.0), ("heldout", 1.05), ("fit", 1.0))
    ]  # fmt: skip
    intervals = {
        effect.name: {
            p.name: {"low": -1.0, "high": 1.0} if effect.name in null else {"low": 1.0, "high": 2.0}
            for p in effect.parameters
        }
        for effect in effects
    }
    return SimpleNamespace(
        laws=laws, pushes=pushes, effect_estimates=intervals,
        friction_laws={"load_transfer": 1.0} if by_law else {"plain": 1.0},
    )  # fmt: skip


class Case:
    """A learning whose calls are counted, and an inquiry that proposes single effects of pairs."""

    def __init__(self, shares=0.3, null=()):
        self.calls = []

        def learn(model, *, laws, report):
            effects = () if model is None else model.effects
            self.calls.append((tuple(effect.name for effect in effects), laws))
            return learned_with(effects, laws, shares, null)

        self.learning = Learning(learn, silent)
        self.tilted, self.shifting, self.both = Model((TILT,)), Model((TRANSFER,)), Model((TILT, TRANSFER))
        self.inquiry = SimpleNamespace(base=Model(()), first=None, without_needless=self._single)

    def _single(self, rivals, against):
        gone = {one.effect for one in against.values()}
        single = {TILT.name: self.tilted, TRANSFER.name: self.shifting}
        return [one for name, one in single.items() if name not in gone] if gone != {None} else []

    def judged(self, answer, firsts=(), rough=False):
        return judged(self.inquiry, self.learning, answer, firsts, rough)


def test_a_law_does_not_judge_the_effect_that_it_is():
    case = Case()
    (plain,) = case.learning.of([None], LAW_EFFECTS)
    assert plain.friction_laws == {"load_transfer": 1.0}
    answer, learned, tried = case.judged(outcomes.one_of([case.shifting]))
    assert answer.effects == ("load_transfer",) and list(tried) == [case.shifting]
    assert learned[0].laws == ("impulse_friction",)
    assert ((), ("impulse_friction",)) in case.calls


def test_nothing_is_learned_twice():
    case = Case()
    first = case.learning.of([None, case.tilted], LAW_EFFECTS)
    assert case.learning.of([case.tilted, None], LAW_EFFECTS) == first[::-1]
    assert len(case.calls) == 2
    # The law of leaning has no share, so that a model that may not have it is the same.
    assert case.learning.of([None], ("load_transfer",)) == first[:1] and len(case.calls) == 2
    case.learning.of([None], ("impulse_friction",))
    assert len(case.calls) == 3
    # What was never allowed is not known.
    case.learning.of([case.shifting], ())
    case.learning.of([case.shifting], LAW_EFFECTS)
    assert len(case.calls) == 5


@pytest.mark.parametrize("pair", [True, False])
def test_what_is_left_is_judged_with_the_laws_that_it_leaves(pair):
    """Of a pair whose second effect may be zero, and of a set in which one does not help, the tilt stays. The
    model that `fit` learns with it may have the law again."""
    case = Case(shares=0.99, null=("load_transfer",))
    both = outcomes.two_at_once([case.both]) if pair else outcomes.one_of([case.tilted, case.shifting])
    answer, learned, _ = case.judged(both)
    assert answer.effects == ("table_tilt",) and not answer.together
    assert [one.laws for one in learned] == [LAW_EFFECTS]
    assert laws_beside(answer.rivals) == LAW_EFFECTS
    assert list(answer.objections) == (["table_tilt and load_transfer"] if pair else ["load_transfer"])


def test_a_second_effect_is_judged_against_a_first_one_that_lacks_it():
    case = Case()
    first, _, tried = case.judged(outcomes.one_of([case.tilted]))
    assert first.effects == ("table_tilt",)
    second, learned, _ = case.judged(outcomes.two_at_once([case.both]), tried, True)
    assert second.effects == ("table_tilt", "load_transfer") and second.together
    assert learned[0].laws == ("impulse_friction",)
    # One that helps no more than the first alone is refused.
    useless = Case(shares=1.0)
    _, _, tried = useless.judged(outcomes.one_of([useless.tilted]))
    assert not useless.judged(outcomes.two_at_once([useless.both]), tried, True)[0].rivals
