"""Figures of a diagnosis: gains of all candidates, errors of locked pushes, and the next push."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import LogLocator

from slipmap.diagrams.application.figures.style import draw_finger, draw_outline, light_grid, scale_bar
from slipmap.diagrams.application.reports.comparison_words import short_name
from slipmap.diagrams.application.reports.diagnosis_words import nats
from slipmap.diagrams.systems.look import BELIEF, FAINT, FINGER, INK, OTHER, PAPER, styled
from slipmap.models.geometry import placed
from slipmap.models.inference.diagnosis.results import (
    DatasetResult,
    Diagnosis,
    JointDiagnosis,
    ParameterEstimate,
)
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.paper_notation import add
from slipmap.planners.rehearsal import Predictions, predict
from slipmap.planners.telling_push import push_of, rivals_of

_NAMES, _PANEL, _ROW = 1.68, 2.1, 0.235  # inches
_LOCKED, _LETTER = 3.8, 0.075  # inches
_ALARM = "#a3341f"
_PALE = "#c9c5bb"
_COLOURS = (BELIEF, OTHER, "#a03070", "#806000", "#5050a0", "#40a0c0", "#909090", "#c08080")  # of rivals
_LEGEND_COLUMNS = 4


@styled
def gain_figure(diagnosis: Diagnosis) -> Figure:
    """Bars for every candidate: first-order gain, gain when refitted, and what another candidate still gains.

    What another still gains is of first order too and drawn on the scale of the first panel: if it is short
    beside the candidate's own gain, little is left. Refitted gains have their own scale. A dash stands for
    what is not computed: an effect that gains too little is not refitted.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=3, heldout=1)
        >>> diagnosis = slipmap.diagnose(dataset, quick=True, draws=99)
        >>> type(slipmap.figures.gain_figure(diagnosis)).__name__
        'Figure'
    """
    candidates = diagnosis.candidates
    gains: list[float | None] = [c.gain for c in candidates]
    fitted = [c.fitted_gain for c in candidates]
    left = [c.remaining_gain for c in candidates]
    plain = [OTHER if c.in_set else _PALE for c in candidates]
    judged = [_ALARM if c.rejected_by is not None else own for c, own in zip(candidates, plain, strict=True)]
    first_order = _longest(gains + left)
    panels = (
        ("gain to first order", gains, plain, first_order),
        ("gain when refitted", fitted, plain, _longest(fitted)),
        ("left to gain on top of it", left, judged, first_order),
    )
    return _panels_of_bars([(c.name, c.in_set) for c in candidates], panels)


@styled
def joint_gain_figure(diagnosis: JointDiagnosis) -> Figure:
    """Bars for every candidate of several datasets: first-order gain, gain when refitted, and evidence."""
    candidates = diagnosis.candidates
    colours = [OTHER if c.in_set else _ALARM if c.objection is not None else _PALE for c in candidates]
    columns: tuple[tuple[str, list[float | None]], ...] = (
        ("gain to first order", [c.first_gain for c in candidates]),
        ("gain when refitted", [c.gain for c in candidates]),
        ("evidence", [c.evidence for c in candidates]),
    )
    panels = [(title, values, colours, _longest(values)) for title, values in columns]
    labels = {_ALARM: "ruled out: the locked pushes object"}
    return _panels_of_bars([(c.name, c.in_set) for c in candidates], panels, labels)


def _panels_of_bars(
    names: Sequence[tuple[str, bool]],
    panels: Sequence[tuple[str, Sequence[float | None], Sequence[str], float]],
    labels: Mapping[str, str] = MappingProxyType({}),
) -> Figure:
    """Panels of bars, one row for each name.

    Args:
        names: of the candidates, and whether each is in the answer.
        panels: title, values, colours and longest bar of each; those without any value are left out.
        labels: of colours, where they mean something else than usual.
    """
    height = 0.62 + _ROW * len(names) + 0.12
    bottom, top = 0.12 / height, 1 - 0.62 / height
    shown = [panel for panel in panels if any(value is not None for value in panel[1])]
    width = _NAMES + _PANEL * len(shown)
    figure = Figure(figsize=(width, height))
    for k, (title, values, colours, longest) in enumerate(shown):
        axes = figure.add_axes(((_NAMES + _PANEL * k) / width, bottom, 0.85 * _PANEL / width, top - bottom))
        _bars(axes, values, colours, longest)
        axes.set_title(f"{title}, nats", loc="left", fontsize=9)
        if k == 0:
            axes.set_yticks(range(len(names)), [name for name, _ in names])
            for label, (_, answer) in zip(axes.get_yticklabels(), names, strict=True):
                label.set_fontweight("bold" if answer else "normal")
    handles = [
        Line2D([], [], color=colour, linewidth=6, label=labels.get(colour, label))
        for colour, label in (
            (OTHER, "not ruled out"),
            (_PALE, "ruled out, or no more than chance"),
            (_ALARM, "ruled out: another gains on top"),
        )
        if any(colour in colours for _, _, colours, _ in shown)
    ]
    if len(handles) > 1:
        figure.legend(
            handles=handles, loc="upper right", ncols=3, handlelength=1.0, bbox_to_anchor=(1.0, 1.0)
        )
    if any(value is None for _, values, _, _ in shown for value in values):
        figure.text(0.06 / width, top + 0.09 / height, "– not computed", fontsize=8, color=FAINT)
    return figure


def _longest(values: Sequence[float | None]) -> float:
    """The largest gain, and more than zero."""
    return max([1e-9, *(value for value in values if value is not None)])


def _bars(axes: Axes, values: Sequence[float | None], colours: Sequence[str], longest: float) -> None:
    """Draw bars from zero; `longest` nearly fills the axes, negative gains are numbers only."""
    rows = np.arange(len(values))
    known = np.array([np.nan if value is None else value for value in values])
    drawn = np.clip(np.nan_to_num(known), 0.0, None)
    axes.barh(rows, drawn, color=list(colours), height=0.62)
    for row, value, length in zip(rows, known, drawn, strict=True):
        text = "–" if np.isnan(value) else nats(value)
        axes.annotate(
            text, (length, row), (3, 0), textcoords="offset points", va="center", fontsize=8,
            color=FAINT if np.isnan(value) else INK,
        )  # fmt: skip
    axes.set(xlim=(0, 1.22 * longest), ylim=(len(values) - 0.45, -0.55), xticks=[], yticks=[])
    axes.spines["bottom"].set_visible(False)
    axes.tick_params(axis="y", length=0)


@styled
def locked_figure(diagnosis: Diagnosis) -> Figure:
    """Error along the path of each locked push, without and with the answer.

    Raises:
        ValueError: no push was locked away.
    """
    if diagnosis.before is None or diagnosis.after is None:
        raise ValueError("no push was locked away, so there is nothing to draw")
    before, after = 1e3 * diagnosis.before.path, 1e3 * diagnosis.after.path
    order = np.argsort(before)
    names = [short_name(diagnosis.locked[b]) for b in order]
    changed = bool(diagnosis.effect_objects)
    return _errors_changed(names, before[order], after[order] if changed else None)


@styled
def joint_locked_figure(datasets: Sequence[DatasetResult]) -> Figure:
    """Mean error along the path of each dataset's locked pushes, without and with the answer."""
    judged = [one for one in datasets if one.before is not None]
    before = np.array([1e3 * one.before.path.mean() for one in judged if one.before is not None])
    after = np.array([1e3 * one.after.path.mean() for one in judged if one.after is not None])
    return _errors_changed([one.name for one in judged], before, after if len(after) else None)


