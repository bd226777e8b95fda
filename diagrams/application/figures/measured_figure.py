"""One picture of what was measured, before anything is learned: a wrong frame or clock is seen at once."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slipmap.diagrams.application.figures import style
from slipmap.diagrams.systems.look import BELIEF, FAINT, FINGER, INK, styled
from slipmap.models.measurements import PushDataset
from slipmap.models.measurements.contact import CALIBRATION_ERROR, gaps

_MOST_DRAWN = 24  # pushes
_ROWS = 400  # of a push
_PAUSE = 0.3  # s between two pushes
_FARTHEST = 0.03  # m of air that is drawn


@styled
def measured_figure(dataset: PushDataset) -> Figure:
    """Pushes on the table, and contact gap and force over time, one push after the other.

    The gap is the air between the finger's rim and the outline: near zero while the object moves, and never
    below. Of many pushes two dozen are drawn, evenly chosen.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=2, heldout=0)
        >>> len(slipmap.measured_figure(dataset).axes)
        3
    """
    places = np.unique(np.linspace(0, len(dataset.trials) - 1, _MOST_DRAWN).astype(int))
    trials = [dataset.trials[place] for place in places]
    figure = Figure(figsize=(9.6, 4.6))
    table = figure.add_axes((0.06, 0.11, 0.38, 0.78))
    gap_axes = figure.add_axes((0.53, 0.55, 0.45, 0.34))
    force_axes = figure.add_axes((0.53, 0.11, 0.45, 0.34), sharex=gap_axes)
    now, ticks, largest = 0.0, [], 0.0
    for trial in trials:
        first, last = trial.object_pose.values[[0, -1]]
        style.draw_outline(table, dataset.grid, first, color=FAINT, width=0.7)
        style.draw_outline(table, dataset.grid, last, width=0.9, alpha=0.8)
        begin, end = trial.object_pose.time[[0, -1]]
        if trial.has_finger:
            time = np.linspace(begin, end, _ROWS)
            near = (time >= trial.tip_pose.time[0]) & (time <= trial.tip_pose.time[-1])
            tips, poses = trial.tip_pose.at(time[near]), trial.object_pose.at(time[near])
            table.plot(*tips.T, color=FINGER, linewidth=0.9)
            table.plot(*tips[:1].T, "o", color=FINGER, markersize=3.0)
            if not trial.ends_only:
                gap = np.minimum(gaps(dataset, tips, poses), _FARTHEST)
                gap_axes.plot(now + time[near] - begin, 1e3 * gap, color=BELIEF, linewidth=0.8)
        if trial.ft_wrench is not None:
            force = np.hypot(*trial.ft_wrench.values[:, :2].T)
            force_axes.plot(now + trial.ft_wrench.time - begin, force, color=INK, linewidth=0.6)
            largest = max(largest, float(np.percentile(force, 99)))
        ticks.append(now)
        now += end - begin + _PAUSE
    if largest > 0.0:  # the blow of a touch may be ten times the force of a push
        force_axes.set_ylim(-0.05 * largest, 1.3 * largest)
    _label(table, gap_axes, force_axes, ticks, now)
    more = "" if len(trials) == len(dataset.trials) else f", {len(trials)} of {len(dataset.trials)} pushes"
    figure.text(0.06, 0.985, f"{dataset.name}: what was measured{more}", va="top", fontsize=11)
    return figure


def _label(table: Axes, gap_axes: Axes, force_axes: Axes, ticks: list[float], end: float) -> None:
    table.set_aspect("equal", adjustable="datalim")
    table.autoscale_view()
    table.set(xlabel="x, m", ylabel="y, m")
    table.set_title("outlines before (grey) and after, way of the finger", loc="left", color=FAINT)
    gap_axes.axhspan(-1e3 * CALIBRATION_ERROR, 1e3 * CALIBRATION_ERROR, color="#f1efea", linewidth=0)
    gap_axes.axhline(0.0, color=FAINT, linewidth=0.8)
    gap_axes.set_ylabel("air, mm")
    gap_axes.set_title("between finger and outline; below 0 it is inside", loc="left", color=FAINT)
    force_axes.set(ylabel="force, N", xlabel="time, s, one push after the other", xlim=(0.0, max(end, 1e-3)))
    for axes in (gap_axes, force_axes):
        for tick in ticks[1:]:
            axes.axvline(tick - 0.5 * _PAUSE, color="#dddddd", linewidth=0.6)
