"""Symbols for the formulas of effects, and smooth versions of functions with corners.

Positions and `theta` are predicted from the start of a step to its middle; velocities are those at the start.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any

# SymPy takes half a second to import and is not needed if all formulas are compiled already.
if TYPE_CHECKING:
    import sympy as sp
else:

    class _SympyOnUse:
        def __getattr__(self, name: str) -> Any:
            import sympy

            return getattr(sympy, name)

    sp = _SympyOnUse()

STATE_NAMES = ("q_x", "q_y", "q_theta", "v_x", "v_y", "omega")
FORCE_NAMES = ("force_x", "force_y")
LEAN_NAMES = ("lean_x", "lean_y")  # of the finger; no effect can read them
POSE_SYMBOLS = ("pose_x", "pose_y", "pose_theta")
"""Names of the symbols of the true pose, which the tracker may misreport."""
PUSH_SYMBOLS = ("push_x", "push_y")
"""Names of the symbols of the finger's true force, which the sensor may misreport."""
INERTIA_NAMES = ("m", "s_x", "s_y", "J")
CONSTANT_NAMES = ("time", "h", "order", "gravity", "width", "c_x", "c_y", "g_xx", "g_xy", "g_yy", "n")
AFTER_SYMBOLS = tuple(f"after_{k}" for k in range(8))  # names of the symbols of `after_names`
REST_SPEED = 1e-4  # speeds are smoothed below this, m/s


class Names:
    """Symbols as attributes; an unknown name raises an error that lists the known ones."""

    def __init__(self, what: str, values: Mapping[str, Any]) -> None:
        self.__dict__.update(values)
        self._what = what

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        known = ", ".join(sorted(key for key in self.__dict__ if not key.startswith("_")))
        raise AttributeError(f"{self._what} has no {name!r}; it has {known}")


def real(name: str) -> sp.Symbol:
    """A real symbol."""
    return sp.Symbol(name, real=True)


def parameter_name(effect: str, name: str) -> str:
    """Name of a parameter's symbol, unique because effect names have no capitals."""
    return f"p_{effect}_P_{name}"


def memory_name(effect: str, name: str) -> str:
    """Name of the symbol of a number that an effect remembers."""
    return f"mem_{effect}_M_{name}"


def body_names(memory: Mapping[str, sp.Symbol], downhill: Sequence[Any] = (0, 0)) -> dict[str, Any]:
    """Quantities of the whole object for formulas, as expressions of the kernel's arguments.

    x, y (m), theta: pose of the object frame in the world. vx, vy, omega: velocity of its origin, world.
    com_x, com_y: centre of mass relative to the origin, com_vx, com_vy: its velocity, world. mass, moment
    (about the origin), gravity, weight. time within the push (s), step (s), order: index of the push in the
    experiment, from 0. force_x, force_y: last force of the finger on the object, world, N. downhill_x,
    downhill_y: acceleration by which gravity pulls along the table, world, m/s². centroid_x,
    centroid_y: of the cells, object frame; spread_xx, spread_xy, spread_yy: inverse of their second moments
    about it, 1/m². width: of a cell.
    """
    qx, qy, qt, vx, vy, omega = (real(name) for name in STATE_NAMES)
    m, sx, sy, moment = (real(name) for name in INERTIA_NAMES)
    c = {name: real(name) for name in CONSTANT_NAMES}
    c0, s0 = sp.cos(qt), sp.sin(qt)
    wx, wy = c0 * vx - s0 * vy, s0 * vx + c0 * vy
    theta = qt + c["h"] * omega / 2
    cm, sm = sp.cos(theta), sp.sin(theta)
    com_x, com_y = (cm * sx - sm * sy) / m, (sm * sx + cm * sy) / m
    names = {
        "x": qx + c["h"] / 2 * wx,
        "y": qy + c["h"] / 2 * wy,
        "theta": theta,
        "cos": cm,
        "sin": sm,
        "vx": wx,
        "vy": wy,
        "omega": omega,
        "com_x": com_x,
        "com_y": com_y,
        "com_vx": wx - omega * (s0 * sx + c0 * sy) / m,
        "com_vy": wy + omega * (c0 * sx - s0 * sy) / m,
        "mass": m,
        "moment": moment,
        "gravity": c["gravity"],
        "weight": m * c["gravity"],
        "time": c["time"],
        "step": c["h"],
        "order": c["order"],
        "width": c["width"],
        "centroid_x": c["c_x"],
        "centroid_y": c["c_y"],
        "spread_xx": c["g_xx"],
        "spread_xy": c["g_xy"],
        "spread_yy": c["g_yy"],
        "downhill_x": downhill[0],
        "downhill_y": downhill[1],
    }
    return names | dict(memory)