def _errors_changed(names: Sequence[str], before: FloatArray, after: FloatArray | None) -> Figure:
    """Errors along the path, mm, by name, and what they are with the answer, if there is one."""
    height = 0.85 + 0.21 * len(names)
    left = 0.25 + _LETTER * max(map(len, names))
    figure = Figure(figsize=(_LOCKED, height))
    axes = figure.add_axes((left / _LOCKED, 0.45 / height, 1 - (left + 0.15) / _LOCKED, 1 - 0.85 / height))
    rows = np.arange(float(len(names)))
    if after is not None:
        axes.hlines(rows, before, after, color=_PALE, linewidth=2.4)
        _dots(axes, after, rows, OTHER, "with the answer")
    _dots(axes, before, rows, BELIEF, "the model" if after is None else "without effects")
    every = before if after is None else np.concatenate([before, after])
    if every.max() > 5 * every.min():
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter("")
    axes.set_xlabel("error along the path (ADD), mm")
    axes.set_yticks(rows, names)
    axes.set_ylim(-0.7, len(names) - 0.3)
    light_grid(axes, "x")
    figure.legend(loc="upper right", ncols=2, handletextpad=0.2, bbox_to_anchor=(1.0, 1.0))
    return figure


def _dots(axes: Axes, values: FloatArray, rows: FloatArray, colour: str, label: str) -> None:
    axes.plot(values, rows, "o", color=colour, markersize=6, label=label, linestyle="none", zorder=3)


@styled
def alone_figure(datasets: Sequence[DatasetResult], together: Sequence[ParameterEstimate]) -> Figure:
    """Parameters of an effect from each dataset alone, beside the value from all of them.

    Args:
        datasets: those without estimates are left out.
        together: shared parameters to show, at least one.
    """
    shown = [one for one in datasets if one.alone]
    left = 0.25 + _LETTER * max(len(one.name) for one in shown)
    width, height = left + _PANEL * len(together), 0.85 + _ROW * len(shown)
    figure = Figure(figsize=(width, height))
    rows = np.arange(float(len(shown)))
    for k, whole in enumerate(together):
        place = ((left + _PANEL * k) / width, 0.45 / height, 0.88 * _PANEL / width, 1 - 0.6 / height)
        axes = figure.add_axes(place)
        axes.axvspan(whole.low, whole.high, color=OTHER, alpha=0.25, linewidth=0)
        axes.axvline(whole.value, color=OTHER, linewidth=1.4)
        own = [
            next(e for e in one.alone if (e.effect, e.name) == (whole.effect, whole.name)) for one in shown
        ]
        axes.hlines(rows, [e.low for e in own], [e.high for e in own], color=BELIEF, linewidth=1.4)
        axes.plot([e.value for e in own], rows, "o", color=BELIEF, markersize=4, linestyle="none")
        axes.set_yticks(rows, [one.name for one in shown] if k == 0 else [""] * len(shown))
        axes.set_ylim(len(shown) - 0.4, -0.6)
        axes.set_xlabel(whole.name + ("" if whole.unit == "1" else f", {whole.unit}"))
        axes.locator_params(axis="x", nbins=4)
        light_grid(axes, "x")
    return figure


