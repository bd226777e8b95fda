"""The push to carry out next: object, finger, and where each rival says that the object ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, PathPatch

from diagrams.figures.outlines import outline_path, placed, scale_bar
from diagrams.figures.style import BELIEF, FAINT, FINGER, INK, OTHER, PAPER, styled
from models.measurements import PushDataset
from models.physics.cell_grid import FloatArray

WIDTH = 5.0  # inches
COLOURS = (BELIEF, OTHER, "#8a4fb0", "#b8860b", "#a3341f")


@styled
def next_push_figure(
    push: Mapping[str, object], ends: Sequence[tuple[str, FloatArray]], dataset: PushDataset
) -> Figure:
    """Outline at the start, the finger's way, and an outline at the end for each rival.

    Args:
        push: the next push of a diagnosis.
        ends: name and end pose (3,) of each rival.
        dataset: for the object and the finger.
    """
    grid, pose = dataset.grid, np.asarray(push["pose"], dtype=float)
    tips = np.array([push["tip_start"], push["tip_end"]], dtype=float)
    points = [placed(grid.exterior, pose), *(tips + sign * dataset.finger_radius for sign in (-1, 1))]
    every = np.concatenate([*points, *(placed(grid.exterior, end) for _, end in ends)])
    low, high = every.min(axis=0), every.max(axis=0)
    middle, size = (low + high) / 2, 1.15 * np.maximum(high - low, 0.4 * (high - low).max())
    legend = 0.2 + 0.19 * -(-(len(ends) + 2) // 2)
    height = WIDTH * size[1] / size[0] + legend
    figure = Figure(figsize=(WIDTH, height))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1 - legend / height))
    axes.add_patch(PathPatch(outline_path(grid, pose), facecolor=PAPER, edgecolor=FAINT, linewidth=1.0))
    handles = [
        Line2D([], [], color=FAINT, linewidth=1.0, label="before"),
        Line2D([], [], color=FINGER, linewidth=1.2, marker="o", markerfacecolor="none", label="finger"),
    ]
    for k, (name, end) in enumerate(ends):
        colour = COLOURS[k % len(COLOURS)]
        style = "-" if k < len(COLOURS) else "--"
        axes.add_patch(
            PathPatch(
                outline_path(grid, end), facecolor="none", edgecolor=colour, linewidth=1.6, linestyle=style
            )
        )
        handles.append(Line2D([], [], color=colour, linewidth=1.6, linestyle=style, label=name))
    axes.annotate("", tips[1], tips[0], arrowprops={"arrowstyle": "-|>", "color": FINGER, "linewidth": 1.2})
    for place, fill in zip(tips, ("none", FINGER), strict=True):
        axes.add_patch(Circle(place, dataset.finger_radius, facecolor=fill, edgecolor=FINGER, linewidth=1.1))
    contact = placed(np.asarray(push["contact"], dtype=float), pose)
    axes.plot(*contact, "x", color=INK, markersize=5, zorder=4)
    axes.set(
        xlim=middle[0] + size[0] * np.array([-0.5, 0.5]), ylim=middle[1] + size[1] * np.array([-0.5, 0.5])
    )
    axes.set(xticks=[], yticks=[], aspect="equal")
    axes.spines[:].set_visible(False)
    scale_bar(axes, middle + size * [-0.48, -0.42], float(size[0]))
    figure.legend(handles=handles, loc="upper left", ncols=2, bbox_to_anchor=(0.02, 1.0))
    return figure
