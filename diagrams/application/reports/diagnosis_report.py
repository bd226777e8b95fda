"""The HTML report of a diagnosis: verdict, ranking, locked pushes, next push, both models push by push."""

from collections.abc import Sequence
from html import escape

from slipmap.diagrams.application.figures import (
    alone_figure,
    gain_figure,
    joint_gain_figure,
    joint_locked_figure,
    locked_figure,
    telling_push_figure,
)
from slipmap.diagrams.application.reports import diagnosis_words as phrases
from slipmap.diagrams.application.reports.comparison_report import comparison_sections
from slipmap.diagrams.application.reports.comparison_words import finding
from slipmap.diagrams.application.reports.html_page import Section, page, part, picture, table
from slipmap.diagrams.application.terminal import counted
from slipmap.models.effects.effect import Effect
from slipmap.models.inference.comparison import Comparison, compare
from slipmap.models.inference.diagnosis.locked import with_locked
from slipmap.models.inference.diagnosis.results import Diagnosis, JointDiagnosis
from slipmap.models.inference.effect_words import effect_in_words, parameter_rows
from slipmap.models.measurements import PushDataset
from slipmap.models.progress import Progress, silent


def diagnosis_report(
    diagnosis: Diagnosis,
    dataset: PushDataset,
    effects: Sequence[Effect],
    where: str = "DATASET",
    progress: Progress | None = None,
) -> str:
    """The report, a whole HTML document.

    Args:
        effects: all that were tried.
        where: the dataset as a command takes it.
    """
    comparisons = compared(diagnosis, dataset, progress)
    report = progress or silent
    report("drawing", 0, 1)
    subtitle = (
        f"{counted(len(dataset.trials), 'measured push')} of {len(dataset.grid)} cells, {len(effects)}"
        f" effects tried in {diagnosis.seconds:.0f} s; seed {diagnosis.seed}"
    )
    lead = [
        *phrases.sizes(diagnosis, [dataset]),
        phrases.improvement(diagnosis),
        phrases.rivals_sentence(diagnosis),
    ]
    if not diagnosis.effects:
        lead.append(finding(comparisons[0]))
    lead.append(f"Next: {diagnosis.next_step(where)}")
    sections = []
    if diagnosis.effects:
        sections.append(_answer_section(diagnosis, dataset, phrases.tried(diagnosis, effects)))
    elif diagnosis.depends_on is not None:
        sections.append(_unknown_section(diagnosis))
    sections.append(_ranking_section(diagnosis))
    if diagnosis.before is not None:
        sections.append(_locked_section(diagnosis))
    if diagnosis.next_push is not None:
        sections.append(_next_push_section(diagnosis, dataset))
    sections += comparison_sections(comparisons, with_locked(dataset, diagnosis.locked))
    sections.append(Section("reading", "How to read the diagnosis", part("diagnosis.html")))
    lead = [paragraph for paragraph in lead if paragraph]
    title = f"{dataset.name}: what does the model miss?"
    text = page(title, subtitle, lead, sections, headline=diagnosis.sentence)
    report("drawing", 1, 1)
    return text


def joint_report(
    diagnosis: JointDiagnosis, datasets: Sequence[PushDataset], effects: Sequence[Effect], where: str
) -> str:
    """The report of a joint diagnosis, a whole HTML document; arguments as in `diagnosis_report`."""
    count = sum(len(dataset.trials) for dataset in datasets)
    subtitle = (
        f"{count} measured pushes of {len(datasets)} datasets, {len(effects)} effects tried in"
        f" {diagnosis.seconds:.0f} s; seed {diagnosis.seed}"
    )
    lead = [
        *phrases.sizes(diagnosis, datasets),
        phrases.where_it_falls(diagnosis),
        f"Next: {diagnosis.next_step(where)}",
    ]
    sections = []
    for name in diagnosis.effects if diagnosis.together else diagnosis.effects[:1]:
        own = [p for p in diagnosis.parameters if p.effect == name]
        sentence = next(effect.sentence for effect in effects if effect.name == name)
        body = f"<p>{escape(sentence)}</p>"
        if own:
            body += table(phrases.PARAMETERS, parameter_rows(effects, own), numbers=(1, 2))
            body += picture(alone_figure(diagnosis.datasets, own), "Parameters from each dataset alone")
            body += '<p class="note">Dots and lines: from each dataset alone, with 90 % intervals. Band: from'
            body += " all datasets together.</p>"
        sections.append(Section(f"answer-{name}", f"What is missing: {name}", body))
    numbers = table(
        phrases.JOINT_RANKING, phrases.joint_ranking(diagnosis), numbers=range(1, 5),
        marked=[c.in_set for c in diagnosis.candidates],
    )  # fmt: skip
    drawn = picture(joint_gain_figure(diagnosis), "Gains of all candidates", wide=True)
    body = f"<p>{phrases.JOINT_GAINS}.</p>{drawn}<details><summary>All numbers</summary>{numbers}</details>"
    if rows := phrases.bound_rows(diagnosis, effects):
        body += f"<p>{phrases.JOINT_BOUNDS}.</p>{table(phrases.PARAMETERS, rows, numbers=(1, 2))}"
    sections.append(Section("ranking", "Every effect that was tried", body))
    body = table(
        phrases.JOINT_DATASETS, phrases.joint_rows(diagnosis.datasets), numbers=range(1, 6),
        caption=f"{phrases.JOINT_ERRORS}.",
    )  # fmt: skip
    if any(one.before is not None for one in diagnosis.datasets):
        drawn = picture(joint_locked_figure(diagnosis.datasets), "Error on the locked pushes of each dataset")
        body = f"{drawn}{body}"
    sections.append(Section("locked", "Locked pushes of each dataset", body))
    sections.append(Section("reading", "How to read the diagnosis", part("joint.html")))
    title = f"{', '.join(dataset.name for dataset in datasets)}: what does the model miss?"
    return page(title, subtitle, [text for text in lead if text], sections, headline=diagnosis.sentence)


