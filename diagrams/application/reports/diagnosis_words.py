"""Diagnoses in words and tables, for terminal and report: of one dataset, of several, and of a running robot.

Drake is imported only for words about a robot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import TYPE_CHECKING

import click
import numpy as np

from slipmap.diagrams.application.reports.comparison_words import listed, millimetres
from slipmap.diagrams.application.terminal import counted, paragraph, table
from slipmap.models.effects.effect import Effect
from slipmap.models.effects.probes import PROBES
from slipmap.models.inference.diagnosis.locked import turned
from slipmap.models.inference.diagnosis.results import (
    CandidateResult,
    DatasetResult,
    Diagnosis,
    JointCandidate,
    JointDiagnosis,
    JointIdentification,
)
from slipmap.models.inference.diagnosis.several import EVIDENCE
from slipmap.models.inference.diagnosis.verdict_rules import LEVEL, QUICK_GAIN, ROUGH, SHRUNK, far_above_noise
from slipmap.models.inference.effect_words import effect_in_words, in_the_middle, parameter_rows
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import FloatArray

if TYPE_CHECKING:
    from slipmap.diagrams.systems.diagnosis import Finding, Repair
    from slipmap.diagrams.systems.model_monitor import Judged, Watch

QUICK = (
    "A quick look: at most ten pushes, with larger steps. Chance was not simulated, so there are no"
    " p-values; gains are judged by a fixed threshold."
)


def before_label(diagnosis: Diagnosis) -> str:
    """Label of the model without the answer."""
    return "without effects" if diagnosis.effect_objects else "the model"


def after_label(diagnosis: Diagnosis) -> str:
    """Label of the best model."""
    return "with " + " and ".join(effect.name for effect in diagnosis.effect_objects)


def standing(candidate: CandidateResult, diagnosis: Diagnosis) -> str:
    """Whether a candidate is ruled out, and why."""
    if candidate.name in diagnosis.effects:
        others = [name for name in diagnosis.effects if name != candidate.name]
        if diagnosis.together and others:
            return f"needed, together with {', '.join(others)}"
        return "not ruled out"
    if candidate.rejected_by is not None:
        found = candidate.rejected_by
        left = candidate.remaining_gain
        gain = "" if left is None else f" gains {nats(left)} nats more"
        named = f"“{sentence}”" if (sentence := probe_sentence(found)) else found
        return f"{named} on top{gain}"
    for names, text in diagnosis.objections.items():
        if candidate.name in names.split(" and "):
            return text
    if candidate.fitted_gain is not None:
        best = max(c.fitted_gain for c in diagnosis.candidates if c.fitted_gain is not None)
        if candidate.fitted_gain < best:
            return f"explains {nats(best - candidate.fitted_gain)} nats less than the best"
        return _disagreed(diagnosis)
    if candidate.p_value is None:
        return "gains too little" if candidate.gain <= QUICK_GAIN else "behind the best in a short search"
    if candidate.p_value > LEVEL:
        return "gains no more than chance"
    return "far from the best" if diagnosis.effects else _disagreed(diagnosis)


def _disagreed(diagnosis: Diagnosis) -> str:
    """Why the candidate that explains most is not the answer although nothing was found on top of it."""
    if diagnosis.verdict == "undecided" and diagnosis.motion_error > ROUGH:
        alone = len(diagnosis.open_trials) == 1
        return "no other push to agree with" if alone else "the pushes do not agree on it"
    return "too weak in these pushes"


def probe_sentence(name: str) -> str:
    """What a probe models, in a clause; empty for other names."""
    for probe in PROBES:
        if probe.name == name:
            return f"{probe.sentence[0].lower()}{probe.sentence[1:].rstrip('.')}"
    return ""


def evidence(diagnosis: Diagnosis) -> str:
    """The evidence behind the verdict: the pushes, the p-value, and how to read gains."""
    count = len(diagnosis.open_trials)
    text = f"Based on {counted(count)}"
    every = sum(push.role == "fit" for push in diagnosis.without_effects.pushes)
    if every > count and not diagnosis.quick:
        text += f", drawn at random from {every}"
    if diagnosis.locked:
        count = len(diagnosis.locked)
        text += f"; {count} more {'was' if count == 1 else 'were'} locked away to test the answer"
    if diagnosis.p_value is not None:
        text += f". The largest gain has p = {p_shown(diagnosis.p_value)}, corrected for all candidates"
        if diagnosis.verdict == "adequate" and diagnosis.p_value <= LEVEL:
            clear = [c for c in diagnosis.candidates if c.p_value is not None and c.p_value <= LEVEL]
            # One that was dropped as far behind the best stands, as in `Rules.vanishes`.
            stands = any(c.fitted_gain is None or c.fitted_gain >= SHRUNK * c.gain for c in clear)
            text += (
                ", but the locked pushes are predicted to within the noise without any effect"
                if stands
                else ", but it does not stand when the effect is refitted"
            )
    return (
        f"{text}. Gain: natural logarithm (nats) of how much more probable an effect makes left-out pushes;"
        " 10 nats are a factor of 22,000. Refitted: how much more probable it makes the open pushes once"
        " everything is fitted again."
    )


def improvement(diagnosis: Diagnosis) -> str:
    """Errors on the locked pushes with and without the answer, in a sentence; empty where none was locked."""
    before, after = diagnosis.before, diagnosis.after
    if before is None or after is None:
        return ""
    count = len(diagnosis.locked)
    which = f"On {count} pushes that were locked away" if count > 1 else "On the push that was locked away"
    path, path_after, end, end_after = (
        f"{millimetres(float(e.mean()))} mm" for e in (before.path, after.path, before.final, after.final)
    )
    meaning = "(ADD: mean distance between the object's predicted and measured points)."
    if not diagnosis.effect_objects:
        along = "" if before.ends_only else f"{path} off on average along the path and "
        return f"{which}, the model is {along}{end} {'at' if along else 'off at'} the end {meaning}"
    with_it = after_label(diagnosis)
    told = (
        f"{path} off on average along the path {before_label(diagnosis)} and {path_after} {with_it}; at the"
        f" end, {end} and {end_after}"
    )
    if before.ends_only:
        told = f"{end} off at the end {before_label(diagnosis)} and {end_after} {with_it}"
    return f"{which}, the model is {told} {meaning}{_still_missed(with_it, after.misfit)}"


def _still_missed(model: str, misfits: FloatArray) -> str:
    """A sentence that begins with a space where the answer leaves the locked pushes far off; else empty.

    Args:
        model: with which effects, in words.
        misfits: (L,) of the locked pushes with them.
    """
    misfit = far_above_noise(misfits)
    if misfit is None:
        return ""
    return (
        f" Even {model}, the typical locked push is {misfit:.0f} times the sensor noise off:"
        " something else is missing too, the outline, the recording or the noise stated for it is wrong, or"
        " pushes scatter."
    )


def locked_table(diagnosis: Diagnosis) -> tuple[list[str], list[list[str]]]:
    """Labels of the models, and their errors on the locked pushes; no rows where none was locked."""
    names, models = ["the model"], [diagnosis.before]
    if diagnosis.effect_objects:
        names, models = [before_label(diagnosis), after_label(diagnosis)], [diagnosis.before, diagnosis.after]
    errors = [one for one in models if one is not None]
    rows = [
        ["along the path (ADD), mm", *(millimetres(float(e.path.mean())) for e in errors)],
        ["at the end (ADD), mm", *(millimetres(float(e.final.mean())) for e in errors)],
        ["misfit, times sensor noise (1 is best)", *(f"{e.total_misfit:.2f}" for e in errors)],
    ]
    if errors and errors[0].ends_only:
        rows = rows[1:]
    return names, rows if errors else []


def ranking(diagnosis: Diagnosis) -> list[list[str]]:
    """Name, gain, p, refitted gain, gain left on top and its p, and status of each candidate."""
    return [
        [
            candidate.name,
            nats(candidate.gain),
            p_shown(candidate.p_value),
            nats(candidate.fitted_gain),
            nats(candidate.remaining_gain),
            p_shown(candidate.remaining_p),
            standing(candidate, diagnosis),
        ]
        for candidate in diagnosis.candidates
    ]


def rivals_sentence(diagnosis: Diagnosis) -> str:
    """Which effects the pushes cannot rule out besides the first; empty where nothing needs saying."""
    if any(len(fitted.effects) > 1 for fitted in diagnosis.rivals[1:]):
        return ""  # The verdict's sentence lists the pairs.
    if diagnosis.verdict == "ambiguous":
        first, *others = diagnosis.effects
        return f"{first} fits best; the pushes cannot rule out {', '.join(others)}."
    if diagnosis.verdict == "effect":
        return "Every other effect that was tried is ruled out."
    return ""


def push_facts(push: Mapping[str, object]) -> list[tuple[str, str]]:
    """Names and values that a person needs to make the next push."""

    def pair(key: str) -> tuple[float, ...]:
        return tuple(float(value) for value in push[key])  # type: ignore[attr-defined]

    x, y, angle = pair("pose")
    facts = [
        ("put the object at", f"{_millimetre_pair((x, y))}, turned by {round(np.degrees(angle))}°"),
        ("touch it at", f"{_millimetre_pair(pair('contact'))} of the object"),
        ("direction", f"{float(push['direction_deg']):.0f}°"),  # type: ignore[arg-type]
        ("speed", f"{1e3 * float(push['speed']):.0f} mm/s"),  # type: ignore[arg-type]
        ("length", f"{1e3 * float(push['length']):.0f} mm after first touch"),  # type: ignore[arg-type]
        ("finger", f"from {_millimetre_pair(pair('tip_start'))} to {_millimetre_pair(pair('tip_end'))}"),
    ]
    if push["dwell"]:
        facts.append(("pause half-way", f"{float(push['dwell']):.1f} s"))  # type: ignore[arg-type]
    names = [str(name) for name in push["separates"]]  # type: ignore[attr-defined]
    facts.append(("distinguishes" if len(names) > 1 else "tests", ", ".join(names)))
    facts.append(("separation", f"{float(push['separation']):.1f} standard deviations"))  # type: ignore[arg-type]
    return facts


def _millimetre_pair(place: Sequence[float]) -> str:
    return f"x {round(1e3 * place[0])} mm, y {round(1e3 * place[1])} mm"


def nats(gain: float | None) -> str:
    """A gain, with tenths below 100; a dash where there is none."""
    if gain is None:
        return "–"
    text = f"{gain:.0f}" if abs(gain) >= 100 else f"{gain:.1f}"
    return "0.0" if text == "-0.0" else text


def p_shown(p: float | None) -> str:
    """A p-value from simulated datasets, a dash where none was simulated."""
    return "–" if p is None else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"


def tried(diagnosis: Diagnosis, effects: Sequence[Effect]) -> list[Effect]:
    """Those of some effects that the answer names, in its order."""
    by_name = {effect.name: effect for effect in effects}
    return [by_name[name] for name in diagnosis.effects if name in by_name]


def show_diagnosis(
    diagnosis: Diagnosis, dataset: PushDataset, effects: Sequence[Effect], where: str = "DATASET"
) -> None:
    """Print a diagnosis of a dataset; `effects` are all that were tried, `where` is the dataset's path."""
    paragraph(f"Verdict: {diagnosis.verdict}. {diagnosis.sentence}")
    for text in (*sizes(diagnosis, [dataset]), improvement(diagnosis), rivals_sentence(diagnosis)):
        paragraph(text)
    paragraph(QUICK if diagnosis.quick else "")
    if diagnosis.without_effects.share_of_known == 0.0:
        paragraph(
            "THE PUSHES CONTRADICT THE KNOWN MAPS: without effects, free maps explain them far better. If no"
            " effect above explains that, the maps given as known are wrong."
        )
    click.echo()
    table(
        f"Effects that were tried. {evidence(diagnosis)}",
        ["effect", "gain, nats", "p", "refitted, nats", "status"],
        [[*row[:4], row[-1]] for row in ranking(diagnosis)],
        numbers=(1, 2, 3),
    )
    rows = parameter_rows(tried(diagnosis, effects), diagnosis.parameters)
    if rows:
        table(f"Parameters of {', '.join(diagnosis.effects)}", PARAMETERS, rows, numbers=(1, 2))
    _show_locked(diagnosis)
    if diagnosis.next_push is not None:
        paragraph(f"Next push: {diagnosis.next_push['sentence']}")
    paragraph(f"Next: {diagnosis.next_step(where)}")