def cell_names(body: Mapping[str, Any]) -> dict[str, Any]:
    """Quantities of a cell for formulas: all of `body`, and these of the cell.

    x, y: centre in the world, m. rx, ry: centre in the object frame. ux, uy: velocity in the world.
    along_x, along_y: velocity in the object frame. speed: smoothed below 0.1 mm/s. area: m².
    """
    rx, ry = real("r_x"), real("r_y")
    vx, vy, omega = real("v_x"), real("v_y"), real("omega")
    ax, ay = vx - omega * ry, vy + omega * rx
    qt = real("q_theta")
    return dict(body) | {
        "x": body["x"] + body["cos"] * rx - body["sin"] * ry,
        "y": body["y"] + body["sin"] * rx + body["cos"] * ry,
        "rx": rx,
        "ry": ry,
        "ux": sp.cos(qt) * ax - sp.sin(qt) * ay,
        "uy": sp.sin(qt) * ax + sp.cos(qt) * ay,
        "along_x": ax,
        "along_y": ay,
        "speed": sp.sqrt(ax**2 + ay**2 + REST_SPEED**2),
        "area": real("width") ** 2,
    }


def after_names() -> dict[str, Any]:
    """Quantities after a step for `remember`: x, y, theta, vx, vy, omega, com_vx, com_vy, force_x, force_y.

    They are in the world, as in `body_names`.
    """
    x, y, theta, vx, vy, omega, fx, fy = (real(name) for name in AFTER_SYMBOLS)
    m, sx, sy, _ = (real(name) for name in INERTIA_NAMES)
    c, s = sp.cos(theta), sp.sin(theta)
    wx, wy = c * vx - s * vy, s * vx + c * vy
    return {
        "x": x, "y": y, "theta": theta, "vx": wx, "vy": wy, "omega": omega,
        "com_vx": wx - omega * (s * sx + c * sy) / m, "com_vy": wy + omega * (c * sx - s * sy) / m,
        "force_x": fx, "force_y": fy,
    }  # fmt: skip


def written_names(kind: str, extra: tuple[str, ...] = ()) -> dict[str, Any]:
    """Names of `body`, `cell`, `after`, `pose` or `push` as LaTeX letters, for formulas for readers."""
    letters = {
        "x": "x", "y": "y", "theta": r"\theta", "vx": r"\dot{x}",
        "vy": r"\dot{y}", "omega": r"\omega", "com_x": r"\bar{r}_{x}", "com_y": r"\bar{r}_{y}",
        "com_vx": r"\bar{v}_{x}", "com_vy": r"\bar{v}_{y}", "mass": "m", "moment": "J", "gravity": "g",
        "time": "t", "step": "h", "order": "k", "width": "w", "centroid_x": "c_{x}", "centroid_y": "c_{y}",
        "spread_xx": "G_{xx}", "spread_xy": "G_{xy}", "spread_yy": "G_{yy}",
        "force_x": "F_{x}", "force_y": "F_{y}", "downhill_x": "a_{x}", "downhill_y": "a_{y}",
    }  # fmt: skip
    if kind == "pose":
        letters = {name: letters[name] for name in ("x", "y", "theta")}
    if kind == "push":
        letters = {"x": letters["force_x"], "y": letters["force_y"]}
    if kind == "cell":
        letters |= {
            "x": "X", "y": "Y", "rx": "r_{x}", "ry": "r_{y}", "ux": "u_{x}", "uy": "u_{y}",
            "along_x": "u^{O}_{x}", "along_y": "u^{O}_{y}", "speed": "u", "area": "a",
        }  # fmt: skip
    if kind == "after":
        letters = {name: letters[name] + "^{+}" for name in after_names()}
    names: dict[str, Any] = {name: real(letter) for name, letter in letters.items()}
    if kind in ("body", "cell"):
        names |= {"cos": sp.cos(names["theta"]), "sin": sp.sin(names["theta"])}
        names["weight"] = names["mass"] * names["gravity"]
    return names | {name: real(latex_name(name)) for name in extra}


def latex_name(name: str) -> str:
    """An identifier in LaTeX: words upright; x, y, xx, xy, yy or p at its end as an index."""
    *words, last = name.split("_")
    index = words and last in ("x", "y", "xx", "xy", "yy", "p")
    upright = r"\ ".join(words if index else [*words, last])
    return rf"\mathrm{{{upright}}}" + (f"_{{{last}}}" if index else "")


_WRITING = ContextVar("writing", default=False)


@contextmanager
def writing() -> Iterator[None]:
    """Leave `positive_part` and `smooth_step` unevaluated, for readers."""
    token = _WRITING.set(True)
    try:
        yield
    finally:
        _WRITING.reset(token)


def force_at_mass_center(body: Any, fx: Any, fy: Any) -> tuple[Any, Any, Any]:
    """Return value of `Effect.force` for a force (world, N) that acts at the centre of mass."""
    return fx, fy, body.com_x * fy - body.com_y * fx


def positive_part(value: Any, width: float) -> Any:
    """max(value, 0), rounded within about `width` of 0."""
    if _WRITING.get():
        from slipmap.models.effects.read_functions import PositivePart

        return PositivePart(sp.sympify(value))
    return (value + sp.sqrt(value**2 + width**2)) / 2


def smooth_step(value: Any, width: float) -> Any:
    """A step from 0 to 1 as value passes 0, mostly within ± `width`."""
    if _WRITING.get():
        from slipmap.models.effects.read_functions import SmoothStep

        return SmoothStep(value, width)
    return (1 + sp.tanh(2 * value / width)) / 2
