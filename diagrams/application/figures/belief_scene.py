"""A belief as a scene of meshcat: one relief of the object for each map and hypothesis, side by side."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import meshcat
import meshcat.geometry as g
import numpy as np
import umsgpack
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from meshcat.servers.tree import SceneTree
from meshcat.servers.zmqserver import ZMQWebSocketBridge

from slipmap.diagrams.systems.belief_visualizer import MAPS, RED, Shown, rests_on, shown
from slipmap.diagrams.systems.look import INK, MAP_COLORS, styled
from slipmap.diagrams.systems.unlit_meshes import quads
from slipmap.models.inference.belief import Belief
from slipmap.models.physics.cell_grid import CellGrid, FloatArray

MOST = 6  # most hypotheses shown beside the mean, which contains all of them

_NAMES = (
    ("mass", "per cell, g"),
    ("friction", "coefficient"),
    ("mass × friction", "force to slide a cell, mN"),
)
_LONGEST_NAME = 36
_PAPER = (0.965, 0.96, 0.945)
_OPENING = 8.0  # deg, the camera's field of view from bottom to top: hardly any perspective
_ELEVATION = np.radians(52.0)
_SCREEN = 4 / 3  # its width to its height; wider ones have room at the sides
_CAMERA = "/Cameras/default/rotated/<object>"


@styled
def title(belief: Belief, size: FloatArray) -> bytes:
    """The title panel: what is shown, and how to read it.

    Args:
        size: (2,) size of the panel, which sets its proportions.
    """
    figure = _paper(size, 12.0)
    name = (
        belief.dataset if len(belief.dataset) <= _LONGEST_NAME else f"{belief.dataset[: _LONGEST_NAME - 1]}…"
    )
    _write(figure, (0.01, 0.82), f"{name}: belief {rests_on(belief)}", 32, weight="bold")
    lines = (
        "Height and colour of a prism: the value in its cell. Red pin: centre of mass.",
        f"First the mean of all {len(belief)} hypotheses, then the most probable hypotheses one by one.",
    )
    _write(figure, (0.01, 0.34), "\n".join(lines), 18.5, linespacing=1.5)
    return _png(figure)


@styled
def label(belief: Belief, what: Shown, hypothesis: int, size: FloatArray) -> bytes:
    """Name and probability of a hypothesis of `what`; 0 is the mean."""
    figure = _paper(size, 2.3)
    name, remark = "mean", f"of {len(belief)} hypotheses"
    if hypothesis > 0:
        name = f"hypothesis {hypothesis}"
        remark = f"probability {100 * belief.probability[what.hypotheses[hypothesis - 1]]:.1f} %"
    _write(figure, (0.5, 0.72), name, 19, weight="bold", ha="center")
    _write(figure, (0.5, 0.24), remark, 15.5, ha="center")
    return _png(figure)


@styled
def scale(what: Shown, which: int, size: FloatArray) -> bytes:
    """Name, unit and colours of a map."""
    figure = _paper(size, 2.9)
    name, unit = _NAMES[which]
    _write(figure, (0.1, 0.86), name, 17, weight="bold")
    _write(figure, (0.1, 0.66), unit, 14)
    # Leaves room for half a number at both ends, and for the arrow on the right.
    bar = figure.add_axes((0.1, 0.34, 0.78, 0.17))
    colors = ScalarMappable(Normalize(0.0, what.tops[which]), colormaps[MAP_COLORS[which]])
    figure.colorbar(
        colors, cax=bar, orientation="horizontal", ticks=MaxNLocator(4), extend=what.beyond(which)
    )
    bar.tick_params(labelsize=14)
    return _png(figure)


def _paper(size: FloatArray, inches: float) -> Figure:
    """A figure with a panel's proportions and a width in inches."""
    return Figure(figsize=(inches, inches * float(size[1] / size[0])), dpi=200)


def _write(figure: Figure, at: tuple[float, float], text: str, points: float, **how: Any) -> None:
    figure.text(*at, text, fontsize=points, color=INK, va="center", **how)


def _png(figure: Figure) -> bytes:
    stream = BytesIO()
    figure.savefig(stream, format="png", transparent=True)
    return stream.getvalue()


class _Window(ZMQWebSocketBridge):
    """Target of a `meshcat.Visualizer`: keeps the scene in this process, as meshcat's server would.

    The usual window starts a server process and opens ports, which a static page does not need.
    """

    def __init__(self) -> None:
        self.tree = SceneTree()
        self.websocket_pool: set[Any] = set()
        self.zmq_socket = self
        self._answer = b""

    def handle(self, *frames: bytes) -> str:
        """The server's answer to a message."""
        self.handle_zmq(frames)
        return self._answer.decode("utf-8")

    def send(self, message: Any) -> None:
        """Execute a visualizer's command; bytes come from the server and are its answer."""
        if isinstance(message, bytes):
            self._answer = message
            return
        command = message.lower()
        answer = self.handle(command["type"].encode(), command["path"].encode(), umsgpack.packb(command))
        if answer != "ok":
            raise RuntimeError(f"meshcat: {answer}")

    def get_scene(self) -> str:
        """The scene as a page."""
        return self.handle(b"get_scene")


