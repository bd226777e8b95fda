"""Figure of what an effect does to one push of one object, with its formula."""

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slipmap.diagrams.application.figures.style import draw_finger, draw_outline, scale_bar
from slipmap.diagrams.systems.look import BELIEF, FAINT, FINGER, INK, OTHER, PAPER, styled
from slipmap.models.effects import Effect, Scene
from slipmap.models.effects.effect import bounds, scales
from slipmap.models.effects.written import Written, written
from slipmap.models.geometry import placed
from slipmap.models.inference.effect_words import unit_text
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.paper_notation import add
from slipmap.models.physics.rollout import Maps, Push, Rollouts, Slider, Smoothing

_SHARES = (0.33, 0.66, 1.0)  # shares of the amplitude at which the effect is clearly visible

_SHOWS_WELL = 0.02
"""Target distance between the object with and without the effect, m, if its bounds allow it."""

_MASS, _FRICTION, _FINGER_FRICTION, _RADIUS = 0.8, 0.25, 0.4, 0.008
_SPEED, _RAMP, _WAY, _OFF_CENTRE, _STEP, _REST = 0.15, 0.3, 0.12, 0.008, 1e-3, 0.2
_START = np.array([-0.06, -0.03, 0.3])
_ORDER = 10
_SMOOTHING = Smoothing(penetration=1e-4)
_TINTS = (0.35, 0.6, 1.0)

_SIZE_LINE, _MEANING, _FORMULA = 0.18, 0.28, 0.42  # inches
_FARTHEST = 0.4
"""Farthest distance from the push at which places of an effect are drawn, m; farther ones would shrink it."""


@styled
def effect_figure(effect: Effect) -> Figure:
    """One object pushed off-centre, without the effect and with it at three sizes. The full size and the
    formulas are below. Crosses are places of the effect, on the table or on the object at full size.

    Raises:
        EffectError: the formula cannot be used.
        TypeError: something other than an effect, such as a belief.

    Example:
        >>> import slipmap
        >>> (tilt,) = slipmap.effects_named(["table_tilt"])
        >>> type(slipmap.figures.effect_figure(tilt)).__name__
        'Figure'
    """
    if not isinstance(effect, Effect):
        raise TypeError(
            f"effect_figure draws an Effect, such as (tilt,) = slipmap.effects_named(['table_tilt']), not a"
            f" {type(effect).__name__}"
        )
    grid, push = _brick(), _push()
    plain = Slider(grid, _RADIUS, smoothing=_SMOOTHING).rollout(_maps(grid, np.zeros((1, 0))), [push])
    slider = Slider(grid, _RADIUS, effects=[effect], smoothing=_SMOOTHING)
    values = _shown_values(effect, slider, push, plain)
    rows = np.vstack([effect.nulls + share * (values - effect.nulls) for share in _SHARES])
    rows = np.where(effect.amplitudes, rows, values)
    out = slider.rollout(_maps(grid, rows), [push])

    text = written(effect)
    size = textwrap.wrap(f"Full size: {_numbers(effect, text, values)}.", 125, break_on_hyphens=False)
    below = 0.55 + _SIZE_LINE * len(size) + sum(_heights(text))
    figure = Figure(figsize=(9.0, 4.1 + below))
    height = figure.get_size_inches()[1]
    figure.text(0.02, 1 - 0.13 / height, effect.name, va="top", fontsize=12, fontweight="bold")
    sentence = "\n".join(textwrap.wrap(effect.sentence, 110))
    figure.text(0.02, 1 - 0.4 / height, sentence, va="top", fontsize=9.5)
    bottom, top = below / height, 1 - 0.8 / height
    table = figure.add_axes((0.02, bottom, 0.52, top - bottom))
    _pushes(table, grid, push, plain, out, _places(effect, values, out.poses[-1, -1]))
    middle = bottom + 0.5 * (top - bottom)
    gap = 0.3 / height
    _distances(figure.add_axes((0.63, middle + gap, 0.35, top - middle - gap)), grid, push, plain, out)
    forces = figure.add_axes((0.63, bottom + gap / 2, 0.35, middle - bottom - gap))
    _forces(forces, push, plain, out, by_component=effect.only_force)
    begin = below - 0.42
    figure.text(0.02, begin / height, "\n".join(size), va="top", fontsize=9, linespacing=1.35)
    _formulas(figure, text, begin - _SIZE_LINE * len(size), height)
    return figure


