"""`slipmap check` and `slipmap import`: pushes from a laboratory's files, and checks of pushes."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.outputs import check_folder, check_output, write_figures
from slipmap.diagrams.application.terminal import Progress, counted, note, paragraph, status, table
from slipmap.models.files import BadInput, all_or_nothing, write_json, write_text, writing

if TYPE_CHECKING:
    from slipmap.models.measurements import PushDataset
    from slipmap.models.measurements.dataset_check import DatasetCheck


@click.command()
@options.dataset_argument
@options.output_option(
    "-o", "--output", endings=("html", "htm"),
    about="Page with the findings and a picture of the pushes, for any browser.",
)  # fmt: skip
@options.object_option
@options.maps_option
@options.json_option
@click.pass_context
def check(
    context: click.Context,
    dataset: Path,
    output: Path | None,
    object_name: str | None,
    maps: Path | None,
    json_file: Path | None,
) -> None:
    """Check recorded pushes for faults, and what they can reveal.

    Checks sampling rates, gaps, clocks, contact and forces of DATASET, and which places, directions and
    speeds its pushes cover. Learns nothing. Exit code 1 if a finding would make results wrong.
    """
    from slipmap.models.measurements import read_dataset
    from slipmap.models.measurements.dataset_check import check_dataset

    with Progress() as progress:
        measured = read_dataset(
            dataset,
            object_name=object_name,
            maps=maps,
            progress=lambda done, total: progress("reading pushes", done, total),
            tell=lambda warning: None,
        )
        with progress.step("checking"):
            found = check_dataset(measured)
        with all_or_nothing():
            if output is not None:
                write_text(output, _page(found, measured))
            write_json(json_file, found.to_json())
    _show(found, dataset, options.datasets_typed())
    if output is not None:
        note(f"page: {output}")
    if found.wrong:
        context.exit(1)


_SIGNS = {"good": "", "note": "note", "wrong": "WRONG"}


def _show(found: DatasetCheck, folder: Path, where: str) -> None:
    """Print a check; `where` is the dataset as a command takes it."""
    rows = [[finding.what, finding.found, _SIGNS[finding.verdict]] for finding in found.findings]
    table(f"{found.dataset}: what was measured", ["check", "found", ""], rows)
    for finding in found.findings:
        if finding.advice:
            end = "" if finding.advice.endswith("?") else "."
            paragraph(f"{finding.what}: {finding.advice}{end}")
    click.echo()
    for group, words in ((found.quantities, "quantities"), (found.effects, "effects")):
        could = [told.name for told in group if told.could]
        other = [f"{told.name} ({told.reason})" for told in group if not told.could]
        paragraph(f"These pushes could reveal the following {words}: {', '.join(could) or 'none'}.")
        if other:
            paragraph(f"They may not suffice for (why in brackets): {', '.join(other)}.")
    _show_advice(found, folder, where)


def _show_advice(found: DatasetCheck, folder: Path, where: str) -> None:
    for wanted in found.advice:
        paragraph(f"Worth adding: {wanted}.")
    if found.advice:
        again = " and import everything again: slipmap import SOURCE... --setup setup.yaml -o"
        again += f" {shlex.quote(str(folder))}"
        paragraph(
            f"Record them{again if found.provenance else ' into the same place'}. After a first belief,"
            f" `slipmap diagnose {where}` plans the most informative push."
        )
    paragraph(
        "Something is WRONG: correct it first, or what is learned will be wrong."
        if found.wrong
        else f"{found.headline} Next: slipmap identify {where} -o belief.npz"
    )


def _page(found: DatasetCheck, dataset: PushDataset) -> str:
    from slipmap.diagrams.application.figures import measured_figure
    from slipmap.diagrams.application.reports.html_page import Section, page, picture, table as html_table

    columns = ["check", "found", "verdict", "what to do"]
    if not any(one.advice for one in found.findings):
        columns.pop()
    findings = html_table(
        columns,
        [[one.what, one.found, one.verdict, one.advice][: len(columns)] for one in found.findings],
        marked=[one.verdict == "wrong" for one in found.findings],
    )
    told = "".join(
        html_table(
            [name, "could be revealed", "why"],
            [[one.name, "yes" if one.could else "no", one.reason] for one in group],
        )
        for name, group in (("quantity", found.quantities), ("effect", found.effects))
    )
    sections = [
        Section("findings", "What was found", findings),
        Section(
            "pushes",
            "The pushes",
            picture(measured_figure(dataset), "Pushes on the table, contact gap and force over time"),
        ),
        Section("told", "What these pushes could reveal", told),
    ]
    if found.provenance:
        done = html_table(["processing steps"], [[sentence] for sentence in found.provenance])
        sections.append(Section("provenance", "Provenance", done))
    lead = [f"Worth adding: {wanted}." for wanted in found.advice]
    subtitle = f"{len(dataset.trials)} pushes, before anything is learned"
    return page(f"{found.dataset}: check", subtitle, lead, sections, found.headline)


@click.command("import")
@click.argument("sources", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="SOURCE...")
@options.path_option(
    "--setup", default="setup.yaml", metavar="YAML",
    about="Where the files hold object, finger and force, and how these were measured (docs/import.md).",
)  # fmt: skip
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), metavar="DATASET",
    help="Folder for the push dataset; an existing dataset is replaced.",
)  # fmt: skip
@options.object_option
@click.option("--guess", is_flag=True, help="Write a first setup from the files, to be corrected by hand.")
def import_files(
    sources: tuple[Path, ...], setup: Path, output: Path | None, object_name: str | None, guess: bool
) -> None:
    """Make a push dataset from a laboratory's own files.

    SOURCE is a file or a folder: tables of any kind, exports of Motive or Vicon, ROS bags, MCAP, MATLAB,
    HDF5, zarr, LeRobot. The setup says which of them holds what.

    A recording of many pushes is cut where the object rests and the finger leaves it. Clocks of several files
    are aligned by contact, and the force's bias is removed. The dataset.yaml records these steps; a picture
    beside the dataset shows pushes, contact and force.
    """
    from slipmap.models.measurements import write_dataset
    from slipmap.models.measurements.importing import guess_setup, import_dataset

    if guess:
        if setup.exists():
            raise BadInput(f"{setup} exists already; name another file with --setup, or move it away")
        check_output(setup, ("yaml", "yml"))
        write_text(setup, guess_setup(sources))
        note(f"setup: {setup}; correct it, then run the same command with -o DATASET instead of --guess")
        return
    if output is None:
        raise click.UsageError(
            "give a folder for the push dataset with -o DATASET, or write a setup with --guess"
        )
    picture = output.absolute().with_name(f"{output.absolute().name}.png")
    _check_import(sources, setup, output, picture)
    with Progress() as progress:
        dataset = import_dataset(
            sources,
            setup,
            object_name=object_name,
            progress=lambda done, total: progress("reading recordings", done, total),
            tell=lambda warning: note(f"warning: {warning}"),
        )
        if dataset.name == setup.stem:  # the setup gives no name of its own
            dataset = replace(dataset, name=output.absolute().name)
        from slipmap.diagrams.application.figures import measured_figure

        with all_or_nothing():
            write_figures(picture, [measured_figure(dataset)])
            with writing(output):
                write_dataset(dataset, output, overwrite=True)
    warned = set(dataset.warnings)
    for sentence in dataset.provenance:
        if sentence not in warned:
            status(sentence)
    heldout = len(dataset.heldout_trials)
    click.echo(f"{dataset.name}: {counted(len(dataset.trials))}, {heldout} of them held out")
    note(f"dataset: {output}\npicture: {picture if output.is_absolute() else os.path.relpath(picture)}")
    where = shlex.quote(str(output))
    note(f"Next: `slipmap check {where}`, then `slipmap identify {where} -o belief.npz`.")


def _check_import(sources: Sequence[Path], setup: Path, output: Path, picture: Path) -> None:
    """Refuse an import without a setup, and one that would replace something else than an earlier import.

    Raises:
        BadInput: see the message.
    """
    from slipmap.models.measurements.writing import is_imported, is_replaced

    if not setup.exists():
        raise BadInput(
            f"{setup}: there is no such file; write a first setup with --guess, or name yours with --setup"
        )
    for source in sources:
        if source.suffix in (".yaml", ".yml"):
            raise BadInput(
                f"{source}: name a setup with --setup (default: setup.yaml), not among the sources"
            )
    check_folder(output.absolute().parent, output)
    replaces = is_replaced(output.resolve(), overwrite=True)
    if replaces and not is_imported(output):
        raise BadInput(
            f"{output}: the push dataset here was not made by an import, so it is not replaced; name another"
            " folder with -o, or move this one away"
        )
    if not replaces and picture.exists():
        raise BadInput(
            f"{picture}: exists already, and no imported dataset is beside it whose picture it could be; name"
            " another folder with -o, or move this file away"
        )
