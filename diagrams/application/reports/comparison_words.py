"""The findings of a comparison in words, for terminal and report."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import bdtrc

from slipmap.models.inference.comparison import Comparison, JointComparison, Totals
from slipmap.models.inference.end_region import LEVEL as LEVEL_INSIDE, beyond_in_millimetres
from slipmap.models.inference.prediction import Prediction
from slipmap.models.inference.push_errors import Errors, NoiseFloor
from slipmap.models.inference.residual_structure import LEVEL, WITH_ROTATION, Pattern
from slipmap.models.inference.sign_flips import smallest_p

ROLES = {"fit": "fit", "heldout": "held out"}
"""Roles of pushes in words."""

QUANTITIES = {"motion": "motion", "force": "force", "delay": "timing"}
"""Quantities of patterns in words."""

_NOISE = {
    "repeats": "repeated pushes scatter by",
    "declared noise": "sensor noise alone explains",
    "estimated noise": "the estimated sensor noise alone explains",
}


_EXPLAINED = {
    "repeats": "the spread of the hypotheses and the scatter of repeated pushes explain",
    "declared noise": "the spread of the hypotheses and the sensors' noise explain",
    "estimated noise": "the spread of the hypotheses and the sensors' noise, estimated from the poses,"
    " explain",
    "": "the spread of the hypotheses explains; the sensors' noise is not known, `noise:` in dataset.yaml"
    " declares it",
}
"""What errors are compared with, by the source of the noise."""


def short_name(trial: str) -> str:
    """`trials/003.json` as `003`, `day.csv#7` as `day#7`; a long name keeps its end, which tells it from
    others."""
    file, sign, push = trial.partition("#")
    name = file.rsplit("/", 1)[-1].rsplit(".", 1)[0] + sign + push
    return name if len(name) <= 24 else "…" + name[-23:]


def judged(comparison: Comparison) -> tuple[str, Totals]:
    """Role and totals that count: held-out pushes where there are any."""
    role = "heldout" if "heldout" in comparison.totals else "fit"
    return role, comparison.totals[role]


def summary(comparison: Comparison) -> str:
    """The model's error beside the baselines and the noise, in one or two sentences."""
    role, totals = judged(comparison)
    count = f"{totals.pushes} pushes" if totals.pushes > 1 else "the one push"
    which = f"On {count} that it {'never saw' if role == 'heldout' else 'learned from'}"
    if role == "fit" and comparison.learnt_from != comparison.dataset:
        which = f"On {count} of this dataset"
    average = " on average" if totals.pushes > 1 else ""
    text = (
        f"{which}, the model ends {millimetres(totals.model.final_add)} mm from the measured pose{average}"
        " (ADD: mean distance between the object's predicted and measured points); a uniform object ends"
        f" {millimetres(totals.uniform.final_add)} mm off, an object that does not move"
        f" {millimetres(totals.resting.final_add)} mm."
    )
    if comparison.floor is not None:
        text += f" For comparison, {_NOISE[comparison.floor.source]} {millimetres(comparison.floor.add)} mm."
    return text


MANY_TIMES = 5.0
"""Ratio of error to noise from which the error counts as the model's."""

MUCH_FARTHER = 2.0
"""Median ratio of error to spread over held-out pushes: 0.6 to 1.7 in nine recorded sets with a correct
model; 2.2 to 3.2 with hidden effects, and for real pushes that the maps do not explain."""

FEWEST_JUDGES = 3
"""Fewest held-out pushes for a statement about them together."""

NO_BETTER = 0.95
"""Share of a uniform object's error from which the maps are said to predict no better."""


def warning(comparison: Comparison, where: str = "DATASET") -> str:
    """A model no better than a uniform object, one that does not explain the pushes that taught it, or pushes
    that ended outside their regions beyond chance; empty where there is none of these.

    Args:
        where: the dataset, as a command takes it.
    """
    far_off, surprise = no_better_than_uniform(comparison), _surprises_of(comparison)
    own = comparison.learnt_from == comparison.dataset
    missed = unexplained(comparison.unexplained) if own else ""
    if not (far_off or missed or surprise.beyond_chance):
        return ""
    return " ".join(text for text in (far_off, missed, surprise.text, advice(where)) if text)


