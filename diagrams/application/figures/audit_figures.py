"""Friction of a physics engine by direction, and where its pushes end."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from slipmap.diagrams.application.audit.procedure import Audit
from slipmap.diagrams.application.figures.style import draw_outline, light_grid, scale_bar
from slipmap.diagrams.systems.look import BELIEF, FAINT, FINGER, INK, styled


@styled
def friction_figure(audit: Audit) -> Figure:
    """Polar plot: friction over Coulomb's by the direction of motion; a line at each shows its direction."""
    figure = Figure(figsize=(4.6, 4.6), layout="constrained")
    axes = figure.add_subplot(projection="polar")
    angle = np.arctan2(*audit.answers.direction.T[::-1])
    size = np.linalg.norm(audit.answers.friction, axis=1)
    around = np.linspace(0, 2 * np.pi, 361)
    axes.plot(around, np.ones_like(around), color=FAINT, linewidth=1.0, label="Coulomb's law")
    place = audit.answers.direction * size[:, None]
    for at, force in zip(place, -audit.answers.friction, strict=True):
        tip = at + 0.25 * force
        ends = np.array([at, tip])
        axes.plot(np.arctan2(ends[:, 1], ends[:, 0]), np.hypot(*ends.T), color=FINGER, linewidth=1.0)
    axes.plot(angle, size, "o", color=BELIEF, markersize=4, label=audit.name)
    axes.set_ylim(0, max(1.5, 1.1 * size.max() + 0.25))
    axes.set_yticks([0.5, 1.0, 1.5])
    axes.grid(color="#e7e4dd", linewidth=0.6)
    axes.spines["polar"].set_color("#e7e4dd")
    axes.legend(loc="upper left", bbox_to_anchor=(-0.1, 1.1))
    return figure


@styled
def ends_figure(audit: Audit) -> Figure:
    """The four pushes that end farthest from Coulomb's law: start, end by the law, end in the engine."""
    figure = Figure(figsize=(7.2, 2.2), layout="constrained")
    worst = np.argsort(audit.pushed.errors)[::-1][:4]
    for axes, k in zip(figure.subplots(1, 4), worst, strict=True):
        grid, standard = audit.standard.scene.grid, audit.standard
        draw_outline(axes, grid, standard.starts[k], color=FAINT)
        draw_outline(axes, grid, standard.law[k], color=INK)
        draw_outline(axes, grid, audit.pushed.ends[k], color=BELIEF, width=1.4)
        axes.set_aspect("equal")
        axes.autoscale()
        axes.axis("off")
        axes.set_title(f"{1e3 * audit.pushed.errors[k]:.1f} mm")
        left, right = axes.get_xlim()
        scale_bar(axes, (left, axes.get_ylim()[0]), right - left)
    return figure


@styled
def prices_figure(prices: Mapping[str, float]) -> Figure:
    """Bars: how far engines end from Coulomb's law, m."""
    figure = Figure(figsize=(7.2, 0.5 + 0.28 * len(prices)), layout="constrained")
    axes = figure.add_subplot()
    names = list(prices)
    values = 1e3 * np.array([prices[name] for name in names])
    axes.barh(names, values, color=BELIEF, height=0.6)
    for place, value in enumerate(values):
        axes.annotate(
            f"{value:.2f}", (value, place), (3, 0), textcoords="offset points", va="center", fontsize=8
        )
    axes.invert_yaxis()
    axes.set_xlim(0, 1.12 * max(values.max(), 0.1))
    axes.set_xlabel("mean distance from Coulomb's law at the end of a push, mm")
    light_grid(axes, "x")
    return figure