def _show_locked(diagnosis: Diagnosis) -> None:
    names, rows = locked_table(diagnosis)
    if not rows:
        paragraph("No push was locked away, so nothing tests the answer: record three pushes or more.")
        return
    title = f"Error on the {counted(len(diagnosis.locked), 'locked push')}"
    table(title, ["", *names], rows, numbers=range(1, 1 + len(names)))


def sizes(
    found: Diagnosis | JointDiagnosis | JointIdentification, datasets: Sequence[PushDataset]
) -> list[str]:
    """The name and size of each effect of the answer, or of those that several datasets share, in words."""
    told = []
    for name in found.effects:
        estimates = [p for p in found.parameters if p.effect == name]
        if estimates:
            words = effect_in_words(name, estimates, datasets[0].grid)
            told.append(f"{name}: {words}{in_the_middle(name, estimates, datasets)}.")
    return told


def joint_ranking(diagnosis: JointDiagnosis) -> list[list[str]]:
    """Name, first gain, p, refitted gain, evidence and status of each candidate."""
    return [
        [
            c.name,
            nats(c.first_gain),
            p_shown(c.p_value),
            nats(c.gain),
            nats(c.evidence),
            _joint_standing(c, diagnosis),
        ]
        for c in diagnosis.candidates
    ]


