"""A Drake diagram as an N² chart: systems on the diagonal, what one tells another where they meet."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from diagrams.figures.style import BELIEF, FAINT, INK, PAPER, styled

if TYPE_CHECKING:
    from pydrake.systems.framework import Diagram

WIDE, HIGH = 1.12, 0.62  # inches, a cell


@styled
def wiring_figure(diagram: Diagram) -> Figure:
    """Systems of a diagram in the order in which they were added, and the connected output ports of each.

    Outputs leave to the left and right and enter from above and below: what stands in the row of one system
    and the column of another goes from the first to the second.

    Args:
        diagram: with connections between its systems; exported ports are not shown.
    """
    systems = diagram.GetSystems()
    place = {system.get_name(): k for k, system in enumerate(systems)}
    told: dict[tuple[int, int], list[str]] = {}
    for (target, _), (source, port) in diagram.connection_map().items():
        names = told.setdefault((place[source.get_name()], place[target.get_name()]), [])
        name = source.get_output_port(port).get_name()
        if name not in names:
            names.append(name)
    n = len(systems)
    figure = Figure(figsize=(n * WIDE, n * HIGH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0, n), ylim=(n, 0))
    axes.axis("off")
    for (source, target), names in told.items():
        x, y = target + 0.5, source + 0.5
        for points in (([source + 0.5, x], [y, y]), ([x, x], [y, target + 0.5])):
            axes.plot(*points, color=FAINT, linewidth=0.6, zorder=1)
        box = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
        axes.text(x, y, "\n".join(names), fontsize=6, color=INK, ha="center", va="center", bbox=box, zorder=3)
    for name, k in place.items():
        axes.add_patch(Rectangle((k + 0.06, k + 0.2), 0.88, 0.6, facecolor=PAPER, edgecolor=BELIEF, zorder=2))
        axes.text(
            k + 0.5, k + 0.5, name.replace("_", "\n"), fontsize=8, ha="center", va="center", zorder=4,
            weight="bold",
        )  # fmt: skip
    return figure
