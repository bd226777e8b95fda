"""`slipmap demo`, the whole pipeline on simulated pushes; `slipmap example`, pushes to try commands on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.commands.identify import keep, show, tell_files
from slipmap.diagrams.application.outputs import check_folder, take_folder
from slipmap.diagrams.application.terminal import Progress, note, prepare_kernels, table
from slipmap.models.files import BadInput, all_or_nothing, write_json, writing

if TYPE_CHECKING:
    from slipmap.models.inference.results import Identification
    from slipmap.models.physics.rollout import Maps


@click.command()
@options.path_option(
    "-o", "--output", "folder", default="simulated-demo", metavar="DIR",
    about="Folder for everything that the demo writes.",
)  # fmt: skip
@options.seed_option
@options.count_option("--fit-pushes", most=100, default=6, about="Pushes to learn from.")
@options.count_option("--heldout-pushes", least=0, most=100, default=4, about="Pushes to judge with.")
@options.json_option
def demo(folder: Path, seed: int, fit_pushes: int, heldout_pushes: int, json_file: Path | None) -> None:
    """Run the whole pipeline on a simulated hammer, without data.

    Pushes a hammer with a steel head and a wooden handle at random, records the pushes with sensor noise as
    a push dataset, identifies the maps from that alone, and compares the belief with the truth.

    This is the short demo, without a robot. In the long one, `make demo` in the source tree, a simulated arm
    learns the same hammer on a secretly tilted table, repairs its model, and grasps the hammer.
    """
    from slipmap.diagrams.loops.run_folder import refuse_robots_pushes

    take_folder(folder)
    refuse_robots_pushes(folder)
    place, belief = folder / "pushes", folder / "belief.npz"
    with Progress() as progress:
        prepare_kernels()
        with progress.step("pushing the hammer"):
            from slipmap.diagrams.application.demonstration import simulated_hammer
            from slipmap.models.inference import identification
            from slipmap.models.measurements import write_dataset

            recorded, truth = simulated_hammer(seed, fit=fit_pushes, heldout=heldout_pushes)
            with writing(place):
                write_dataset(recorded, place, overwrite=True)
        dataset = options.load_dataset(place, None, progress)
        result = identification.identify(dataset, seed=seed, progress=progress)
        comparison = _against_truth(result, truth)
        with all_or_nothing():
            drawn = keep(result, dataset, belief, None, progress, truth)
            write_json(json_file, {**result.to_json(), "truth": comparison})
    show(result, dataset, options.typed(place))
    _show_comparison(result, comparison)
    note(f"pushes: {place}")
    tell_files(belief, drawn)
    note(
        f"Next: look at the pictures, or learn from fewer pushes with"
        f" `slipmap identify {options.typed(place)} -o {options.typed(folder / 'fewer.npz')}"
        " --fit-pushes 2`."
    )


def _against_truth(result: Identification, maps: Maps) -> list[dict[str, Any]]:
    from slipmap.diagrams.application.demonstration import true_values

    known = true_values(result.belief, maps)
    return [
        {name: getattr(quantity, name) for name in ("name", "unit", "value", "low", "high")}
        | {"truth": truth, "inside": quantity.low <= truth <= quantity.high}
        for quantity in result.quantities
        if (truth := known.get(quantity.name)) is not None
    ]


def _show_comparison(result: Identification, comparison: list[dict[str, Any]]) -> None:
    from slipmap.diagrams.application.reports.tables import named, shown

    by_name = {quantity.name: quantity for quantity in result.quantities}
    rows = []
    for entry in comparison:
        quantity = by_name[entry["name"]]
        numbers = shown(quantity, entry["truth"], quantity.value)
        rows.append([named(quantity), *numbers, "yes" if entry["inside"] else "no"])
    table(
        "Belief and truth",
        ["quantity", "truth", "belief", "90 % interval", "truth inside"],
        rows,
        numbers=(1, 2, 3),
    )
    inside = sum(entry["inside"] for entry in comparison)
    click.echo(f"{inside} of {len(comparison)} true values lie inside their 90 % intervals.")


@click.command()
@options.path_option(
    "-o", "--output", "folder", default="tilted", metavar="DIR", about="New folder for the pushes.",
)  # fmt: skip
def example(folder: Path) -> None:
    """Write sample pushes of a block with a hidden effect.

    The pushes are simulated on a table that is not level, which the model does not know. Learn from them, see
    the model fail, find out why, and repair it.
    """
    from slipmap.diagrams.application.demonstration import tilted_block
    from slipmap.models.measurements import write_dataset
    from slipmap.models.measurements.reading import DESCRIPTION_FILE

    following = f"`slipmap identify {options.typed(folder)} -o belief.npz`"
    if (folder / DESCRIPTION_FILE).exists():
        raise BadInput(f"{folder}: holds pushes already; continue with {following}, or name another folder")
    check_folder(folder.absolute().parent, folder)
    with writing(folder):
        write_dataset(tilted_block(), folder)
    note(f"pushes: {folder}")
    note(f"Next: {following}.")
