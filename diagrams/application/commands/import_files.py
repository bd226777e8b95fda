"""`slipmap import`: from a laboratory's own files to a push dataset."""

from __future__ import annotations

from pathlib import Path

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.outputs import check_folder, check_output, write_figures
from slipmap.diagrams.application.terminal import Progress, note, status
from slipmap.models.files import BadInput, write_text, writing


@click.command("import")
@click.argument("sources", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="SOURCE...")
@options.path_option(
    "--setup", default="setup.yaml", metavar="YAML",
    about="Where in the files object, finger and force are, and how they were measured (docs/import.md).",
)  # fmt: skip
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), metavar="DATASET",
    help="Folder of the push dataset; one that is there already is replaced.",
)  # fmt: skip
@options.object_option
@click.option("--guess", is_flag=True, help="Write a first setup from the files, to be corrected by hand.")
def import_files(
    sources: tuple[Path, ...], setup: Path, output: Path | None, object_name: str | None, guess: bool
) -> None:
    """Make a push dataset of a laboratory's own files.

    SOURCE is a file or a folder: tables of any kind, exports of Motive or Vicon, ROS bags, MCAP, MATLAB,
    HDF5, zarr, LeRobot. The setup says which of them holds what.

    A recording of many pushes is cut where the object rests and the finger leaves it. Clocks of several files
    are aligned by contact, and the force's bias is taken off. What was done stands in the dataset.yaml; a
    picture beside the dataset shows pushes, contact and force.
    """
    from slipmap.models.measurements import write_dataset
    from slipmap.models.measurements.importing import guess_setup, import_dataset
    from slipmap.models.measurements.writing import is_replaced

    if guess:
        if setup.exists():
            raise BadInput(f"{setup} is there already; name another file with --setup, or move it away")
        check_output(setup, ("yaml", "yml"))
        write_text(setup, guess_setup(sources))
        note(f"setup: {setup}; correct it, then run the same with -o DATASET in place of --guess")
        return
    if output is None:
        raise click.UsageError("say with -o DATASET where the push dataset goes, or ask to --guess a setup")
    if not setup.exists():
        raise BadInput(
            f"{setup}: there is no such file; write a first one with --guess, or name yours with --setup"
        )
    check_folder(output.absolute().parent, output)
    is_replaced(output.resolve(), overwrite=True)
    with Progress() as progress:
        dataset = import_dataset(
            sources,
            setup,
            object_name=object_name,
            progress=lambda done, total: progress("reading recordings", done, total),
            tell=lambda warning: note(f"warning: {warning}"),
        )
        with writing(output):
            write_dataset(dataset, output, overwrite=True)
        from slipmap.diagrams.application.figures import measured_figure

        picture = output.absolute().with_name(f"{output.absolute().name}.png")
        write_figures(picture, [measured_figure(dataset)])
    warned = set(dataset.warnings)
    for sentence in dataset.provenance:
        if sentence not in warned:
            status(sentence)
    heldout = len(dataset.heldout_trials)
    count = f"{len(dataset.trials)} push{'es' if len(dataset.trials) > 1 else ''}"
    click.echo(f"{dataset.name}: {count}, {heldout} of them held out")
    note(f"dataset: {output}\npicture: {picture}")
    note(f"next: slipmap check {output}, then slipmap identify {output} -o belief.npz")