def _joint_standing(candidate: JointCandidate, diagnosis: JointDiagnosis) -> str:
    """Whether several datasets rule a candidate out, and why."""
    if candidate.in_set:
        others = [name for name in diagnosis.effects if name != candidate.name]
        return f"needed, together with {', '.join(others)}" if diagnosis.together else "not ruled out"
    if candidate.evidence is None:
        return candidate.objection or "behind others to first order"
    few = "explains too little" if candidate.evidence <= EVIDENCE else "others explain more"
    return candidate.objection or few


PARAMETERS = ("parameter", "value", "90 % interval", "meaning")
JOINT_RANKING = ("effect", "gain", "p", "refitted", "evidence", "status")
JOINT_DATASETS = ("dataset", "open", "locked", "without", "with", "fall", "fitted alone")

JOINT_GAINS = "Effects that were tried; gains and evidence in nats (natural logarithms of probability ratios)"
JOINT_ERRORS = (
    "Locked pushes of each dataset: error at the end without and with the answer, mm (ADD: mean distance"
    " between predicted and measured points), fall of their cost, nats, and fit to this dataset alone"
)


JOINT_BOUNDS = (
    "How large other effects could still be beside the answer (the first of several), to first order; where"
    " the pushes do not tell, the effect is left out"
)


def bound_rows(diagnosis: JointDiagnosis, effects: Sequence[Effect]) -> list[tuple[str, str, str, str]]:
    """Parameter, value, 90 % interval and meaning of every effect that is bounded."""
    return parameter_rows(effects, [bound for c in diagnosis.candidates for bound in c.bounds])


