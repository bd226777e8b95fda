"""`BeliefVisualizer`: draws the belief about the object over it in Meshcat.

`shown` turns a belief into colours and `legend` draws their scale; one of the application's pages uses both
too.
"""

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.systems.framework import Context

from slipmap.diagrams.systems.diagnosis import Repair
from slipmap.diagrams.systems.look import FAINT, INK, MAP_COLORS, beyond, styled, top_of_scale
from slipmap.diagrams.systems.loop_messages import LoopStatus
from slipmap.diagrams.systems.model_monitor import Watch
from slipmap.diagrams.systems.notice import INCH, NOTICE, Words, notice, words_of
from slipmap.diagrams.systems.python_system import DRAWN_EVERY, PythonSystem
from slipmap.diagrams.systems.unlit_meshes import arrow, billboard, painted, ribbon, ringed_discs, tiles
from slipmap.models.geometry import placed
from slipmap.models.inference.belief import Belief
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.settings import check_choice, check_positive

MAPS = ("mass", "friction", "mass x friction")
TITLES = ("mass of a cell, g", "friction coefficient of a cell", "mass × friction: force to slide a cell, mN")
MAGNIFIED = 5.0  # length of a residual arrow as a multiple of the residual
BLACK, ORANGE, RED, BLUE = (0.08, 0.08, 0.08), (0.93, 0.45, 0.08), (0.80, 0.10, 0.15), (0.12, 0.44, 0.71)

KEY = (
    (BLACK, "observed outline"),
    (ORANGE, "predicted outline"),
    (RED, f"residual × {MAGNIFIED:.0f}"),
    (BLUE, "path of the finger"),
)
"""Meaning of the colours over the object."""

BOARD = (0.69, 0.40)  # size of the legend, m
_ROUND = np.array([1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0])


@dataclass(frozen=True, eq=False)
class Shown:
    """The part of a belief that is drawn."""

    hypotheses: np.ndarray  # (k,) indices of the most probable ones, in order of falling probability
    # (3, 1 + k, n) the maps `MAPS` in the units of `TITLES`: first the mean over all hypotheses, then each of
    # `hypotheses`
    values: FloatArray
    # (3,) upper ends of the colour scales, which start at 0; the largest few per cent may lie beyond
    tops: FloatArray

    def beyond(self, which: int) -> str:
        """Whether values of map `which` exceed its scale, as the `extend` argument of `Figure.colorbar`."""
        return beyond(self.values[which], float(self.tops[which]))

    def colors(self, which: int, hypothesis: int) -> FloatArray:
        """(n, 3) sRGB of the cells on map `which`; hypothesis 0 is the mean."""
        share = np.clip(self.values[which, hypothesis] / self.tops[which], 0.0, 1.0)
        return colormaps[MAP_COLORS[which]](share)[:, :3]


def shown(belief: Belief, most: int, *, round_tops: bool = False) -> Shown:
    """The mean of a belief and its most probable hypotheses.

    Args:
        most: largest number of hypotheses.
        round_tops: whether scales end at round numbers, so that they seldom change with the belief; otherwise
            they end where those of `maps_figure` do for the same number of hypotheses.
    """
    maps, p = belief.maps, belief.probability
    hypotheses = np.argsort(-p, kind="stable")[:most]
    every = np.stack([1e3 * maps.mass, maps.mu, 1e3 * maps.mass * maps.mu * belief.gravity])
    values = np.concatenate([np.einsum("k,mkn->mn", p, every)[:, None], every[:, hypotheses]], axis=1)
    tops = [top_of_scale(v) for v in values]
    return Shown(hypotheses, values, np.array([_round_up(top) for top in tops] if round_tops else tops))


def rests_on(belief: Belief) -> str:
    """The basis of a belief, in a few words for a heading."""
    pushes = belief.taught
    return f"after {pushes} push{'es' * (pushes > 1)}" if pushes else f"of {len(belief)} hypotheses"


def _round_up(value: float) -> float:
    """The next round number."""
    if value <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * _ROUND[np.searchsorted(_ROUND, value / power * (1 - 1e-9))])


