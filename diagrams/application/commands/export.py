"""`slipmap export`: what was learned of an object, as a model for other simulators."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.outputs import check_folder
from slipmap.diagrams.application.terminal import note, status
from slipmap.models.files import writing


@click.command()
@click.argument("belief", type=click.Path(path_type=Path))
@click.option("--to", "kind", type=click.Choice(["sdf", "urdf", "mjcf"]), required=True, help="Format.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), required=True, metavar="DIR",
    help="New folder for the models.",
)  # fmt: skip
@click.option(
    "--height", type=click.FloatRange(2e-3, 10.0), metavar="M",
    help="Height of the object, m, which a belief does not hold; 0.02 where it is not said.",
)  # fmt: skip
@click.option(
    "--hypotheses",
    is_flag=True,
    help="One model for each hypothesis instead of their mean: randomised domains.",
)
@options.effect_file_option
def export(
    belief: Path,
    kind: str,
    output: Path,
    height: float | None,
    hypotheses: bool,
    effect_files: tuple[Path, ...],
) -> None:
    """Write what was learned as SDF, URDF or MJCF.

    The object of BELIEF becomes a rigid body with its mass, centre of mass and inertia, on 32 small feet
    whose friction is that of the parts above them. It says what the format cannot hold.
    """
    from slipmap.diagrams.application.simulator_models import (
        DEFAULT_HEIGHT,
        LOST,
        TO_MIND,
        Format,
        export_belief,
    )
    from slipmap.models.inference.belief import Belief

    check_folder(output.absolute().parent, output)
    learned = Belief.load(belief, options.find_effects(effect_files))
    to = cast(Format, kind)
    with writing(output):
        paths = export_belief(learned, to, output, height=height or DEFAULT_HEIGHT, hypotheses=hypotheses)
    for loss in LOST:
        status(f"not in the models: {loss}")
    for remark in TO_MIND[to]:
        status(f"mind: {remark}")
    if height is None:
        status(f"mind: the height counts as {DEFAULT_HEIGHT:g} m; say --height if it matters")
    click.echo(
        f"{len(paths)} model{'s' if len(paths) > 1 else ''}: {paths[0]}{' and on' if paths[1:] else ''}"
    )
    note(f"folder: {output}")