def joint_rows(datasets: Sequence[DatasetResult]) -> list[list[str]]:
    """Rows of a table with the columns `JOINT_DATASETS`."""
    rows = []
    for one in datasets:
        errors = ["–" if e is None else millimetres(float(e.final.mean())) for e in (one.before, one.after)]
        alone = ", ".join(f"{e.name} {e.value:.2g} ({e.low:.2g} to {e.high:.2g})" for e in one.alone)
        name = f"{one.name} (whole)" if one.whole else one.name
        pushes = str(len(one.open_trials)), str(len(one.locked))
        rows.append([name, *pushes, *errors, nats(one.fall), alone])
    return rows


def show_together(
    diagnosis: JointDiagnosis,
    datasets: Sequence[PushDataset],
    effects: Sequence[Effect],
    where: str = "DATASET...",
) -> None:
    """Print a joint diagnosis of datasets; `effects` are all that were tried, `where` names the datasets in a
    command."""
    paragraph(f"Verdict: {diagnosis.verdict}. {diagnosis.sentence}")
    for text in (*sizes(diagnosis, datasets), where_it_falls(diagnosis)):
        paragraph(text)
    paragraph(f"Next: {diagnosis.next_step(where)}")
    click.echo()
    table(JOINT_GAINS, JOINT_RANKING, joint_ranking(diagnosis), numbers=(1, 2, 3, 4))
    if rows := bound_rows(diagnosis, effects):
        table(JOINT_BOUNDS, PARAMETERS, rows, numbers=(1, 2))
    table(JOINT_ERRORS, JOINT_DATASETS, joint_rows(diagnosis.datasets), numbers=(1, 2, 3, 4, 5))