def compared(
    diagnosis: Diagnosis, dataset: PushDataset, progress: Progress | None = None
) -> list[Comparison]:
    """Comparisons with all pushes of the model without effects, and of the best one where it differs."""
    pushes = with_locked(dataset, diagnosis.locked)
    models = [(phrases.before_label(diagnosis), diagnosis.without_effects)]
    if diagnosis.with_effects is not None:
        models.append((phrases.after_label(diagnosis), diagnosis.with_effects))
    return [
        compare(pushes, learned, seed=diagnosis.seed, label=label, progress=progress)
        for label, learned in models
    ]


def _answer_section(diagnosis: Diagnosis, dataset: PushDataset, effects: Sequence[Effect]) -> Section:
    parts = []
    for effect in effects:
        estimates = [p for p in diagnosis.parameters if p.effect == effect.name]
        parts.append(f"<h3>{escape(effect.name)}</h3><p>{escape(effect.sentence)}</p>")
        if estimates:
            words = effect_in_words(effect.name, estimates, dataset.grid)
            parts.append(f"<p><b>{escape(words[0].upper() + words[1:])}.</b></p>")
            columns = phrases.PARAMETERS
            parts.append(table(columns, parameter_rows([effect], estimates), numbers=(1, 2)))
    if len(effects) > 1 and not diagnosis.together:
        parts.append('<p class="note">Each of these explains the data by itself, with the size given.</p>')
    return Section("answer", "What is missing", "\n".join(parts))


def _unknown_section(diagnosis: Diagnosis) -> Section:
    text = str(diagnosis.depends_on)
    name, _, sentence = text.partition(": ")
    body = (
        "<p>No effect of the library, alone or in pairs, explains the remaining error. Of the flexible laws"
        f" that were tried, this one gains most: <b>{escape(sentence or name)}</b></p>"
        '<p class="note">The pictures below, under “Where it fails”, show the residuals of the model without'
        " effects against place, direction, speed, phase, time and order. You can write an effect of your own"
        " in a few lines and try it with <code>--effect-file</code>.</p>"
    )
    return Section("answer", "What remains unexplained", body)


def _ranking_section(diagnosis: Diagnosis) -> Section:
    columns = ["effect", "gain, nats", "p", "refitted, nats", "left on top, nats", "p of that", "status"]
    note = f'<p class="note">{escape(phrases.QUICK)}</p>' if diagnosis.quick else ""
    numbers = table(
        columns, phrases.ranking(diagnosis), numbers=range(1, 6),
        marked=[c.name in diagnosis.effects for c in diagnosis.candidates],
    )  # fmt: skip
    drawn = gain_figure(diagnosis)
    body = (
        f"<p>{escape(phrases.evidence(diagnosis))}</p>{note}"
        + picture(drawn, "Gains of all candidates", wide=len(drawn.axes) > 1)
        + f"<details><summary>All numbers</summary>{numbers}</details>"
    )
    return Section("ranking", "Every effect that was tried", body)


def _locked_section(diagnosis: Diagnosis) -> Section:
    names, rows = phrases.locked_table(diagnosis)
    numbers = table(["mean over pushes", *names], rows, numbers=range(1, 1 + len(names)))
    count = len(diagnosis.locked)
    which = "This push was" if count == 1 else f"These {count} pushes were"
    body = (
        f"<p>{which} set aside before anything was fitted, to test the answer.</p>"
        f'<div class="beside"><div>{picture(locked_figure(diagnosis), "Error of every locked push")}</div>'
        f"<div>{numbers}</div></div>"
    )
    return Section("locked", "Locked pushes", body)


def _next_push_section(diagnosis: Diagnosis, dataset: PushDataset) -> Section:
    push = diagnosis.next_push
    assert push is not None
    facts = "".join(
        f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in phrases.push_facts(push)
    )
    drawn = picture(
        telling_push_figure(push, diagnosis, dataset),
        "The next push, and where each model predicts its end",
        wide=True,
    )
    body = f'<p>{escape(str(push["sentence"]))}</p>{drawn}<dl class="facts">{facts}</dl>'
    return Section("next", "The next push", body)