def _numbers(effect: Effect, text: Written, values: FloatArray) -> str:
    """Parameters (P,) in words, with their names in the formulas."""
    return ", ".join(
        f"{text.symbols[q.name]} {value + 0.0:.3g}{unit_text(q.unit).replace(' 1/', '/')}"
        for q, value in zip(effect.parameters, values, strict=True)
    )


def _places(effect: Effect, values: FloatArray, pose: FloatArray) -> list[tuple[str, FloatArray]]:
    """Names and places (2,) on the table, m, given by the parameters (P,) of an effect.

    A place is a pair of lengths, …x and …y, that only shape the effect. If its meaning mentions the object
    frame, it moves with the object, which is at `pose` (3,).
    """
    shaping = {
        q.name: (q, value) for q, value in zip(effect.parameters, values, strict=True) if q.null is None
    }
    places = []
    for name, (x, value) in shaping.items():
        other = f"{name[:-1]}y"
        if x.unit == "m" and name.endswith("x") and other in shaping:
            point = np.array([value, shaping[other][1]])
            carried = "object frame" in x.meaning
            places.append((name[:-1].rstrip("_") or effect.name, placed(point, pose) if carried else point))
    return places


def _brick() -> CellGrid:
    width = 0.02
    x, y = np.meshgrid((np.arange(6) - 2.5) * width, (np.arange(4) - 1.5) * width)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [0.06, 0.04]
    return CellGrid(np.column_stack([x.ravel(), y.ravel()]), width, corners)


def _maps(grid: CellGrid, rows: FloatArray) -> Maps:
    """One object with K rows of parameters (K, P)."""
    K, n = len(rows), len(grid)
    return Maps(np.full((K, n), _MASS / n), np.full((K, n), _FRICTION), np.full(K, _FINGER_FRICTION), rows)


def _push() -> Push:
    """A straight push along the object's x from a gentle start to an abrupt stop, then a pause in which the
    object slides on."""
    moving, rest = round((_WAY / _SPEED + _RAMP / 2) / _STEP), round(_REST / _STEP)
    time = _STEP * np.minimum(np.arange(moving + rest + 1), moving)
    way = _SPEED * np.where(time < _RAMP, time**2 / (2 * _RAMP), time - _RAMP / 2)
    local = np.column_stack([way - 0.06 - _RADIUS, np.full(len(way), -_OFF_CENTRE)])
    times = _STEP * np.arange(1, len(way), dtype=float)
    return Push(
        _STEP, placed(local, _START), _START, pose_times=times, force_times=times - _STEP / 2, order=_ORDER
    )


def _shown_values(effect: Effect, slider: Slider, push: Push, plain: Rollouts) -> FloatArray:
    """(P,) parameters at which the effect is clearly visible: the start value of a search at which it shows
    best, at the smallest power of two of its scale that suffices."""
    grid, weight = slider.grid, _MASS * 9.81
    scene = Scene((0.0, 0.0), 0.12, 0.072, _SPEED, 20, weight)
    low, high = bounds([effect])
    starts = effect.start_values(scene)
    size = scales([effect], weight)
    best, reached = starts[0], 0.0
    for doubling in range(7):
        rows = np.where(effect.amplitudes, np.clip(effect.nulls + 2.0**doubling * size, low, high), starts)
        out = slider.rollout(_maps(grid, rows), [push])
        gap = np.array([add(poses, plain.poses[0], grid.centers).max() for poses in out.poses])
        before = float(np.hypot(*plain.forces[0].T).mean())
        change = np.abs(np.hypot(*np.moveaxis(out.forces, -1, 0)).mean(axis=1) / before - 1)
        if effect.only_force:
            change = np.hypot(*np.moveaxis(out.forces - plain.forces, -1, 0)).mean(axis=1) / before
        # Doubling an effect at its limit does not make it more visible.
        if gap.max() > 2e-3 and gap.max() < 1.2 * reached:
            break
        reached = float(gap.max())
        best = rows[int(np.argmax(gap))]
        # Some effects show in the force only; it may at most double.
        if gap.max() >= _SHOWS_WELL or change.max() > 0.5:
            break
    return best


