"""Figures of pushes: as measured, beside predictions, and the errors of models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from slipmap.diagrams.application.figures import style
from slipmap.diagrams.application.reports.comparison_words import ROLES, short_name
from slipmap.diagrams.systems.look import BELIEF, FAINT, FINGER, INK, OTHER, PAPER, styled
from slipmap.models.geometry import placed, radius_of_gyration
from slipmap.models.inference.comparison import Comparison
from slipmap.models.inference.prediction import Prediction
from slipmap.models.measurements import PushDataset, Trial, finger_path
from slipmap.models.measurements.contact import CALIBRATION_ERROR
from slipmap.models.measurements.motion import spread_rows
from slipmap.models.measurements.push_dataset import check_dataset_given, gaps
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.settings import check_several

MODEL_COLOURS = (BELIEF, OTHER)  # colours of one model, or of two over the same pushes
_PANELS_A_PAGE = 24
_COLUMNS = 6
_PANEL = 2.1  # inches
_OUTLINES = (
    "Outlines: grey at the start, thin halfway, thick at the end. Lines between them: path of the centroid"
)

_HEAD, _FOOT, _SIDE, _GAP, _TITLE = 0.8, 0.5, 0.15, 0.15, 0.4
_NARROWEST_PAGE = 8.4  # inches; heading and legend need as much
_NEAR = 1.2  # largest distance from the object's path at which the finger's path is drawn, in object sizes

_MEANING_OF_ADD = (
    "ADD: mean distance between predicted and measured cells at the end; spread: of the hypotheses"
)

# Of the figure of errors.
_WIDTH = 8.0  # inches
_LEGEND_COLUMNS, _LEGEND_ROW = 3, 0.2  # columns where one row is not enough; inches
_LETTER = 0.07  # inches, of a push's name
_MOST_NAMES = 40


@dataclass(frozen=True, eq=False)
class _Scene:
    """What one panel shows."""

    push: Prediction  # measured and predicted poses
    start: FloatArray  # (3,) first measured pose
    # sample half-way along the object's path, or None where only the end was measured
    middle: int | None
    finger: FloatArray  # (k, 2) path of the finger near the object, m
    low: FloatArray  # (2,) lower corner of all this, m
    high: FloatArray  # (2,) upper corner, m


@styled
def push_figures(predictions: Sequence[Prediction], dataset: PushDataset, *, title: str = "") -> list[Figure]:
    """A panel for each push, up to 24 per figure; all panels of one figure have the same scale.

    Args:
        dataset: for the outline and the finger's path.
        title: heading; the dataset's name where empty.

    Raises:
        TypeError: something other than predictions, or than a dataset.
        ValueError: predictions of another dataset.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=1, heldout=1)
        >>> result = slipmap.identify(dataset, hypotheses=2, friction_laws=False)
        >>> len(slipmap.push_figures(result.pushes, dataset))
        1
    """
    check_dataset_given(dataset)
    check_several("push_figures: predictions", predictions, "such as slipmap.identify(dataset).pushes")
    trials = {trial.name: trial for trial in dataset.trials}
    strange = [push.trial for push in predictions if push.trial not in trials]
    if strange:
        raise ValueError(
            f"push_figures: dataset {dataset.name} has no push {strange[0]};"
            " give the dataset that was predicted"
        )
    scenes = [_scene(push, trials[push.trial], dataset) for push in predictions]
    pages = [scenes[k : k + _PANELS_A_PAGE] for k in range(0, len(scenes), _PANELS_A_PAGE)]
    heading = title or f"{dataset.name}: pushes as measured and as predicted"
    return [
        _page(page, dataset, heading + (f" (page {number} of {len(pages)})" if len(pages) > 1 else ""))
        for number, page in enumerate(pages, start=1)
    ]


def _scene(push: Prediction, trial: Trial, dataset: PushDataset) -> _Scene:
    start, poses = trial.object_pose.values[0], push.measured
    middle = None
    if len(poses) > 2:
        way = _way(np.vstack([start, poses]), dataset.grid)
        middle = int(np.argmin(np.abs(way - 0.5 * way[-1])))
    drawn = [start, *poses[[] if middle is None else [middle]], poses[-1], *push.hypotheses[:, -1]]
    points = placed(dataset.grid.exterior, np.array(drawn)[:, None]).reshape(-1, 2)
    low, high = points.min(axis=0), points.max(axis=0)
    finger = np.zeros((0, 2))
    if trial.finger_near(dataset.reach):
        reach = _NEAR * float(np.ptp(dataset.grid.exterior, axis=0).max())
        _, path = finger_path(trial)
        finger = path[((path > low - reach) & (path < high + reach)).all(axis=1)]
    if len(finger):
        low = np.minimum(low, finger.min(axis=0) - dataset.finger_radius)
        high = np.maximum(high, finger.max(axis=0) + dataset.finger_radius)
    return _Scene(push, start, middle, finger, low, high)


def _way(poses: FloatArray, grid: CellGrid) -> FloatArray:
    """(S,) distance travelled up to each pose but the first, m: path of the centroid, plus rotation."""
    centroid = grid.centers.mean(axis=0)
    track = placed(centroid, poses)
    turned = radius_of_gyration(grid) * np.abs(np.diff(poses[:, 2]))
    return np.cumsum(np.hypot(*np.diff(track, axis=0).T) + turned)


def _page(scenes: list[_Scene], dataset: PushDataset, heading: str) -> Figure:
    columns = min(_COLUMNS, max(2, int(np.ceil(np.sqrt(1.4 * len(scenes))))), max(len(scenes), 1))
    rows = -(-len(scenes) // columns)
    width = max(columns * _PANEL + (columns - 1) * _GAP + 2 * _SIDE, _NARROWEST_PAGE)
    height = _HEAD + rows * (_PANEL + _TITLE) + _FOOT
    figure = Figure(figsize=(width, height))
    figure.text(0.5, 1 - 0.16 / height, heading, ha="center", va="top", fontsize=11)
    figure.text(0.5, 1 - 0.39 / height, _MEANING_OF_ADD, ha="center", va="top", fontsize=8.5, color=FAINT)
    figure.text(0.5, 1 - 0.56 / height, _OUTLINES, ha="center", va="top", fontsize=8.5, color=FAINT)
    span = 1.06 * max(float((scene.high - scene.low).max()) for scene in scenes)
    left = (width - columns * _PANEL - (columns - 1) * _GAP) / 2
    for k, scene in enumerate(scenes):
        row, column = divmod(k, columns)
        bottom = height - _HEAD - (row + 1) * (_PANEL + _TITLE)
        place = (left + column * (_PANEL + _GAP)) / width, bottom / height, _PANEL / width, _PANEL / height
        axes = figure.add_axes(place)
        middle = (scene.low + scene.high) / 2
        axes.set(xlim=middle[0] + span * np.array([-0.5, 0.5]), ylim=middle[1] + span * np.array([-0.5, 0.5]))
        axes.set(xticks=[], yticks=[], aspect="equal")
        axes.spines[:].set_visible(True)
        axes.spines[:].set_color("#dddddd")
        _panel(axes, scene, dataset)
        if k == 0:
            style.scale_bar(axes, middle + span * np.array([-0.45, -0.41]), span)
    figure.legend(
        handles=_legend(any(len(scene.finger) for scene in scenes)),
        loc="lower center",
        ncols=6,
        columnspacing=1.2,
        handlelength=1.5,
    )
    return figure


def _panel(axes: Axes, scene: _Scene, dataset: PushDataset) -> None:
    push, grid = scene.push, dataset.grid
    style.draw_outline(axes, grid, scene.start, color=FAINT, width=0.7, fill=PAPER)
    faint = float(np.clip(4.0 / len(push.hypotheses), 0.12, 0.5))
    if scene.middle is not None:
        there = push.hypotheses[:, scene.middle]
        style.draw_faint_outlines(axes, grid, there, alpha=0.55 * faint)
        style.draw_outline(axes, grid, push.measured[scene.middle], alpha=0.7)
    style.draw_faint_outlines(axes, grid, push.hypotheses[:, -1], alpha=faint)
    style.draw_outline(axes, grid, push.measured[-1], width=1.2)
    centroid = grid.centers.mean(axis=0)
    for poses, colour in ((push.predicted, BELIEF), (push.measured, INK)):
        track = placed(centroid, np.vstack([scene.start, poses]))
        axes.plot(*track.T, color=colour, linewidth=1.1)
    if len(scene.finger):
        axes.plot(*scene.finger.T, color=FINGER, linewidth=1.0)
        style.draw_finger(axes, scene.finger[0], scene.finger[-1], dataset.finger_radius, 0.9)
    numbers = f"ADD {1e3 * push.final_add:.1f} mm, spread {1e3 * push.spread:.1f} mm"
    axes.set_title(f"{short_name(push.trial)}, {ROLES[push.role]}\n{numbers}", pad=4, fontsize=8.5)


def _legend(finger: bool) -> list[Line2D]:
    rim = [withStroke(linewidth=7, foreground=FAINT)]
    handles = [
        Line2D([], [], color=PAPER, linewidth=6, path_effects=rim, label="start"),
        Line2D([], [], color=INK, linewidth=1.2, label="measured"),
        Line2D([], [], color=BELIEF, linewidth=1.2, alpha=0.8, label="predicted (faint: each hypothesis)"),
    ]
    return [*handles, *_finger_handles()] if finger else handles


def _finger_handles() -> list[Line2D]:
    return [
        Line2D([], [], color=FINGER, linewidth=1.0, label="finger path:"),
        Line2D([], [], color=FINGER, linestyle="none", marker="o", markerfacecolor="none", label="start"),
        Line2D([], [], color=FINGER, linestyle="none", marker="o", label="end"),
    ]


@styled
def error_figure(comparisons: Sequence[Comparison]) -> Figure:
    """Error at the end of each push (ADD) on a logarithmic scale: fit pushes left, held-out pushes right.

    Args:
        comparisons: one model, or two over the same pushes; the first one's error gives the order.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=1, heldout=1)
        >>> belief = slipmap.identify(dataset, hypotheses=2, friction_laws=False).belief
        >>> type(slipmap.figures.error_figure([slipmap.compare(dataset, belief)])).__name__
        'Figure'
    """
    first = comparisons[0]
    order = sorted(
        range(len(first.pushes)),
        key=lambda b: (first.pushes[b].role == "heldout", first.pushes[b].errors.final_add),
    )
    pushes = [first.pushes[b] for b in order]
    entries = 2 + len(comparisons) + (first.floor is not None)
    columns = entries if entries <= _LEGEND_COLUMNS + 1 else _LEGEND_COLUMNS
    names = [short_name(push.trial) for push in pushes] if len(pushes) <= _MOST_NAMES else []
    longest = max(map(len, names), default=0)
    upright = len(names) > 30 or longest > 4
    below = 0.2 + _LETTER * longest if upright else 0.4
    top = 0.23 + _LEGEND_ROW * -(-entries // columns)
    height = 2.27 + below + top
    figure = Figure(figsize=(_WIDTH, height))
    axes = figure.add_axes((0.085, below / height, 0.905, 2.27 / height))
    x = np.arange(len(pushes))
    for baseline, marker, size, label in (
        ([push.resting for push in pushes], "_", 8.0, "object does not move"),
        ([push.uniform for push in pushes], "D", 3.6, "uniform object"),
    ):
        values = [1e3 * errors.final_add for errors in baseline]
        axes.plot(
            x, values, marker, color=FAINT, markersize=size, markeredgewidth=1.3, label=label,
            markerfacecolor="white", linestyle="none",
        )  # fmt: skip
    # The first of two models is a ring, so that the second does not hide it at the same place.
    for k, (comparison, colour) in enumerate(zip(comparisons, MODEL_COLOURS, strict=False)):
        ring = k == 0 and len(comparisons) > 1
        size, fill = (8.0, "none") if ring else (5.5, colour)
        values = [1e3 * comparison.pushes[b].errors.final_add for b in order]
        axes.plot(
            x, values, "o", color=colour, markersize=size, markerfacecolor=fill, label=comparison.label,
            linestyle="none", markeredgewidth=1.4 if ring else 0.0,
        )  # fmt: skip
    if first.floor is not None:
        floor = 1e3 * first.floor.add
        label = f"noise floor {floor:.2g} mm ({first.floor.source})"
        axes.axhline(floor, color=INK, linewidth=0.9, linestyle=(0, (4, 3)), label=label)
    _name_roles(axes, sum(push.role == "fit" for push in pushes), len(pushes))
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(style.PlainNumbers())
    axes.set(xlim=(-0.6, len(pushes) - 0.4), ylabel="error at the end (ADD), mm")
    axes.set_xticks(x[: len(names)], names, rotation=90 if upright else 0, fontsize=7.5)
    style.light_grid(axes, "y")
    figure.legend(loc="upper right", ncols=columns, bbox_to_anchor=(0.995, 1.01), handletextpad=0.3)
    return figure


def _name_roles(axes: Axes, fitted: int, count: int) -> None:
    """Write the roles above `count` pushes, the first `fitted` of them fit pushes, and shade the others."""
    if 0 < fitted < count:
        axes.axvspan(fitted - 0.5, count - 0.5, color="#f6f4ef", linewidth=0, zorder=0)
    for name, first, end in (("fit", 0, fitted), ("held out", fitted, count)):
        if end > first:
            axes.annotate(
                name, ((first + end - 1) / 2, 1.0), (0, 3), xycoords=("data", "axes fraction"),
                textcoords="offset points", ha="center", fontsize=8.5, color=INK,
            )  # fmt: skip


_MOST_DRAWN = 24  # pushes
_ROWS = 400  # samples of a push
_PAUSE = 0.3  # s between two pushes
_FARTHEST = 0.03  # m; largest gap that is drawn


@styled
def measured_figure(dataset: PushDataset) -> Figure:
    """Pushes on the table, and contact gap and measured force over time, push after push.

    A ring is the finger's start and a dot its end. The gap is the distance between the finger's rim and the
    outline: near zero while the object moves, and never below. Of many pushes, two dozen are drawn, evenly
    chosen.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=2, heldout=0)
        >>> len(slipmap.figures.measured_figure(dataset).axes)
        3
    """
    places = spread_rows(len(dataset.trials), _MOST_DRAWN)
    trials = [dataset.trials[place] for place in places]
    figure = Figure(figsize=(9.6, 4.6))
    forces = any(trial.ft_wrench is not None for trial in trials)
    table = figure.add_axes((0.06, 0.11, 0.38, 0.78))
    gap_axes = figure.add_axes((0.53, 0.55, 0.45, 0.34) if forces else (0.53, 0.11, 0.45, 0.78))
    force_axes = figure.add_axes((0.53, 0.11, 0.45, 0.34), sharex=gap_axes) if forces else None
    now, ticks, largest = 0.0, [], 0.0
    for trial in trials:
        first, last = trial.object_pose.values[[0, -1]]
        style.draw_outline(table, dataset.grid, first, color=FAINT, width=0.7)
        style.draw_outline(table, dataset.grid, last, width=0.9, alpha=0.8)
        begin, end = trial.object_pose.time[[0, -1]]
        if trial.finger_near(dataset.reach):
            time = np.linspace(begin, end, _ROWS)
            near = (time >= trial.tip_pose.time[0]) & (time <= trial.tip_pose.time[-1])
            tips, poses = trial.tip_pose.at(time[near]), trial.object_pose.at(time[near])
            table.plot(*tips.T, color=FINGER, linewidth=0.9)
            table.plot(*tips[:1].T, "o", color=FINGER, markersize=3.0, markerfacecolor=PAPER)
            table.plot(*tips[-1:].T, "o", color=FINGER, markersize=3.0)
            if not trial.ends_only:
                gap = np.minimum(gaps(dataset, tips, poses), _FARTHEST)
                gap_axes.plot(now + time[near] - begin, 1e3 * gap, color=BELIEF, linewidth=0.8)
        if trial.ft_wrench is not None and force_axes is not None:
            force = np.hypot(*trial.ft_wrench.values[:, :2].T)
            force_axes.plot(now + trial.ft_wrench.time - begin, force, color=INK, linewidth=0.6)
            largest = max(largest, float(np.percentile(force, 99)))
        ticks.append(now)
        now += end - begin + _PAUSE
    over_time = [gap_axes]
    if force_axes is not None:
        over_time.append(force_axes)
        force_axes.set_ylabel("force, N")
        if largest > 0.0:  # the impact at the touch may be ten times the force of a push
            force_axes.set_ylim(-0.05 * largest, 1.3 * largest)
    _label(table, over_time, ticks, now)
    more = "" if len(trials) == len(dataset.trials) else f", {len(trials)} of {len(dataset.trials)} pushes"
    figure.text(0.06, 0.985, f"{dataset.name}: what was measured{more}", va="top", fontsize=11)
    if any(trial.finger_near(dataset.reach) for trial in trials):
        figure.legend(handles=_finger_handles(), loc="upper right", ncols=3, bbox_to_anchor=(0.985, 1.0))
    return figure


def _label(table: Axes, over_time: Sequence[Axes], ticks: list[float], end: float) -> None:
    table.set_aspect("equal", adjustable="datalim")
    table.autoscale_view()
    table.set(xlabel="x, m", ylabel="y, m")
    table.set_title("outlines before (grey) and after, finger path", loc="left", color=FAINT)
    gap_axes = over_time[0]
    gap_axes.axhspan(-1e3 * CALIBRATION_ERROR, 1e3 * CALIBRATION_ERROR, color="#f1efea", linewidth=0)
    gap_axes.axhline(0.0, color=FAINT, linewidth=0.8)
    gap_axes.set_ylabel("gap, mm")
    gap_axes.set_title("between finger and outline; negative: finger inside", loc="left", color=FAINT)
    over_time[-1].set(xlabel="time, push after push, s", xlim=(0.0, max(end, 1e-3)))
    for axes in over_time:
        for tick in ticks[1:]:
            axes.axvline(tick - 0.5 * _PAUSE, color="#dddddd", linewidth=0.6)
