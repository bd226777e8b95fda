"""Shared drawing of all figures: outlines, cells, scale bars, and saving."""

from pathlib import Path
from typing import Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle, PathPatch
from matplotlib.path import Path as Curve
from matplotlib.ticker import LogFormatter
from numpy.typing import ArrayLike

from slipmap.diagrams.systems.look import BELIEF, FINGER, INK, STYLE
from slipmap.models.geometry import placed
from slipmap.models.physics.cell_grid import CellGrid

_EDGE = 0.04  # inches between a label and the edge of its figure


class PlainNumbers(LogFormatter):
    """Plain numbers as labels of a logarithmic axis, at the ticks where matplotlib has room for them."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Label of the tick at `x`, empty where there is none."""
        return f"{x:g}" if super().__call__(x, pos) else ""


def keep_labels_inside(figure: Figure) -> None:
    """Shrink axes whose labels, such as long numbers, would be cut off at the left or lower edge."""
    for axes in figure.axes:
        box = axes.get_tightbbox()
        if box is None:
            continue
        left, bottom, right, top = axes.get_position(original=True).extents
        missing_x = max(_EDGE * figure.dpi - box.x0, 0.0) / figure.bbox.width
        missing_y = max(_EDGE * figure.dpi - box.y0, 0.0) / figure.bbox.height
        if missing_x or missing_y:
            left, bottom = left + missing_x, bottom + missing_y
            axes.set_position((left, bottom, right - left, top - bottom))


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, PDF or SVG, by the ending of `path`.

    Raises:
        OSError: the folder does not exist or cannot be written.

    Example:
        >>> import pathlib
        >>> import tempfile
        >>> import slipmap
        >>> import matplotlib.pyplot as plt
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "empty.png"
        ...     slipmap.save(plt.figure(), path)
        ...     path.exists()
        True
    """
    with matplotlib.rc_context(STYLE):
        figure.savefig(path, dpi=130)


def outline_path(grid: CellGrid, pose: ArrayLike = (0.0, 0.0, 0.0)) -> Curve:
    """Exterior and holes as one path, placed at a pose (3,) in the world, m and rad."""
    rings = [placed(ring, np.asarray(pose, dtype=float)) for ring in (grid.exterior, *grid.holes)]
    return Curve.make_compound_path(*(Curve(np.vstack([ring, ring[:1]]), closed=True) for ring in rings))


def draw_outline(
    axes: Axes,
    grid: CellGrid,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    *,
    color: str = INK,
    width: float = 0.9,
    fill: str = "none",
    alpha: float | None = None,
    zorder: float = 1.0,
) -> None:
    """Outline of an object at a pose (3,) in the world, m and rad.

    Example:
        >>> import slipmap
        >>> import matplotlib.pyplot as plt
        >>> grid, _ = slipmap.hammer()
        >>> axes = plt.figure().add_subplot()
        >>> slipmap.figures.draw_outline(axes, grid, [0.1, 0.0, 0.5])
        >>> len(axes.patches)
        1
    """
    shape = outline_path(grid, pose)
    axes.add_artist(
        PathPatch(shape, facecolor=fill, edgecolor=color, linewidth=width, alpha=alpha, zorder=zorder)
    )
    # `add_patch` would search each side for extremes of a curve, which takes longer than drawing.
    axes.update_datalim(shape.vertices)


def draw_faint_outlines(axes: Axes, grid: CellGrid, poses: ArrayLike, alpha: float) -> None:
    """Outlines of an object at many poses (K, 3) in the world, m and rad; faster than one by one."""
    shapes = [outline_path(grid, pose) for pose in np.asarray(poses, dtype=float)]
    drawn = PathCollection(
        shapes, facecolors="none", edgecolors=BELIEF, linewidths=0.8, alpha=alpha, zorder=1.0
    )
    axes.add_collection(drawn, autolim=False)


def draw_finger(axes: Axes, begin: ArrayLike, end: ArrayLike, radius: float, width: float = 1.0) -> None:
    """Draw the finger of a radius (m) as a ring where a push begins and filled where it ends, each (2,) m."""
    for place, fill in ((begin, "none"), (end, FINGER)):
        x, y = np.asarray(place, dtype=float)
        axes.add_patch(Circle((x, y), radius, facecolor=fill, edgecolor=FINGER, linewidth=width))


def light_grid(axes: Axes, axis: Literal["x", "y"]) -> None:
    """Draw pale lines in the background at the ticks of one axis."""
    axes.grid(axis=axis, color="#e7e4dd", linewidth=0.6)
    axes.set_axisbelow(True)


def draw_cells(
    axes: Axes,
    grid: CellGrid,
    values: ArrayLike,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    *,
    colors: str = "viridis",
    norm: Normalize | None = None,
) -> PolyCollection:
    """Draw cells coloured by values (n,) and clipped to the outline at a pose (3,) in the world, m and rad.

    Leaves the limits of the axes alone. Returns the squares, from which `Figure.colorbar` makes a scale.

    Example:
        >>> import slipmap
        >>> import matplotlib.pyplot as plt
        >>> grid, truth = slipmap.hammer()
        >>> axes = plt.figure().add_subplot()
        >>> cells = slipmap.figures.draw_cells(axes, grid, truth.mu[0])
        >>> len(cells.get_paths()) == len(grid)
        True
    """
    # Edges as wide as a pixel cover the seams between squares, through which the ground would shine.
    squares = PolyCollection(
        list(placed(grid.squares(grid.width), np.asarray(pose, dtype=float))),
        array=np.asarray(values, dtype=float), cmap=colors, norm=norm, edgecolors="face", linewidths=0.8,
    )  # fmt: skip
    squares.set_clip_path(outline_path(grid, pose), axes.transData)
    axes.add_collection(squares, autolim=False)
    draw_outline(axes, grid, pose)
    return squares


def scale_bar(axes: Axes, corner: ArrayLike, extent: float) -> None:
    """A bar of a round length, up to a quarter of `extent` (m), from `corner` (m) to the right, labelled."""
    length = round_length(extent / 4)
    x, y = np.asarray(corner, dtype=float)
    axes.plot([x, x + length], [y, y], color=INK, linewidth=1.6, solid_capstyle="butt", clip_on=False)
    axes.annotate(
        f"{length * 1e3:g} mm", (x + length / 2, y), (0, -3), textcoords="offset points",
        ha="center", va="top", fontsize=7.5, annotation_clip=False,
    )  # fmt: skip


def round_length(largest: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above `largest` (> 0)."""
    power = 10.0 ** np.floor(np.log10(largest))
    return float(max(step for step in (1, 2, 5) if step * power <= largest * (1 + 1e-9)) * power)