def joint_fit_findings(found: JointIdentification, datasets: Sequence[PushDataset]) -> list[str]:
    """The findings of a joint fit of datasets, one paragraph each."""
    first = f"{found.sentence} Evidence from the open pushes: {nats(found.evidence)} nats."
    return [first, *sizes(found, datasets), where_it_falls(found)]


def show_joint_fit(found: JointIdentification, datasets: Sequence[PushDataset]) -> None:
    """Print a joint fit of datasets."""
    for text in joint_fit_findings(found, datasets):
        paragraph(text)
    click.echo()
    table(JOINT_ERRORS, JOINT_DATASETS, joint_rows(found.datasets), numbers=(1, 2, 3, 4, 5))
    if text := errors_of_beliefs(found):
        paragraph(text)


def errors_of_beliefs(found: JointIdentification) -> str:
    """Errors of held-out pushes as predicted with the beliefs, in words; empty where none were held out."""
    errors = [f"{millimetres(error)} mm in {name}" for name, error in found.held_out_errors().items()]
    if not errors:
        return ""
    return (
        "The table judges single best maps. Predicted with the beliefs, held-out pushes end"
        f" {listed(errors)} off on average."
    )


_TURNS = ("better", "better by likelihood, though the ends are as far off,", "worse", "hardly differently")

_AS_FAR = 0.98
"""Share of the error at the end above which it counts as unchanged."""


def where_it_falls(found: JointDiagnosis | JointIdentification) -> str:
    """In which datasets the answer predicts the locked pushes better and in which worse, with the errors at
    the end; empty without an answer."""
    judging = [one for one in found.datasets if one.fall is not None]
    if not judging:
        return ""
    of_first, parts = " off at the end", []
    for how in _TURNS:
        named = []
        for one in (one for one in judging if _turn(one) == how):
            named.append(f"{one.name} ({_end_errors(one)} mm{of_first})")
            of_first = ""
        if named:
            parts.append(f"{how} in {listed(named)}")
    alternatives = isinstance(found, JointDiagnosis) and not found.together
    names = found.effects[0] if alternatives else " and ".join(found.effects)
    total = 0.0 if found.fall is None else found.fall
    turns = "rises" if total < 0.0 else "falls"
    missed = ""
    if isinstance(found, JointIdentification):  # the verdict of a diagnosis tells by itself what is left
        misfits = [one.after.misfit for one in judging if one.after is not None]
        missed = _still_missed(f"with {names}", np.concatenate(misfits))
    return (
        f"With {names}, the locked pushes are predicted {', '.join(parts)}. Their total cost {turns} by"
        f" {nats(abs(total))} nats.{missed}"
    )


def _turn(one: DatasetResult) -> str:
    """How the locked pushes of a dataset are predicted with an answer, one of `_TURNS`."""
    assert one.before is not None and one.after is not None and one.fall is not None
    better, as_far, worse, unaffected = _TURNS
    if turned(one.fall) != "better":
        return worse if turned(one.fall) == "worse" else unaffected
    return as_far if one.after.final.mean() > _AS_FAR * one.before.final.mean() else better