@styled
def legend(belief: Belief, what: Shown, which: int, basis: str) -> bytes:
    """PNG with the colour scale of map `which` and the probabilities of the hypotheses.

    Args:
        basis: basis of the belief, in a few words.
    """
    figure = _board(f"Belief {basis}")
    figure.text(0.05, 0.76, TITLES[which], fontsize=10.5, color=INK, va="center")
    bar = figure.add_axes((0.05, 0.62, 0.90, 0.085))
    scale = ScalarMappable(Normalize(0.0, what.tops[which]), colormaps[MAP_COLORS[which]])
    figure.colorbar(scale, cax=bar, orientation="horizontal", ticks=MaxNLocator(5), extend=what.beyond(which))
    bar.tick_params(labelsize=10)
    probability = belief.probability[what.hypotheses]
    figure.text(0.05, 0.45, "probability of the hypotheses", fontsize=10.5, color=INK, va="center")
    chart = figure.add_axes((0.13, 0.28, 0.82, 0.13))
    chart.bar(np.arange(1, len(probability) + 1), probability, color=INK, width=0.7)
    chart.set_xlim(0.3, max(len(probability), 4) + 0.7)
    chart.xaxis.set_major_locator(MaxNLocator(12, integer=True))
    chart.yaxis.set_major_locator(MaxNLocator(2))
    chart.tick_params(labelsize=9)
    return _png(figure)


@styled
def blank_legend() -> bytes:
    """PNG of the board while there is no belief."""
    figure = _board("No belief yet")
    text = "The maps appear once the first push\nhas been learned from."
    figure.text(0.05, 0.62, text, fontsize=11.5, color=INK, va="center", linespacing=1.5)
    return _png(figure)