def doubts(comparison: Comparison) -> list[str]:
    """What a comparison without a `warning` says last: pushes that ended outside their regions though chance
    explains them, and errors of held-out pushes far beyond what the hypotheses allow."""
    if warning(comparison):
        return []
    held = [push for push in comparison.pushes if push.role == "heldout"]
    return [text for text in (_surprises_of(comparison).text, beyond_spread(held, comparison.floor)) if text]


def mean_error(comparison: Comparison, *, named: bool = False) -> str:
    """The mean error of the pushes that count, in a sentence.

    Args:
        named: whether to name the model.
    """
    role, totals = judged(comparison)
    which = {"heldout": "held-out ", "fit": "fitted " * (comparison.learnt_from == comparison.dataset)}[role]
    error = f"{millimetres(totals.model.final_add)} mm"
    text = (f"{which}pushes end {error} from their predicted ends on average").capitalize()
    if totals.pushes == 1:
        text = f"The {which}push ends {error} from its predicted end"
    return f"{text} ({comparison.label})." if named else f"{text}."


def advice(where: str) -> str:
    """What to do about a wrong model."""
    return f"`slipmap diagnose {where}` searches for the physical effect that the model misses."


def unexplained(share: float | None) -> str:
    """Sentence on a model that does not explain the pushes that taught it; empty where it does.

    Args:
        share: as `hypotheses.unexplained_share` gives it.
    """
    if share is None:
        return ""
    return (
        f"THE MODEL DOES NOT EXPLAIN THESE PUSHES: with the best maps, it is off by {100 * share:.0f} % or"
        " more of the distance moved."
    )


def no_better_than_uniform(comparison: Comparison) -> str:
    """Sentence on a model whose error is many times the noise and that of a uniform object; else empty."""
    role, totals = judged(comparison)
    ours, uniform, floor = totals.model.final_add, totals.uniform.final_add, comparison.floor
    if floor is None or not (ours > MANY_TIMES * floor.add and ours > NO_BETTER * uniform):
        return ""
    own = [push for push in comparison.pushes if push.role == role]
    apart = float(np.mean([push.spread for push in own]))
    ends = "that end" if len(own) == 1 else "these ends"
    cause = "The model is wrong."
    if excess(own, floor) <= MUCH_FARTHER:
        cause = (
            f"The hypotheses are {millimetres(apart)} mm apart at {ends}: the pushes may be too few to show"
            " the maps, or the model is wrong."
        )
    ratio = f"{ours / max(uniform, 1e-9):.2g}"
    beside = "as much as" if ratio == "1" else f"{ratio} times the error of"
    return (
        f"{_which_end(role, totals.pushes)} {millimetres(ours)} mm off:"
        f" {ours / max(floor.add, 1e-9):.0f} times what {_NOISE[floor.source]}, and {beside} a uniform"
        f" object, so the maps explain none of it. {cause}"
    )


def excess(pushes: Sequence[Prediction], floor: NoiseFloor | None) -> float:
    """Median ratio of the error to the spread of the hypotheses and the sensors' noise, where it is known."""
    expected = [np.hypot(push.spread, floor.add if floor else 0.0) for push in pushes]
    return float(np.median([push.final_add for push in pushes] / np.maximum(expected, 1e-6)))


def beyond_spread(held: Sequence[Prediction], floor: NoiseFloor | None) -> str:
    """Sentence on held-out pushes whose errors the spread of the hypotheses and the noise do not explain;
    empty where they do, or there are too few pushes."""
    if len(held) < FEWEST_JUDGES or (ratio := excess(held, floor)) <= MUCH_FARTHER:
        return ""
    return (
        f"The errors of held-out pushes are {ratio:.1f} times (median) what"
        f" {_EXPLAINED[floor.source if floor else '']}. The intervals assume that the model is right"
        " and do not cover this; `slipmap diagnose` looks for what it misses."
    )


def _which_end(role: str, count: int) -> str:
    """The start of a sentence on where pushes of a role end."""
    which = {"heldout": "held-out ", "fit": ""}[role]
    return f"the {which}push ends".capitalize() if count == 1 else f"{which}pushes end".capitalize()


@dataclass(frozen=True)
class Surprises:
    """Pushes that ended outside their 95 % regions, in words."""

    text: str  # empty where there is none
    beyond_chance: bool  # whether so many, or one so far out, are more than a correct model explains


