"""`slipmap object`: from a mesh or a picture to the file that describes what was pushed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slipmap.diagrams.application.commands.options import Option, count_option, output_option
from slipmap.diagrams.application.terminal import counted, note, printable, warnings_noted
from slipmap.models.files import BadInput, write_text

if TYPE_CHECKING:
    from slipmap.models.physics.cell_grid import CellGrid, FloatArray

_PICTURES = (".png", ".bmp", ".tif", ".tiff", ".pgm")
_OTHER_PICTURES = (".jpg", ".jpeg", ".gif", ".webp", ".heic", ".ppm")


def _positive(name: str, unit: str, about: str, *, required: bool = False) -> Option:
    kind = click.FloatRange(0.0, min_open=True)
    return click.option(name, type=kind, required=required, metavar=unit, help=about)


@click.command("object")
@click.argument("file", type=click.Path(path_type=Path))
@output_option(
    "-o", "--output", endings=("yaml", "yml"), required=True,
    about="File for the description, such as mug.yaml.",
)  # fmt: skip
@_positive("--finger", "M", "Radius of the pushing finger, m.", required=True)
@_positive("--mass", "KG", "Mass of the object, kg, if it was weighed.")
@count_option("--cells", most=5000, default=60, about="Approximate number of cells of the footprint.")
@_positive(
    "--metres-per-unit", "M", "Unit of a mesh, m: 0.001 for millimetres. [default: as in its file, else 1]"
)
@click.option(
    "--up",
    type=click.Choice(("x", "y", "z", "-x", "-y", "-z")),
    help="Axis of a mesh that points up. [default: y for glTF, as in the file for COLLADA, else z]",
)
@_positive("--metres-per-pixel", "M", "Of a picture: width of a pixel, m.")
@click.option(
    "--background", type=click.IntRange(0, 65535), metavar="VALUE",
    help="Of a picture: value of pixels outside the object. [default: 0]",
)  # fmt: skip
def describe_object(
    file: Path,
    output: Path,
    finger: float,
    mass: float | None,
    cells: int,
    metres_per_unit: float | None,
    up: str | None,
    metres_per_pixel: float | None,
    background: int | None,
) -> None:
    """Describe an object from a mesh or a picture, for --object.

    FILE is a mesh (STL, OBJ, PLY, glTF, COLLADA), a URDF or SDF with one link, or a greyscale picture from
    above (PNG) with 0 where there is no object. The footprint is the mesh's silhouette from above, and x and
    y of the upright mesh are the frame of the measured poses. A picture's frame has its origin at the
    centroid of the object's area, x to the right and y up.

    `identify`, `compare`, `diagnose` and `fit` need the description for CSV files.
    """
    import yaml

    from slipmap.models.measurements.setup_description import parse_setup

    if file.suffix.lower() in _OTHER_PICTURES:
        raise BadInput(f"{file}: pictures are read as {', '.join(_PICTURES)}; save it as a greyscale PNG")
    if file.suffix.lower() in _PICTURES:
        if metres_per_pixel is None or metres_per_unit is not None or up is not None:
            raise BadInput(f"{file} is a picture: give --metres-per-pixel, but not --metres-per-unit or --up")
        shape, standing = _pictured(file, cells, metres_per_pixel, background or 0), ""
    else:
        if metres_per_pixel is not None or background is not None:
            raise BadInput(
                f"{file} is not a picture ({', '.join(_PICTURES)}): leave out --metres-per-pixel and"
                " --background"
            )
        shape, standing = _modelled(file, cells, metres_per_unit, up)
    if mass is not None:
        shape["mass"] = mass
    document = {"name": file.stem, "object": shape, "finger": {"radius": finger}}
    setup, warnings = parse_setup(document, str(file), file.stem)
    for warning in warnings:
        note(f"warning: {warning}")
    write_text(output, yaml.safe_dump(document, sort_keys=False, default_flow_style=None))
    cut = f"{len(setup.grid)} cells of {1e3 * setup.grid.width:.1f} mm"
    click.echo(f"{printable(file.stem)}: {size_in_words(setup.grid)}{standing}, {cut}")
    note(f"description: {output}; use it with --object {output}")


def size_in_words(grid: CellGrid) -> str:
    """Width and depth of an object, and the number of its openings."""
    low, high = grid.exterior.min(axis=0), grid.exterior.max(axis=0)
    size = " by ".join(f"{1e3 * side:.{int(side < 0.01)}f} mm" for side in high - low)
    return f"{size} with {counted(len(grid.holes), 'opening')}" if grid.holes else size


def _pictured(file: Path, cells: int, metres_per_pixel: float, background: int) -> dict[str, Any]:
    """The entry `object` of a description. Raises BadInput where the file cannot be used."""
    from slipmap.models.objects.images import cells_from_label_image, openings, read_picture

    try:
        grid, _ = cells_from_label_image(str(file), metres_per_pixel, count=cells, background=background)
    except ValueError as error:
        raise BadInput(_with_options(str(error))) from error
    closed = openings(read_picture(file), background) - len(grid.holes)
    if closed:
        note(f"openings closed as noise, each of less than 1 % of the object's area: {closed}")
    return _footprint(grid, cells)


def _modelled(
    file: Path, cells: int, metres_per_unit: float | None, up: str | None
) -> tuple[dict[str, Any], str]:
    """The entry `object` of a description, and the height and up axis of the mesh in words.

    Raises:
        BadInput: the file cannot be used.
    """
    from slipmap.models.objects import cells_from_mesh, meshes

    try:
        axis = up or meshes.up_axis(file)
        direction = meshes.DIRECTIONS[axis]
        with warnings_noted(_with_options):
            grid = cells_from_mesh(str(file), count=cells, metres_per_unit=metres_per_unit, up=direction)
        height = float(meshes.upright_mesh(file, direction, metres_per_unit).bounds[1, 2])
    except ValueError as error:
        raise BadInput(_with_options(str(error))) from error
    standing = f", {1e3 * height:.3g} mm high with {axis} up"
    return {**_footprint(grid, cells), **({"height": round(height, 7)} if height > 0 else {})}, standing


def _with_options(text: str) -> str:
    """A text about arguments in Python, about options of the command."""
    return text.replace("metres_per_unit=", "--metres-per-unit ").replace("background=", "--background ")


def _footprint(outlined: CellGrid, about: int) -> dict[str, Any]:
    from slipmap.models.objects.footprints import cells_from_polygon

    grid = cells_from_polygon(outlined.exterior, outlined.holes, about=about)
    holes = [_written(hole) for hole in grid.holes]
    return {
        "outline": _written(grid.exterior),
        **({"holes": holes} if holes else {}),
        "cells": {"width": float(grid.width), "centers": grid.centers.round(7).tolist()},
    }


def _written(ring: FloatArray) -> list[list[float]]:
    """The rounded corners of a ring (k, 2), without those that rounding makes equal to the one before."""
    corners: list[list[float]] = ring.round(7).tolist()
    return [
        corner
        for corner, before in zip(corners, corners[-1:] + corners[:-1], strict=True)
        if corner != before
    ]