def _board(title: str) -> Figure:
    """A board with its title and the key to the colours over the object."""
    figure = Figure(figsize=(BOARD[0] * INCH, BOARD[1] * INCH), dpi=220)
    figure.patch.set_edgecolor(FAINT)
    figure.patch.set_linewidth(2.0)
    figure.text(0.05, 0.90, title, fontsize=14, color=INK, va="center", weight="bold")
    for k, (color, meaning) in enumerate(KEY):
        place = (0.05 + 0.47 * (k % 2), 0.125 - 0.075 * (k // 2))
        figure.text(*place, "\u25a0", fontsize=11, color=color, va="center")
        figure.text(place[0] + 0.05, place[1], meaning, fontsize=10, color=INK, va="center")
    return figure


def _png(figure: Figure) -> bytes:
    stream = BytesIO()
    figure.savefig(stream, format="png", edgecolor=figure.get_edgecolor())
    return stream.getvalue()


MOST = 12  # hypotheses that can be viewed one by one; the mean includes all of them

_ARROWS = 8  # residual arrows, on cells spread over the object
LEAST_RESIDUAL = 3e-4  # shorter residuals are not drawn, m
CLEARANCE = 2e-3  # gap between the object's highest cell and the tiles, m

VIEW = ((0.56, -0.56, 0.56), (0.07, 0.07, 0.12))
"""Camera position and target that show the whole table and board from close by, m."""

BOARD_PLACE = (0.29, 0.55, 0.31)  # centre of the board, beside the table and behind it as seen from `VIEW`, m
HYPOTHESIS = "hypothesis (0: mean)"
MAP = "map (0: mass, 1: friction, 2: both)"


class BeliefVisualizer(PythonSystem):
    """Draws a belief, and how well it predicts, in Meshcat.

    Inputs, all optional:
        belief: abstract, `Belief` or None, for example from `Identification`.
        object_pose: abstract, `ObservedPose` of the object frame in the world, m and rad: from a camera, from
            a `TrialLogger`, or from `ObservedPose.of` and a pose (3,).
        predicted_pose: (3,) x, y (m), θ (rad) in the world; NaN where there is none.
        push: abstract, None, a `TablePush`, or an `ActivePush`, which has one as its `push`.
        status: abstract, `LoopStatus` of the loop; watch: abstract, `Watch` from a `ModelMonitor`; repair:
            abstract, `Repair` from a `Diagnosis`.
        seen_object: abstract, `SeenObject` or None: with it, the tiles lie `CLEARANCE` above its highest
            `cell_heights` (m) instead of at `height`.

    Drawn over the object, where it was last seen: its cells as tiles coloured by mass, friction or their
    product; the observed outline (black) and the predicted one (orange); residual arrows from predicted to
    observed cells, magnified by `MAGNIFIED` (red); and the hypotheses' centres of mass, larger for higher
    probability (white). The push is drawn on the table (blue). A board shows the colour scale and the
    probabilities; it is empty until there is a belief. A notice above it says what the robot is doing and
    why, with the error of each push, as far as `status`, `watch` and `repair` tell. Sliders choose the
    hypothesis (by falling probability) and the map; like all inputs, they are read when this system
    publishes.

    A Meshcat recording stores only transforms and properties. Every map of every belief is therefore a
    separate object, made visible when it is due; a page from `StaticHtml` shows the maps chosen while
    recording.

    What has been drawn is state of the Meshcat, not of a Context: use one visualizer per Meshcat and path.

    Args:
        path: of everything drawn, in the scene tree.
        height: of the tiles above the table, m, without a `seen_object`.
        period: of drawing, s.
        X_WB: pose of the board; its picture is in the plane y = 0, seen from -y. By default it stands beside
            the table and faces a camera at `VIEW`.
        which: index of the map to begin with, see `MAPS`. By default it is the product, the one that slow
            pushes show.

    Raises:
        TypeError: no Meshcat.
        ValueError: the period is not positive, or there is no such map.

    Example:
        >>> import slipmap
        >>> from pydrake.geometry import Meshcat
        >>> visualizer = slipmap.BeliefVisualizer(Meshcat())
        >>> visualizer.HasInputPort("belief"), visualizer.HasInputPort("object_pose")
        (True, True)
    """

    def __init__(
        self,
        meshcat: Meshcat,
        *,
        path: str = "/belief",
        height: float = 0.05,
        period: float = DRAWN_EVERY,
        X_WB: RigidTransform | None = None,
        which: int = 2,
    ) -> None:
        super().__init__()
        check_positive("BeliefVisualizer: period", period, "s")
        check_choice("BeliefVisualizer: which", which, range(len(MAPS)))
        if not hasattr(meshcat, "SetObject"):
            got = "None" if meshcat is None else f"a {type(meshcat).__name__}"
            raise TypeError(f"BeliefVisualizer: meshcat must be a pydrake.geometry.Meshcat, got {got}")
        self._meshcat = meshcat
        self._path = path
        self._height = height
        self._board = X_WB or RigidTransform(RollPitchYaw(-0.3, 0.0, np.pi / 4), BOARD_PLACE)
        self.declare_inputs("belief", "object_pose", belief=Belief)
        self.DeclareVectorInputPort("predicted_pose", 3)
        self.declare_inputs("push", "seen_object", "status", "watch", "repair")
        self._forget()
        for name in (HYPOTHESIS, MAP):
            meshcat.DeleteSlider(name, strict=False)
        meshcat.AddSlider(HYPOTHESIS, 0, MOST, 1, 0, "ArrowLeft", "ArrowRight")
        meshcat.AddSlider(MAP, 0, len(MAPS) - 1, 1, which, "ArrowDown", "ArrowUp")
        self.DeclarePeriodicPublishEvent(period, 0.0, self._draw)
        self.DeclareForcedPublishEvent(self._draw)

    def delete(self) -> None:
        """Remove everything drawn from the Meshcat."""
        self._meshcat.Delete(self._path)
        self._forget()

    def _forget(self) -> None:
        self._level = self._height
        self._drawn_belief: Belief | None = None
        self._beliefs = 0
        self._has_blank_board = False
        self._shown_hypotheses = 0
        self._drawn_push: tuple[float, ...] = ()
        self._pushes = 0
        self._told: tuple[Words | None, list[float]] = (None, [])
        self._notices = 0
        self._visible: dict[str, str] = {}
        self._outlined: CellGrid | None = None
        self._arrows = np.zeros(0, dtype=int)

    def _draw(self, context: Context) -> None:
        time = context.get_time()
        belief, seen, predicted, push, seen_object = (
            self.optional_input(context, name)
            for name in ("belief", "object_pose", "predicted_pose", "push", "seen_object")
        )
        self._level = self._height
        if seen_object is not None:
            self._level = float(np.max(seen_object.cell_heights)) + CLEARANCE
        if belief is not None and not belief.same_as(self._drawn_belief):
            self._add_belief(belief)
        if belief is None:  # before the first push, also of a simulation that starts again
            self._show_no_belief(time)
        else:
            self._choose(time)
            observed = seen.pose if seen is not None and seen.valid else None
            if predicted is not None and not np.isfinite(predicted).all():
                predicted = None
            self._place(observed, predicted, time)
        self._draw_push(getattr(push, "push", push), time)
        status, watch, repair = (self.optional_input(context, name) for name in ("status", "watch", "repair"))
        self._sign(status, watch, repair, belief, time)

    def _show_no_belief(self, time: float) -> None:
        """Show an empty board and hide what was drawn of earlier beliefs."""
        if not self._has_blank_board:
            self._has_blank_board = True
            self._hidden("board/0", billboard(blank_legend(), *BOARD))
            self._meshcat.SetTransform(f"{self._path}/board", self._board, 0.0)
        self._show("board", "board/0", time)
        if self._drawn_belief is not None:
            for place in ("tiles", "centers", "observed"):
                self._show(place, "", time)
            self._place(None, None, time)

    def _sign(
        self,
        status: LoopStatus | None,
        watch: Watch | None,
        repair: Repair | None,
        belief: Belief | None,
        time: float,
    ) -> None:
        """Show a notice above the board, if there is anything to say."""
        words = words_of(status, watch, repair, belief)
        if words is None:
            self._show("notice", "", time)
            return
        errors = [] if watch is None else [push.error for push in watch.judged]
        if (words, errors) != self._told:
            self._told = (words, errors)
            self._notices += 1
            self._hidden(f"notice/{self._notices}", billboard(notice(words, errors), *NOTICE))
            above = np.array([0.0, 0.0, (BOARD[1] + NOTICE[1]) / 2 + 0.01])
            self._meshcat.SetTransform(f"{self._path}/notice", self._board @ RigidTransform(above), 0.0)
        self._show("notice", f"notice/{self._notices}", time)

    def _add_belief(self, belief: Belief) -> None:
        """Add all objects of a belief, still invisible."""
        self._drawn_belief = belief
        self._beliefs += 1
        what = shown(belief, MOST, round_tops=True)
        self._shown_hypotheses = len(what.hypotheses)
        if belief.grid is not self._outlined:
            self._add_outlines(belief.grid)
        for which, name in enumerate(MAPS):
            for hypothesis in range(1 + self._shown_hypotheses):
                mesh = tiles(belief.grid, what.colors(which, hypothesis))
                self._hidden(f"observed/maps/{self._beliefs}/{name}/{hypothesis}", mesh)
            board = f"board/{self._beliefs}/{name}"
            self._hidden(board, billboard(legend(belief, what, which, rests_on(belief)), *BOARD))
        radii = 0.35 * belief.grid.width * np.sqrt(belief.probability / belief.probability.max())
        name = f"observed/centers of mass/{self._beliefs}"
        self._hidden(name, ringed_discs(belief.centers_of_mass, np.maximum(radii, 5e-4)))
        self._meshcat.SetTransform(f"{self._path}/board", self._board, 0.0)

    def _add_outlines(self, grid: CellGrid) -> None:
        self._outlined = grid
        width = 0.12 * grid.width
        for name, color in (("observed", BLACK), ("predicted", ORANGE)):
            outline = painted(ribbon(grid.edges, width), color)
            self._meshcat.SetObject(f"{self._path}/{name}/outline", outline)
            if name not in self._visible:
                self._meshcat.SetProperty(f"{self._path}/{name}", "visible", False, 0.0)
        self._arrows = _spread_cells(grid, _ARROWS)
        shape = painted(arrow(1.0, 0.08, 0.3), RED)
        for k in range(len(self._arrows)):
            self._hidden(f"residuals/{k}", shape)

    def _hidden(self, name: str, mesh: Any) -> None:
        """Add an object that stays invisible until `_show` shows it."""
        self._meshcat.SetObject(f"{self._path}/{name}", mesh)
        self._meshcat.SetProperty(f"{self._path}/{name}", "visible", False, 0.0)
        self._visible = {place: seen for place, seen in self._visible.items() if seen != name}

    def _show(self, place: str, name: str, time: float) -> None:
        """Show an object in place of the one shown there before; an empty name shows none."""
        before = self._visible.get(place, "")
        if before == name:
            return
        for what, visible in ((before, False), (name, True)):
            if what:
                self._meshcat.SetProperty(f"{self._path}/{what}", "visible", visible, time)
        self._visible[place] = name

    def _choose(self, time: float) -> None:
        """Show the map and hypothesis that the sliders select."""
        hypothesis = min(int(self._meshcat.GetSliderValue(HYPOTHESIS)), self._shown_hypotheses)
        name = MAPS[int(self._meshcat.GetSliderValue(MAP))]
        self._show("tiles", f"observed/maps/{self._beliefs}/{name}/{hypothesis}", time)
        self._show("board", f"board/{self._beliefs}/{name}", time)
        self._show("centers", f"observed/centers of mass/{self._beliefs}", time)

    def _place(self, observed: FloatArray | None, predicted: FloatArray | None, time: float) -> None:
        """Move the object's parts to the observed and predicted poses; without an observation they stay where
        they were, and without a prediction its outline is hidden."""
        meshcat = self._meshcat
        if observed is not None:
            self._show("observed", "observed", time)
            meshcat.SetTransform(f"{self._path}/observed", self._pose(observed, 0.0), time)
            for part, above in (("outline", 6e-4), ("centers of mass", 9e-4)):
                lifted = RigidTransform(np.array([0.0, 0.0, above]))
                meshcat.SetTransform(f"{self._path}/observed/{part}", lifted, time)
        self._show("predicted", "predicted" if predicted is not None else "", time)
        if predicted is not None:
            meshcat.SetTransform(f"{self._path}/predicted", self._pose(predicted, 1.2e-3), time)
        self._place_residuals(observed, predicted, time)

    def _place_residuals(
        self, observed: FloatArray | None, predicted: FloatArray | None, time: float
    ) -> None:
        assert self._outlined is not None
        begin = end = np.zeros((len(self._arrows), 2))
        if observed is not None and predicted is not None:
            cells = self._outlined.centers[self._arrows]
            begin, end = (placed(cells, pose) for pose in (predicted, observed))
        for k, way in enumerate(end - begin):
            length = float(np.hypot(*way))
            name = f"residuals/{k}"
            self._show(name, name if length > LEAST_RESIDUAL else "", time)
            if length > LEAST_RESIDUAL:
                pose = np.array([*begin[k], np.arctan2(way[1], way[0])])
                self._meshcat.SetTransform(f"{self._path}/{name}", self._pose(pose, 2e-3), time)
                scale = [MAGNIFIED * length, MAGNIFIED * length, 1.0]
                self._meshcat.SetProperty(f"{self._path}/{name}", "scale", scale, time)

    def _draw_push(self, push: Any, time: float) -> None:
        """Draw an arrow along the finger's path, a new one for each push."""
        if push is not None and (*push.begin, *push.end) != self._drawn_push:
            self._drawn_push = (*push.begin, *push.end)
            self._pushes += 1
            name = f"push/{self._pushes}"
            self._hidden(name, painted(arrow(push.length, 6e-3, min(0.03, 0.5 * push.length)), BLUE))
            yaw = np.arctan2(push.direction[1], push.direction[0])
            pose = np.array([*push.begin, yaw])
            self._meshcat.SetTransform(f"{self._path}/{name}", self._pose(pose, 3e-3), time)
        self._show("push", f"push/{self._pushes}" if push is not None else "", time)

    def _pose(self, pose: FloatArray, above: float) -> RigidTransform:
        place: Any = [pose[0], pose[1], self._level + above]
        return RigidTransform(RotationMatrix.MakeZRotation(pose[2]), place)


def _spread_cells(grid: CellGrid, count: int) -> np.ndarray:
    """Indices of cells far apart: the one nearest the centre, then always the farthest from those chosen."""
    chosen = [int(np.argmin(np.linalg.norm(grid.centers - grid.centers.mean(axis=0), axis=1)))]
    distance = np.linalg.norm(grid.centers - grid.centers[chosen[0]], axis=1)
    while len(chosen) < min(count, len(grid)):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(grid.centers - grid.centers[chosen[-1]], axis=1))
    return np.array(chosen)