def belief_scene(belief: Belief) -> meshcat.Visualizer:
    """The maps of a belief in a grid: `MAPS` along one side; the mean and then up to `MOST` hypotheses by
    decreasing probability along the other. The layout fits a screen.

    The height and colour of the prism on each cell are the cell's value, from 0 on one scale per map. A low
    wall is the object's outline, a pin the centre of mass of the hypothesis. In the scene tree these are
    `<map>/<hypothesis>/cells`, `outline` and `center of mass`. Lengths other than heights are in m.

    Returns:
        A visualizer without a server: `static_html()` gives a page that needs no network.
    """
    scene = meshcat.Visualizer(window=_Window())
    what = shown(belief, MOST)
    corner = belief.grid.centers.min(axis=0) - 0.5 * belief.grid.width
    size = belief.grid.centers.max(axis=0) + 0.5 * belief.grid.width - corner
    counts = (len(MAPS), 1 + len(what.hypotheses))
    layouts = [_Layout.of(counts, size, maps_across) for maps_across in (False, True)]
    layout = min(layouts, key=lambda one: abs(np.log(one.proportion / _SCREEN)))
    object_middle = np.array([*(corner + 0.5 * size), 0.0])
    for which, name in enumerate(MAPS):
        for hypothesis in range(counts[1]):
            place = scene[f"{name}/{'mean' if hypothesis == 0 else f'hypothesis {hypothesis}'}"]
            place.set_transform(_shifted(layout.middle(which, hypothesis) - object_middle))
            _add_relief(place, belief, what, which, hypothesis, 0.45 * layout.unit)
        _add_panel(
            scene[f"{name}/scale"], scale(what, which, layout.scale), layout.scale, layout.beside(which, None)
        )
    for hypothesis in range(counts[1]):
        picture = label(belief, what, hypothesis, layout.label)
        _add_panel(scene[f"labels/{hypothesis}"], picture, layout.label, layout.beside(None, hypothesis))
    _add_panel(scene["labels/title"], title(belief, layout.title), layout.title, layout.title_place)
    _furnish(scene, layout.whole)
    return scene


@dataclass(frozen=True)
class _Layout:
    """Layout on the ground; the origin is in the middle."""

    maps_across: bool  # whether maps are side by side, rather than hypotheses
    counts: tuple[int, int]  # of maps and of hypotheses
    unit: float  # size of the object, m
    pitch: FloatArray  # (2,) from object to object, m

    @classmethod
    def of(cls, counts: tuple[int, int], size: FloatArray, maps_across: bool) -> _Layout:
        """The layout for an object of a size (2,), m."""
        unit = float(np.sqrt(np.prod(size)))
        least = [2.1, 0.6] if maps_across else [1.1, 1.0]
        return cls(
            maps_across, counts, unit, np.maximum(size + np.array([0.3, 0.5]) * unit, np.array(least) * unit)
        )

    @property
    def scale(self) -> FloatArray:
        """(2,) size of a map's scale."""
        return self.unit * np.array([2.0, 1.0])

    @property
    def label(self) -> FloatArray:
        """(2,) size of a hypothesis's label."""
        return self.unit * (np.array([1.5, 0.57]) if self.maps_across else np.array([1.1, 0.42]))

    @property
    def _margin(self) -> FloatArray:
        """(2,) free space on the left and in front."""
        return np.array(
            [self.label[0], self.scale[1]] if self.maps_across else [self.scale[0], self.label[1]]
        )

    @property
    def _objects(self) -> FloatArray:
        columns, rows = self.counts if self.maps_across else self.counts[::-1]
        return self.pitch * [columns, rows]

    @property
    def title(self) -> FloatArray:
        """(2,) size of the title."""
        return (self._margin + self._objects)[0] * np.array([1.0, 0.13])

    @property
    def whole(self) -> FloatArray:
        """(2,) size of everything."""
        return self._margin + self._objects + [0.0, self.title[1] + 0.2 * self.unit]

    @property
    def title_place(self) -> FloatArray:
        """(3,) centre of the title."""
        return np.array([0.0, 0.5 * (self.whole[1] - self.title[1]), 0.0])

    @property
    def proportion(self) -> float:
        """Width to height of what the camera sees."""
        return float(self.whole[0] / (self.whole[1] * np.sin(_ELEVATION)))

    def middle(self, which: int, hypothesis: int) -> FloatArray:
        """(3,) centre of an object."""
        column, row = (which, hypothesis) if self.maps_across else (hypothesis, which)
        corner = self._margin - 0.5 * self.whole
        back = corner[1] + self._objects[1]
        return np.array([corner[0] + (column + 0.5) * self.pitch[0], back - (row + 0.5) * self.pitch[1], 0.0])

    def beside(self, which: int | None, hypothesis: int | None) -> FloatArray:
        """(3,) centre of a scale or a label: left of its row, or in front of its column."""
        at = self.middle(which or 0, hypothesis or 0)
        if (which is not None) == self.maps_across:
            at[1] = 0.5 * (self._margin - self.whole)[1]
        else:
            at[0] = 0.5 * (self._margin - self.whole)[0]
        return at