@styled
def telling_push_figure(told: dict[str, Any] | None, diagnosis: Diagnosis, dataset: PushDataset) -> Figure:
    """Object, finger path and the ends that the rivals predict; beside it, how they diverge over time.

    Args:
        told: the proposed push, `next_push` of the diagnosis.
        diagnosis: result of `slipmap.diagnose`.
        dataset: the one that was diagnosed.

    Raises:
        ValueError: no push was proposed.
    """
    if told is None:
        raise ValueError("the diagnosis proposes no push: its next_push is None")
    grid = dataset.grid
    push = push_of(told, float(len(dataset.trials)))
    rivals = rivals_of(diagnosis, dataset)[: len(_COLOURS)]
    predictions = [predict(rival, [push]) for rival in rivals]
    figure = Figure(figsize=(8.0, 4.2))
    rows = -(-(len(rivals) + 1) // _LEGEND_COLUMNS)
    top, bottom = 0.97, 0.12 + 0.05 * rows
    axes = figure.add_axes((0.09, bottom, 0.46, top - bottom))
    draw_outline(axes, grid, told["pose"], color=FAINT, width=0.8, fill=PAPER)
    axes.plot(*np.array([told["tip_start"], told["tip_end"]]).T, color=FINGER, linewidth=1.2)
    draw_finger(axes, told["tip_start"], told["tip_end"], dataset.finger_radius)
    pose = np.array(told["pose"], dtype=float)
    contact = placed(np.array(told["contact"]), pose)
    axes.plot(*contact, marker="x", color=FINGER, markersize=6)
    ends = [predicted.poses[0, -1] for predicted in predictions]
    for end, predicted, colour in zip(ends, predictions, _COLOURS, strict=False):
        draw_outline(axes, grid, end, color=colour, width=1.4)
        axes.plot(*np.vstack([pose, predicted.poses[0]])[:, :2].T, color=colour, linewidth=1.0)
    outlines = placed(grid.exterior, np.array([pose, *ends])[:, None])
    points = np.vstack([told["tip_start"], told["tip_end"], outlines.reshape(-1, 2)])
    low, high = points.min(axis=0) - 0.015, points.max(axis=0) + 0.015
    low[1] -= 0.02
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set(xlabel="table x, m", ylabel="table y, m")
    axes.locator_params(nbins=6)
    axes.tick_params(labelsize=8)
    _table_edge(axes, dataset)
    scale_bar(axes, low + np.array([0.008, 0.014]), float((high - low).max()))
    handles = [Line2D([], [], color=FINGER, marker="o", label="finger (filled: end)")]
    for rival, colour in zip(rivals, _COLOURS, strict=False):
        handles.append(Line2D([], [], color=colour, label=rival.name))
    figure.legend(handles=handles, loc="lower center", ncols=min(len(handles), _LEGEND_COLUMNS))
    if len(rivals) > 1:
        _over_time(figure, bottom, top, np.asarray(push.pose_times), predictions, grid)
    return figure


def _over_time(
    figure: Figure,
    bottom: float,
    top: float,
    times: FloatArray,
    predictions: Sequence[Predictions],
    grid: CellGrid,
) -> None:
    """Draw how far predictions are from the first one, and the forces of all, at times (T,), s."""
    height = (top - bottom - 0.06) / 2
    lower = figure.add_axes((0.64, bottom, 0.34, height))
    upper = figure.add_axes((0.64, top - height, 0.34, height), sharex=lower)
    for predicted, colour in zip(predictions, _COLOURS, strict=False):
        apart = add(predicted.poses[0], predictions[0].poses[0], grid.centers)
        upper.plot(times, 1e3 * apart, color=colour)
        lower.plot(times - times[0] / 2, np.hypot(*predicted.forces[0].T), color=colour)
    upper.set(ylabel="distance from\nfirst model, mm", ylim=(0, None))
    upper.tick_params(labelbottom=False)
    lower.set(xlabel="time, s", ylabel="force, N", ylim=(0, None))
    upper.yaxis.label.set_fontsize(8)


def _table_edge(axes: Axes, dataset: PushDataset) -> None:
    table = dataset.table
    if table is None:
        return
    if table.radius is not None:
        axes.add_patch(Circle(table.center, table.radius, facecolor="none", edgecolor=INK, linewidth=0.8))
    elif table.size is not None:
        corner = np.asarray(table.center) - 0.5 * np.asarray(table.size)
        axes.add_patch(Rectangle(tuple(corner), *table.size, facecolor="none", edgecolor=INK, linewidth=0.8))
