"""`slipmap object`: from a mesh or a picture to the file that tells what was pushed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slipmap.diagrams.application.commands.options import Option, count_option, output_option
from slipmap.diagrams.application.terminal import note
from slipmap.models.files import BadInput, write_text

if TYPE_CHECKING:
    from slipmap.models.physics.cell_grid import CellGrid

_PICTURES = (".png", ".bmp", ".tif", ".tiff", ".pgm")


def _positive(name: str, unit: str, about: str, *, required: bool = False) -> Option:
    kind = click.FloatRange(0.0, min_open=True)
    return click.option(name, type=kind, required=required, metavar=unit, help=about)


@click.command("object")
@click.argument("file", type=click.Path(path_type=Path))
@output_option(
    "-o", "--output", endings=("yaml", "yml"), required=True,
    about="Where the description goes, such as mug.yaml.",
)  # fmt: skip
@_positive("--finger", "M", "Radius of the finger that pushes, m.", required=True)
@_positive("--mass", "KG", "What the object weighs, if it was put on a scale.")
@count_option("--cells", most=5000, default=60, about="About how many cells to cut the footprint into.")
@_positive(
    "--metres-per-unit", "M", "Of a mesh, 0.001 for millimetres; as its file says where missing, else 1."
)
@_positive("--metres-per-pixel", "M", "Of a picture: side of a pixel.")
def describe_object(
    file: Path,
    output: Path,
    finger: float,
    mass: float | None,
    cells: int,
    metres_per_unit: float | None,
    metres_per_pixel: float | None,
) -> None:
    """Describe an object from a mesh or a picture, for --object.

    FILE is a mesh (STL, OBJ, PLY), whose silhouette from above is the footprint and whose x and y are the
    frame of the measured poses; or a greyscale picture from above (PNG) with 0 where there is no object. A
    picture's frame has its origin at the middle of the object's area, x to the right and y up.

    `identify`, `compare`, `diagnose` and `fit` take what this writes beside CSV files.
    """
    import yaml

    from slipmap.models.measurements.setup_description import parse_setup

    shape = _shape(file, cells, metres_per_unit, metres_per_pixel)
    if mass is not None:
        shape["mass"] = mass
    document = {"name": file.stem, "object": shape, "finger": {"radius": finger}}
    setup, warnings = parse_setup(document, str(file), file.stem)
    for warning in warnings:
        note(f"warning: {warning}")
    write_text(output, yaml.safe_dump(document, sort_keys=False, default_flow_style=None))
    low, high = setup.grid.exterior.min(axis=0), setup.grid.exterior.max(axis=0)
    click.echo(
        f"{file.stem}: {1e3 * (high - low)[0]:.0f} mm by {1e3 * (high - low)[1]:.0f} mm,"
        f" {len(setup.grid)} cells of {1e3 * setup.grid.width:.1f} mm"
    )
    note(f"description: {output}; use it with --object {output}")


def _shape(
    file: Path, cells: int, metres_per_unit: float | None, metres_per_pixel: float | None
) -> dict[str, Any]:
    """The key `object` of a description.

    Raises:
        BadInput: the file cannot be used, or an option belongs to files of the other kind.
    """
    from slipmap.models.objects import cells_from_label_image, cells_from_mesh
    from slipmap.models.objects.meshes import upright_mesh

    try:
        if file.suffix.lower() in _PICTURES:
            if metres_per_pixel is None or metres_per_unit is not None:
                raise BadInput(f"{file} is a picture: give --metres-per-pixel and no --metres-per-unit")
            return _footprint(cells_from_label_image(str(file), metres_per_pixel, count=cells)[0])
        if metres_per_pixel is not None:
            raise BadInput(
                f"{file} is no picture ({', '.join(_PICTURES)}): --metres-per-pixel has no meaning for it"
            )
        grid = cells_from_mesh(str(file), count=cells, metres_per_unit=metres_per_unit)
        height = float(upright_mesh(file, metres_per_unit=metres_per_unit).bounds[1, 2])
    except ValueError as error:
        raise BadInput(str(error).replace("metres_per_unit=", "--metres-per-unit ")) from error
    return {**_footprint(grid), **({"height": round(height, 7)} if height > 0 else {})}


def _footprint(grid: CellGrid) -> dict[str, Any]:
    return {
        "outline": grid.exterior.round(7).tolist(),
        "cells": {"width": float(grid.width), "centers": grid.centers.round(7).tolist()},
    }
