"""`slipmap check`: what is wrong with measured pushes, and what they could tell, before any fit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.terminal import Progress, note, paragraph, table
from slipmap.models.files import write_json, write_text

if TYPE_CHECKING:
    from slipmap.models.measurements import PushDataset
    from slipmap.models.measurements.dataset_check import DatasetCheck


@click.command()
@options.dataset_argument
@options.output_option(
    "-o", "--output", endings=("html", "htm"),
    about="A page with the findings and a picture of the pushes, for any browser.",
)  # fmt: skip
@options.object_option
@options.json_option
@click.pass_context
def check(
    context: click.Context,
    dataset: Path,
    output: Path | None,
    object_name: str | None,
    json_file: Path | None,
) -> None:
    """Say what is wrong with pushes, and what they could tell.

    Looks at rates, gaps, clocks, contact and forces of DATASET, and at which places, directions and speeds
    its pushes cover. Learns nothing. Exit code 1 where a finding would make results wrong.
    """
    from slipmap.models.measurements import read_dataset
    from slipmap.models.measurements.dataset_check import check_dataset

    with Progress() as progress:
        measured = read_dataset(
            dataset,
            object_name=object_name,
            progress=lambda done, total: progress("reading pushes", done, total),
            tell=lambda warning: None,
        )
        with progress.step("checking"):
            found = check_dataset(measured)
        if output is not None:
            write_text(output, _page(found, measured))
    write_json(json_file, found.to_json())
    _show(found, dataset)
    if output is not None:
        note(f"page: {output}")
    if found.wrong:
        context.exit(1)


_SIGNS = {"good": "", "note": "note", "wrong": "WRONG"}


def _show(found: DatasetCheck, where: Path) -> None:
    rows = [[finding.what, finding.found, _SIGNS[finding.verdict]] for finding in found.findings]
    table(f"{found.dataset}: what was measured", ["what", "found", ""], rows)
    for finding in found.findings:
        if finding.advice:
            end = "" if finding.advice.endswith("?") else "."
            paragraph(f"{finding.what}: {finding.advice}{end}")
    click.echo()
    for group, words in ((found.quantities, "quantities"), (found.effects, "effects")):
        could = [told.name for told in group if told.could]
        other = [f"{told.name} ({told.reason})" for told in group if not told.could]
        paragraph(f"These pushes could tell of {words}: {', '.join(could) or 'none'}.")
        if other:
            paragraph(f"They could not tell, for want of what stands in brackets: {', '.join(other)}.")
    _show_advice(found, where)


def _show_advice(found: DatasetCheck, where: Path) -> None:
    for wanted in found.advice:
        paragraph(f"Worth adding: {wanted}.")
    if found.advice:
        paragraph(
            "Record them and import all anew: slipmap import SOURCE... --setup setup.yaml -o"
            f" {where}. After a first belief `slipmap diagnose {where}` plans the push that tells most."
        )
    paragraph(
        "Something is WRONG: mend it first, or what is learned will be wrong."
        if found.wrong
        else f"Nothing is wrong. Next: slipmap identify {where} -o belief.npz"
    )


def _page(found: DatasetCheck, dataset: PushDataset) -> str:
    from slipmap.diagrams.application.figures import measured_figure
    from slipmap.diagrams.application.reports.html_page import Section, page, picture, table as html_table

    findings = html_table(
        ["what", "found", "verdict", "what to do"],
        [[one.what, one.found, one.verdict, one.advice] for one in found.findings],
        marked=[one.verdict == "wrong" for one in found.findings],
    )
    told = "".join(
        html_table(
            [name, "", "by"],
            [[one.name, "could be told" if one.could else "no", one.reason] for one in group],
        )
        for name, group in (("quantity", found.quantities), ("effect", found.effects))
    )
    sections = [
        Section("findings", "What was found", findings),
        Section(
            "pushes",
            "The pushes",
            picture(measured_figure(dataset), "pushes on the table, contact gap and force over time"),
        ),
        Section("told", "What these pushes could tell", told),
    ]
    if found.provenance:
        done = html_table(["what was done"], [[sentence] for sentence in found.provenance])
        sections.append(Section("provenance", "Where they come from", done))
    wrong = [one.what for one in found.findings if one.verdict == "wrong"]
    headline = f"Wrong: {', '.join(wrong)}." if wrong else "Nothing is wrong with these pushes."
    lead = [f"Worth adding: {wanted}." for wanted in found.advice]
    subtitle = f"{len(dataset.trials)} pushes, before anything is learned"
    return page(f"{found.dataset}: check", subtitle, lead, sections, headline)