def _furnish(scene: meshcat.Visualizer, whole: FloatArray) -> None:
    """Set a plain background, and a camera that sees the whole layout (2,) from the front."""
    for helper in ("/Grid", "/Axes"):
        scene[helper].set_property("visible", False)
    for edge in ("top_color", "bottom_color"):
        scene["/Background"].set_property(edge, list(_PAPER))
    half = 0.94 * np.tan(np.radians(0.5 * _OPENING))
    forward, up = np.array([np.cos(_ELEVATION), np.sin(_ELEVATION)])
    # The camera looks at the origin. Moved back, the near edge is as far below it as the far one above.
    each = np.array([1.0 / (up + half * forward), 1.0 / (up - half * forward)])
    near, far = whole[1] * each / each.sum()
    scene.set_transform(_shifted(np.array([0.0, 0.5 * (far - near), 0.0])))
    distance = max(near / (half * each[0]), 0.5 * whole[0] / (_SCREEN * half) + near * forward)
    # The camera's own frame has y upwards.
    scene[_CAMERA].set_property("fov", _OPENING)
    scene[_CAMERA].set_property("position", [0.0, distance * float(up), distance * float(forward)])
    # Everything drawn lies between these; meshcat's 0.01 m and 100 m are too far apart at that distance.
    scene[_CAMERA].set_property("near", 0.02 * distance)
    scene[_CAMERA].set_property("far", 5.0 * distance)


def _add_relief(
    place: meshcat.Visualizer, belief: Belief, what: Shown, which: int, hypothesis: int, relief: float
) -> None:
    """Add cells, outline and centre of mass of hypothesis 0 (the mean) or of one of `what.hypotheses`; the
    top of the colour scale is `relief` metres high."""
    grid = belief.grid
    heights = np.maximum(relief * what.values[which, hypothesis] / what.tops[which], 1e-3 * relief)
    cells = _prisms(grid, heights, what.colors(which, hypothesis))
    place["cells"].set_object(cells, g.MeshBasicMaterial(vertexColors=True))
    place["outline"].set_object(_rim(grid, 0.06 * relief), g.MeshBasicMaterial(color=_hex(INK)))
    length = float(1.12 * heights.max())
    pin = grid.center_of(what.values[0, hypothesis])
    thick = 0.025 * relief
    stem, ball = place["center of mass/stem"], place["center of mass/ball"]
    stem.set_object(g.Box([thick, thick, length]), g.MeshBasicMaterial(color=_hex(RED)))
    stem.set_transform(_shifted(np.array([*pin, 0.5 * length])))
    ball.set_object(g.Sphere(3.0 * thick), g.MeshLambertMaterial(color=_hex(RED)))
    ball.set_transform(_shifted(np.array([*pin, length])))


def _prisms(grid: CellGrid, heights: FloatArray, colors: FloatArray) -> g.TriangularMeshGeometry:
    """Prisms on the cells with heights (n,) and colours (n, 3) on top; their sides are darker."""
    ring, n = grid.squares(0.92 * grid.width), len(grid)
    top = np.concatenate([ring, np.broadcast_to(heights[:, None, None], (n, 4, 1))], axis=2)
    low = np.concatenate([ring, np.zeros((n, 4, 1))], axis=2)
    faces, shades = [top], [np.ones(4)]
    for k in range(4):
        ends = [k, (k + 1) % 4]
        faces.append(np.concatenate([low[:, ends], top[:, ends[::-1]]], axis=1))
        shades.append(np.full(4, 0.78 if k % 2 == 0 else 0.6))
    corners = np.concatenate(faces, axis=1).reshape(-1, 4, 3)
    shade = np.concatenate(shades)
    return g.TriangularMeshGeometry(*quads(corners), (colors[:, None] * shade[:, None]).reshape(-1, 3))


def _rim(grid: CellGrid, height: float) -> g.TriangularMeshGeometry:
    """A low wall along the outline."""
    low = np.concatenate([grid.edges.reshape(-1, 2, 2), np.zeros((len(grid.edges), 2, 1))], axis=2)
    return g.TriangularMeshGeometry(*quads(np.concatenate([low, low[:, ::-1] + [0.0, 0.0, height]], axis=1)))


def _add_panel(place: meshcat.Visualizer, picture: bytes, size: FloatArray, at: FloatArray) -> None:
    """Add a picture (PNG) on the ground, centred at a point (3,)."""
    texture = g.ImageTexture(image=g.PngImage(picture), anisotropy=8)
    # Front faces only: on such a thin box, the picture on the underside would shine through.
    surface = g.MeshBasicMaterial(map=texture, side=0, transparent=True)
    place.set_object(g.Box([float(size[0]), float(size[1]), 1e-4 * float(size[1])]), surface)
    place.set_transform(_shifted(at))


def _shifted(by: FloatArray) -> FloatArray:
    matrix = np.eye(4)
    matrix[:3, 3] = by
    return matrix


def _hex(color: Any) -> int:
    return int(to_hex(color)[1:], 16)