def _pushes(
    axes: Axes,
    grid: CellGrid,
    push: Push,
    plain: Rollouts,
    out: Rollouts,
    places: Sequence[tuple[str, FloatArray]],
) -> None:
    draw_outline(axes, grid, push.start_pose, color=FAINT, width=0.8, fill=PAPER)
    axes.plot(*push.tip.T, color=FINGER, linewidth=1.0)
    draw_finger(axes, push.tip[0], push.tip[-1], _RADIUS)
    for poses, tint in zip(out.poses, _TINTS, strict=True):
        draw_outline(axes, grid, poses[-1], color=BELIEF, width=1.3, alpha=tint)
        axes.plot(*poses[:, :2].T, color=BELIEF, alpha=tint, linewidth=1.0)
    draw_outline(axes, grid, plain.poses[0, -1], width=1.3)
    axes.plot(*plain.poses[0, :, :2].T, color=INK, linewidth=1.0, linestyle="--")
    drawn = [push.start_pose, plain.poses[0, -1], *out.poses[:, -1]]
    points = np.vstack([push.tip, *(placed(grid.exterior, pose) for pose in drawn)])
    near = [
        (name, place) for name, place in places if np.linalg.norm(place - points.mean(axis=0)) < _FARTHEST
    ]
    for name, place in near:
        axes.plot(*place, "X", color=OTHER, markersize=8, markeredgecolor="white", zorder=4)
        axes.annotate(
            name, (place[0], place[1]), (7, 4), textcoords="offset points", fontsize=8.5, color=OTHER,
            zorder=4,
        )  # fmt: skip
    points = np.vstack([points, *(place for _, place in near)])
    low, high = points.min(axis=0) - 0.015, points.max(axis=0) + 0.015
    axes.set(xlim=(low[0], high[0]), ylim=(low[1] - 0.012, high[1]), aspect="equal", xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    scale_bar(axes, low + np.array([0.005, 0.0]), float((high - low).max()))


def _distances(axes: Axes, grid: CellGrid, push: Push, plain: Rollouts, out: Rollouts) -> None:
    times = np.asarray(push.pose_times)
    for poses, tint in zip(out.poses, _TINTS, strict=True):
        axes.plot(
            times, 1e3 * add(poses, plain.poses[0], grid.centers), color=BELIEF, alpha=tint, linewidth=1.2
        )
    axes.set(ylabel="distance from\nthe plain model, mm", xticklabels=[], ylim=(0, None), xlim=(0, times[-1]))


def _forces(axes: Axes, push: Push, plain: Rollouts, out: Rollouts, *, by_component: bool) -> None:
    """Plot the finger's force, magnitude or both components, averaged over 20 ms so that the first touch does
    not hide the rest."""

    def smooth(forces: FloatArray) -> FloatArray:
        rows = forces.T if by_component else np.hypot(*forces.T)[None]
        return np.array([np.convolve(row, np.full(20, 1 / 20), mode="same") for row in rows])

    times = np.asarray(push.force_times)
    axes.plot(times, smooth(plain.forces[0])[0], color=INK, linewidth=1.2, linestyle="--", label="without")
    for forces, tint, share in zip(out.forces, _TINTS, ("a third", "two thirds", "full size"), strict=True):
        axes.plot(times, smooth(forces)[0], color=BELIEF, alpha=tint, linewidth=1.2, label=share)
    every = np.array([smooth(f) for f in (plain.forces[0], *out.forces)])
    for row, (color, tint) in zip(every, [(INK, 1.0), *((BELIEF, tint) for tint in _TINTS)], strict=True):
        axes.plot(times, row[1:].T, color=color, alpha=tint, linewidth=1.2, linestyle=":")
    high, low = every[..., 100:].max(), min(0.0, every[..., 100:].min())
    label = "force (dotted: y), N" if by_component else "force, N"
    axes.set(xlabel="time, s", ylabel=label, xlim=(0, times[-1]), ylim=(1.25 * low, 1.25 * high))
    axes.legend(
        loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=4, handlelength=1.3, columnspacing=1.0,
        fontsize=7.5,
    )  # fmt: skip


def _heights(text: Written) -> list[float]:
    """Height in inches of each formula with its heading."""
    return [_FORMULA + (_MEANING if formula.meaning else 0.0) for formula in text.formulas]


def _formulas(figure: Figure, text: Written, top: float, height: float) -> None:
    """Write the formulas downwards from `top` inches above the lower edge of a figure of `height` inches."""
    for formula, needed in zip(text.formulas, _heights(text), strict=True):
        if formula.meaning:
            meaning = f"{formula.meaning[0].upper()}{formula.meaning[1:]}:"
            figure.text(0.02, (top - 0.5 * _MEANING) / height, meaning, va="center", fontsize=9)
        top -= needed
        middle = (top + 0.5 * _FORMULA) / height
        figure.text(0.03, middle, f"${formula.latex}$", va="center", fontsize=11, parse_math=True)
