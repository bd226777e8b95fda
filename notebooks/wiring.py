"""A Drake diagram as an N² chart: systems on the diagonal, their connections off it."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from slipmap.diagrams.systems.look import BELIEF, FAINT, INK, PAPER, styled

if TYPE_CHECKING:
    from pydrake.systems.framework import Diagram

LONGEST = 14
"""Characters of a port's name per line; longer names are broken at dots and underscores."""

_LETTER, _LINE = 0.067, 0.135  # inches, width and height of a character of a port's name
_BOLD = 0.075  # inches, width of a character of a system's name
_GAP = 0.12  # inches between two columns or rows


@styled
def wiring_figure(diagram: Diagram) -> Figure:
    """Draw the systems of a diagram, in the order in which they were added, and their connections.

    Names of output ports in the row of one system and the column of another are connections from the first to
    the second.

    Args:
        diagram: the diagram; its exported ports are not shown.
    """
    systems = diagram.GetSystems()
    place = {system.get_name(): k for k, system in enumerate(systems)}
    ports: dict[tuple[int, int], list[str]] = {}
    for (target, _), (source, port) in diagram.connection_map().items():
        names = ports.setdefault((place[source.get_name()], place[target.get_name()]), [])
        name = broken(source.get_output_port(port).get_name())
        if name not in names:
            names.append(name)
    titles = [name.replace("_", "\n") for name in place]
    wide = np.array([_BOLD * max(map(len, title.split("\n"))) + 0.15 for title in titles])
    high = np.array([0.2 * (1 + title.count("\n")) + 0.12 for title in titles])
    for (source, target), names in ports.items():
        lines = "\n".join(names).split("\n")
        wide[target] = max(wide[target], _LETTER * max(map(len, lines)))
        high[source] = max(high[source], _LINE * len(lines))
    x, y = (np.cumsum(size + _GAP) - (size + _GAP) / 2 for size in (wide, high))
    width, height = wide.sum() + _GAP * len(wide), high.sum() + _GAP * len(high)
    figure = Figure(figsize=(width, height))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.axis("off")
    for (source, target), names in ports.items():
        for points in (([x[source], x[target]], [y[source]] * 2), ([x[target]] * 2, [y[source], y[target]])):
            axes.plot(*points, color=FAINT, linewidth=0.8, zorder=1)
        box = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
        axes.text(
            x[target], y[source], "\n".join(names), fontsize=8, color=INK, ha="center", va="center", bbox=box,
            multialignment="left", linespacing=1.1, zorder=3,
        )  # fmt: skip
    for k, title in enumerate(titles):
        w, h = _BOLD * max(map(len, title.split("\n"))) + 0.15, 0.17 * (1 + title.count("\n")) + 0.14
        corner = (x[k] - w / 2, y[k] - h / 2)
        axes.add_patch(Rectangle(corner, w, h, facecolor=PAPER, edgecolor=BELIEF, zorder=2))
        axes.text(x[k], y[k], title, fontsize=9, ha="center", va="center", zorder=4, weight="bold")
    return figure


def broken(name: str) -> str:
    """Break a port's name into lines of up to `LONGEST` characters where its dots and underscores allow it.

    All lines but the first are indented.
    """
    lines = [""]
    for part in re.findall(r"[^._]+[._]?", name):
        if lines[-1].strip() and len(lines[-1] + part) > LONGEST:
            lines.append("  ")
        lines[-1] += part
    return "\n".join(lines)
