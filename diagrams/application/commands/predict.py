"""`slipmap predict`: recorded pushes against what a belief says of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.outputs import write_figures
from slipmap.diagrams.application.terminal import Progress, note, prepare_kernels
from slipmap.models.files import write_json

if TYPE_CHECKING:
    from slipmap.models.inference.belief import Belief
    from slipmap.models.inference.results import Prediction


@click.command()
@options.dataset_argument
@options.belief_option(required=True)
@click.option(
    "-o", "--output", type=options.OutputFile(*options.PICTURES), default="predictions.png",
    show_default=True, metavar="FILE",
    help="Picture of the pushes (.png, .pdf or .svg); after each 24 pushes a further page,"
    " predictions.2.png and on.",
)  # fmt: skip
@options.effect_file_option
@options.object_option
@options.json_option
def predict(
    dataset: Path,
    belief_file: Path,
    output: Path,
    effect_files: tuple[Path, ...],
    object_name: str | None,
    json_file: Path | None,
) -> None:
    """Predict recorded pushes with a belief and compare.

    Every push of DATASET is simulated from its first pose with every hypothesis of the belief. The picture
    shows measured and predicted trajectories over each other; the table says how far off the ends are.
    DATASET must be about the object and the finger of the belief, but need not be what taught it.
    """
    from slipmap.models.inference.belief import Belief

    belief = Belief.load(belief_file, options.find_effects(effect_files))
    with Progress() as progress:
        measured = options.load_dataset(dataset, object_name, progress)
        prepare_kernels()
        from slipmap.models.inference import prediction

        pushes = prediction.predict(belief, measured, progress)
        from slipmap.diagrams.application.figures import push_figures

        progress("drawing", 0, 1)
        drawn = write_figures(output, push_figures(pushes, measured))
        progress("drawing", 1, 1)
    if json_file is not None:
        write_json(json_file, _document(belief, measured.name, pushes))
    from slipmap.diagrams.application.reports.tables import show_errors

    click.echo(f"{measured.name}, {len(pushes)} pushes; belief learnt from {belief.dataset}\n")
    show_errors(pushes, measured)
    for path in drawn:
        note(f"picture: {path}")


def _document(belief: Belief, dataset: str, pushes: Sequence[Prediction]) -> dict[str, Any]:
    numbers = ("final_add", "spread", "no_motion_add", "uniform_add", "start_sensitivity")
    trials = [
        {
            "trial": push.trial,
            "role": push.role,
            **{name: getattr(push, name) for name in numbers},
            "measured_end": push.measured[-1],
            "predicted_end": push.predicted[-1],
            "predicted_end_hypotheses": push.hypotheses[:, -1],
        }
        for push in pushes
    ]
    means = {
        f"{role}_error_mean": sum(push.final_add for push in group) / len(group) if group else None
        for role, group in ((role, [p for p in pushes if p.role == role]) for role in ("fit", "heldout"))
    }
    return {
        "dataset": dataset,
        "belief_dataset": belief.dataset,
        "probability": belief.probability,
        "trials": trials,
        **means,
    }