def surprises(pushes: Sequence[Prediction], whose: str = "its") -> Surprises:
    """Which pushes ended outside their regions, how far, and whether chance explains that.

    Args:
        whose: prediction it is, such as `the final belief's`.
    """
    beyond_region = (push for push in pushes if push.surprising)
    found = sorted(beyond_region, key=lambda push: push.allowed_add - push.final_add)
    if not found:
        return Surprises("", beyond_chance=False)
    count, worst = len(pushes), found[0]
    rarest = min(push.rarity for push in found)
    so_many = float(bdtrc(len(found) - 1, count, 1.0 - LEVEL_INSIDE))
    beyond = so_many <= 1.0 - LEVEL_INSIDE + 1e-9 or rarest * count <= 1.0 - LEVEL_INSIDE
    error, allowed = beyond_in_millimetres(worst.final_add, worst.allowed_add)
    text = (
        f"push {short_name(worst.trial)} ended {error} mm from {whose} prediction;"
        f" {100 * LEVEL_INSIDE:.0f} % of such pushes should end within {allowed} mm."
    )
    if len(found) > 1:
        also = [short_name(push.trial) for push in found[1:]]
        if len(also) > 5:
            also[5:] = [f"{len(also) - 5} more"]
        text += (
            f" In all, {len(found)} of {count} pushes ended outside their 95 % regions (also {listed(also)})."
        )
    if not beyond:
        text += (
            f" With a correct model, {max(1.0, (1.0 - LEVEL_INSIDE) * count):.0f} of {count} pushes may end"
            " outside by chance."
        )
    start = "SURPRISING: " if beyond else "Surprising: "
    return Surprises(start + text, beyond)


def _surprises_of(comparison: Comparison) -> Surprises:
    role, _ = judged(comparison)
    return surprises([push for push in comparison.pushes if push.role == role])


def listed(names: Sequence[str]) -> str:
    """One name or more in a sentence, such as `a, b and c`."""
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last


def summary_of_two(before: Comparison, after: Comparison) -> str:
    """The errors of two models over the same pushes, in two sentences."""
    role, totals = judged(before)
    ours, theirs = totals.model, after.totals[role].model
    pushes = _pushes(totals.pushes, "held-out " if role == "heldout" else "fit ")
    along = f"; averaged along the path, it is {average(ours)} and {average(theirs)} mm"
    if average(ours) == "–":
        along = ""
    return (
        f"On {pushes}, the model “{before.label}” ends {millimetres(ours.final_add)} mm"
        f" from the measured pose on average, the model “{after.label}” {millimetres(theirs.final_add)} mm"
        f" (ADD: mean distance between the object's predicted and measured points){along}. A uniform object"
        f" ends {millimetres(totals.uniform.final_add)} mm off, an object that does not move"
        f" {millimetres(totals.resting.final_add)} mm."
    )


def finding(comparison: Comparison) -> str:
    """Whether the remaining error has a pattern, in one sentence."""
    found = comparison.significant
    if not found:
        if not comparison.testable:
            tests = len(comparison.structure)
            most = max((pattern.pushes for pattern in comparison.structure), default=0)
            return (
                f"{_pushes(most).capitalize()} cannot show whether the remaining error has a pattern: {tests}"
                f" tests need at least {pushes_needed(tests)} pushes."
            )
        text = "The remaining error shows no significant pattern above the negligible size"
        if warning(comparison):
            text = "No single condition explains the remaining error"
        most = max(pattern.pushes for pattern in comparison.structure)
        if smallest_p(most) * len(comparison.structure) > 0.1 * LEVEL:
            text += f", but {_pushes(most)} can show only very clear patterns"
        return f"{text}."
    *first, last = [sentence_part(pattern) for pattern in found[:4]]
    named = f"{'; '.join(first)}; and {last}" if first else last
    more = f" and {len(found) - 4} more" if len(found) > 4 else ""
    return f"The remaining error has a pattern: {named}{more}."


def findings(results: Sequence[Comparison]) -> list[str]:
    """The findings on one model, or on two over the same pushes, one paragraph each."""
    if len(results) == 1:
        return [summary(results[0]), finding(results[0])]
    return [summary_of_two(*results), *(f"{result.label}: {finding(result)}" for result in results)]


