"""The push to make next, and where each model that is left says it will end."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, PathPatch, Rectangle

from diagrams.figures.outlines import outline_path, placed, scale_bar
from diagrams.figures.style import BELIEF, FAINT, FINGER, INK, OTHER, PAPER, styled
from models.inference.diagnosis.results import Diagnosis
from models.measurements import PushDataset
from models.physics.paper_notation import add
from planners.rehearsal import predict
from planners.telling_push import push_of, rivals_of

COLOURS = (BELIEF, OTHER, "#a03070", "#806000", "#5050a0", "#40a0c0", "#909090", "#c08080")
LEGEND_COLUMNS = 4


@styled
def telling_push_figure(told: dict[str, Any], diagnosis: Diagnosis, dataset: PushDataset) -> Figure:
    """Object, path of the finger, and the ends that the rivals predict; beside it, when their courses part.

    Args:
        told: result of `planners.telling_push.next_push`.
        diagnosis: it was made for.
        dataset: that was diagnosed.
    """
    grid = dataset.grid
    push = push_of(told, float(len(dataset.trials)))
    rivals = rivals_of(diagnosis, dataset)[: len(COLOURS)]
    predictions = [predict(rival, [push]) for rival in rivals]
    figure = Figure(figsize=(8.0, 4.2))
    rows = -(-(len(rivals) + 1) // LEGEND_COLUMNS)
    top, bottom = 0.97, 0.07 + 0.05 * rows
    axes = figure.add_axes((0.05, bottom, 0.5, top - bottom))
    axes.add_patch(
        PathPatch(outline_path(grid, told["pose"]), facecolor=PAPER, edgecolor=FAINT, linewidth=0.8)
    )
    axes.plot(*np.array([told["tip_start"], told["tip_end"]]).T, color=FINGER, linewidth=1.2)
    for place, fill in ((told["tip_start"], "none"), (told["tip_end"], FINGER)):
        axes.add_patch(Circle(place, dataset.finger_radius, facecolor=fill, edgecolor=FINGER, linewidth=1.0))
    contact = placed(np.array([told["contact"]]), told["pose"])[0]
    axes.plot(*contact, marker="x", color=FINGER, markersize=6)
    ends = [predicted.poses[0, -1] for predicted in predictions]
    for pose, predicted, colour in zip(ends, predictions, COLOURS, strict=False):
        axes.add_patch(PathPatch(outline_path(grid, pose), facecolor="none", edgecolor=colour, linewidth=1.4))
        axes.plot(*np.vstack([told["pose"], predicted.poses[0]])[:, :2].T, color=colour, linewidth=1.0)
    points = np.vstack(
        [told["tip_start"], told["tip_end"], *(placed(grid.exterior, pose) for pose in (told["pose"], *ends))]
    )
    low, high = points.min(axis=0) - 0.015, points.max(axis=0) + 0.015
    low[1] -= 0.02
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.tick_params(labelsize=8)
    _table_edge(axes, dataset)
    scale_bar(axes, low + np.array([0.008, 0.014]), float((high - low).max()))
    handles = [Line2D([], [], color=FINGER, marker="o", label="finger, filled where it stops")]
    for rival, colour in zip(rivals, COLOURS, strict=False):
        handles.append(Line2D([], [], color=colour, label=rival.name))
    figure.legend(handles=handles, loc="lower center", ncols=min(len(handles), LEGEND_COLUMNS))
    if len(rivals) > 1:
        times = np.asarray(push.pose_times)
        height = (top - bottom - 0.11) / 2
        lower = figure.add_axes((0.64, bottom + 0.06, 0.34, height))
        upper = figure.add_axes((0.64, top - height, 0.34, height), sharex=lower)
        for predicted, colour in zip(predictions, COLOURS, strict=False):
            apart = add(predicted.poses[0], predictions[0].poses[0], grid.centers)
            upper.plot(times, 1e3 * apart, color=colour)
            lower.plot(times - times[0] / 2, np.hypot(*predicted.forces[0].T), color=colour)
        upper.set(ylabel=f"apart from\n{rivals[0].name.split(' (')[0]}, mm", ylim=(0, None))
        upper.tick_params(labelbottom=False)
        lower.set(xlabel="time, s", ylabel="force, N", ylim=(0, None))
        upper.yaxis.label.set_fontsize(8)
    return figure


def _table_edge(axes: Axes, dataset: PushDataset) -> None:
    table = dataset.table
    if table is None:
        return
    if table.radius is not None:
        axes.add_patch(Circle(table.center, table.radius, facecolor="none", edgecolor=INK, linewidth=0.8))
    elif table.size is not None:
        corner = np.asarray(table.center) - 0.5 * np.asarray(table.size)
        axes.add_patch(Rectangle(tuple(corner), *table.size, facecolor="none", edgecolor=INK, linewidth=0.8))