def _end_errors(one: DatasetResult) -> str:
    errors = [millimetres(float(e.final.mean())) for e in (one.before, one.after) if e is not None]
    return " → ".join(errors)


_DID = {
    "adopts": "From then on, the model included {effects}.",
    "keeps": "The model kept {effects}.",
    "drops": "The added effect was dropped: it did not explain the pushes after all.",
    "pushes on": "The robot made another push to find out.",
    "goes on without": "The robot continued with the model it had.",
}


def repair_story(repair: Repair, watch: Watch, explored: int | None = None) -> list[str]:
    """Sentences on each diagnosis and the action taken, then on how much the error fell.

    Args:
        explored: number of pushes to explore, if others towards the edge followed; None if none did.
    """
    if not repair.findings:
        return ["The model was not repaired: no push gave cause for a diagnosis."]
    said = [_finding(one, asks=explored is None or one.pushes < explored) for one in repair.findings]
    said += _widening(repair.findings[-1], watch.judged)
    if fall := _fall_of_error(repair, watch):
        said.append(f"{fall} Each push was predicted before it was made.")
    return said


def repair_headline(repair: Repair, watch: Watch, sizes: Mapping[str, str]) -> str:
    """Which effects a run added, how large they are, and how much the error fell; empty if it added none.

    Args:
        sizes: of the effects of the model, in words.
    """
    given = watch.judged[0].effects if watch.judged else ()
    added = [name for name in repair.effects if name not in given]
    if not added:
        return ""

    def sized(name: str) -> str:
        return f"{name} ({sizes[name]})" if name in sizes else name

    told = "; ".join(map(sized, added)) + (f" or {sized(repair.rival)}" if repair.rival else "")
    return f"The run added {told}. {_fall_of_error(repair, watch)}".rstrip()


def _fall_of_error(repair: Repair, watch: Watch) -> str:
    """The error of pushes before the model had its effects, and after; empty where there is only one."""
    from slipmap.diagrams.systems.diagnosis import has_model

    after = [push for push in watch.judged if has_model(push.effects, repair.effects, repair.rival)]
    before = [push for push in watch.judged if push not in after]
    if not (repair.effects and before and after):
        return ""
    return f"Before, {_errors(before)}; with {repair.model}, {_errors(after)}."


def _finding(finding: Finding, *, asks: bool) -> str:
    """What one finding says; `asks` is whether the pushes after it were chosen to find out more."""
    action = "goes on without" if finding.action == "pushes on" and not asks else finding.action
    did = _DID[action].format(effects=finding.model)
    from slipmap.diagrams.systems.diagnosis import CLOSE, FAILED, TRIED

    looked = "" if finding.verdict in (FAILED, TRIED, CLOSE) else ", diagnosis"
    said = f"After push {finding.pushes}{looked}: {finding.sentence} {did}"
    if not (finding.telling and asks):
        return said
    return f"{said} The next pushes were chosen to tell {finding.telling}."


def _widening(last: Finding, judged: Sequence[Judged]) -> list[str]:
    """How much wider intervals became, where the run ended with surprises that no effect explains."""
    before = [push.allowed for push in judged if push.trial < last.pushes]
    after = [push.allowed for push in judged if push.trial >= last.pushes]
    if last.verdict != "unknown" or last.action != "goes on without" or not before or not after:
        return []
    return [
        "What no effect explains counts as model error: pushes now count as surprising beyond"
        f" {1e3 * median(after):.1f} mm (median); before, beyond"
        f" {1e3 * before[-1]:.1f} mm."
    ]


def _errors(judged: Sequence[Judged]) -> str:
    off = 1e3 * median(push.error for push in judged)
    share = median(push.error / push.moved for push in judged)
    return (
        f"{counted(len(judged))} ended {off:.1f} mm off (median), {100 * share:.0f} % of how far they moved"
        " the object"
    )