def joint_findings(found: JointComparison) -> list[str]:
    """The findings on several datasets, one paragraph each: the errors, and what several depend on."""
    last = [models[-1] for models in found.datasets]
    errors = {one.dataset: judged(one)[1].model.final_add for one in last}
    uniform = sum(judged(one)[1].uniform.final_add for one in last) / len(last)
    best, worst = min(errors, key=errors.__getitem__), max(errors, key=errors.__getitem__)
    mean = sum(errors.values()) / len(errors)
    which = f" {last[0].label}" if found.fitted is not None else ""
    text = (
        f"On the pushes that judge, the model{which} ends {millimetres(mean)} mm from the measured pose, mean"
        f" over {len(last)} datasets ({millimetres(errors[best])} in {best} to {millimetres(errors[worst])}"
        f" in {worst}; ADD: mean distance between the object's predicted and measured points); a uniform"
        f" object ends {millimetres(uniform)} mm off."
    )
    if found.fitted is not None:
        before = {one.dataset: judged(one)[1].model.final_add for one, *_ in found.datasets}
        worse = [name for name, error in errors.items() if error >= before[name]]
        text += (
            f" Without effects, the model ends {millimetres(sum(before.values()) / len(before))} mm off; with"
            " them, the error falls in "
        )
        if len(worse) == len(errors):
            text += "no dataset."
        else:
            text += f"{len(errors) - len(worse)} of {len(errors)} datasets"
            text += f", not in {', '.join(worse)}." if worse else "."
    recurring = [
        f"In {len(names)} of {len(last)} datasets ({', '.join(names)}): {sentence_part(pattern)}."
        for pattern, names in found.recurring
    ]
    if recurring:
        first = (
            "The remaining error depends on the same thing in several datasets (size and sign are those of"
            " the clearest dataset)."
        )
        said = " ".join([first, *recurring])
    else:
        said = "No pattern of the remaining error is significant in more than one dataset."
    return [text, said]


def sentence_part(pattern: Pattern) -> str:
    """One pattern as a clause, such as `the error of the force depends on the speed (19 %)`."""
    if pattern.quantity == "delay":
        late = "late" if pattern.size > 0 else "early"
        return f"measured poses come {abs(1e3 * pattern.size):.0f} ms {late}"
    thing, size = f"the {pattern.quantity}", f"{100 * abs(pattern.size):.2g} %"
    if pattern.factor == "overall":
        more = {
            "motion": ("the object moves farther", "the object moves less far"),
            "turning": ("the object turns farther", "the object turns less far"),
            "force": ("the force is larger", "the force is smaller"),
        }
        what = "turning" if WITH_ROTATION in pattern.strongest else pattern.quantity
        return f"{more[what][pattern.size < 0]} than predicted everywhere ({size})"
    if pattern.factor in ("table_drift", "object_drift"):
        return f"{thing} is off everywhere, {_turned(pattern)} ({size})"
    return f"the error of {thing} depends on the {pattern.title} ({size})"


def _turned(pattern: Pattern) -> str:
    """Direction of a drift, with its sign."""
    direction = pattern.strongest.replace("along ", "towards ")
    if pattern.size > 0:
        return direction.replace(" x", " +x").replace(" y", " +y")
    opposite = direction.replace(" x", " -x").replace(" y", " -y")
    return opposite.replace("counter-clockwise", "clockwise")


def size_text(pattern: Pattern) -> str:
    """Size with its 95 % interval, in ms or per cent."""
    if pattern.quantity == "delay":
        low, size, high = (1e3 * value for value in (pattern.low, pattern.size, pattern.high))
        return f"{size:+.0f} ms ({low:.0f} to {high:.0f})"
    low, size, high = (100 * value for value in (pattern.low, pattern.size, pattern.high))
    return f"{size:+.1f} % ({low:.1f} to {high:.1f})"


def p_text(p: float) -> str:
    """A probability with as many digits as matter."""
    return "below 0.001" if p < 0.001 else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"


def pushes_needed(tests: int) -> int:
    """Smallest number of pushes with which one of so many tests can become significant."""
    return next(pushes for pushes in itertools.count(1) if smallest_p(pushes) * tests < LEVEL)


def average(errors: Errors) -> str:
    """ADD over the course in millimetres; a dash where only ends were measured."""
    return "–" if errors.mean_add == errors.final_add else millimetres(errors.mean_add)


def millimetres(metres: float) -> str:
    """Hundredths of a millimetre below 1 mm, tenths from there."""
    value = 1e3 * metres
    return "–" if not math.isfinite(value) else f"{value:.2f}" if value < 1 else f"{value:.1f}"


def _pushes(count: int, kind: str = "") -> str:
    return f"one {kind}push" if count == 1 else f"{count} {kind}pushes"
