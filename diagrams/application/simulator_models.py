"""A belief as a model for other simulators: SDF, URDF or MJCF.

Mass, centre of mass and inertia are those of the cells. A geometry has one friction coefficient, and engines
differ in how they distribute a rigid body's weight over many contacts. The object therefore stands on feet at
the centres of parts of equal mass: equal loads keep it level, and an engine with equally compliant contacts
finds these loads. Each foot has the friction of its part.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree as Xml

import numpy as np
import shapely

from slipmap.models.files import BadInput, replaced_folder
from slipmap.models.inference.belief import Belief
from slipmap.models.objects.footprints import convex_pieces
from slipmap.models.physics.cell_grid import CellGrid, FloatArray

Format = Literal["sdf", "urdf", "mjcf"]

_ENDINGS: dict[str, str] = {"sdf": ".sdf", "urdf": ".urdf", "mjcf": ".xml"}
_FOOT = 1e-3  # m, radius of a foot and gap below the outline
_HALVINGS = 5  # of the object, to 32 parts of equal mass
_SOFT = "0.01 0.9 0.001"  # MuJoCo's impedance of a foot: on stiffer ones a pushed object rocks
DEFAULT_HEIGHT = 0.02  # height of an object where it is not known, m
LEAST_HEIGHT, LARGEST_HEIGHT = 2e-3, 10.0  # limits of the height, m; an object stands on feet of 1 mm

LOST = (
    f"details of the maps within the {2**_HALVINGS} parts of equal mass, each of which one foot represents",
    "effects beyond the plain model, and uncertainty, except as the spread over one file per hypothesis",
)
"""What no format can represent."""

_PUSH_LOW = "pushes above the feet shift load between them; push low to get what slipmap predicts"
_PAIRS = (
    "Drake combines the friction coefficients of a pair to 2 a b / (a + b), and Gazebo takes the smaller one:"
    " the model is right for a table and a finger with coefficient 1"
)
TO_MIND: Mapping[Format, tuple[str, ...]] = {
    "sdf": (_PAIRS, _PUSH_LOW),
    "urdf": (_PAIRS, _PUSH_LOW),
    "mjcf": (
        "MuJoCo's default friction cone is a pyramid, which depends on direction: keep cone=elliptic",
        _PUSH_LOW,
    ),
}
"""Cautions for each format."""


@dataclass(frozen=True)
class Body:
    """A rigid body that slides like a hypothesis."""

    mass: float  # kg
    com: FloatArray  # (3,) m, object frame with z = 0 on the table
    inertia: FloatArray  # (3, 3) about the centre of mass, kg m²
    feet: FloatArray  # (F, 2) m
    friction: FloatArray  # (F,) of each foot with the table
    finger_friction: float


def body_of(belief: Belief, hypothesis: int | None, height: float) -> Body:
    """The body of one hypothesis, or of the mean if None."""
    maps, p = belief.maps, belief.probability
    if hypothesis is None:
        mass = p @ maps.mass
        load = p @ (maps.mass * maps.mu) * belief.gravity
        finger = float(p @ maps.mu_finger)
    else:
        mass = maps.mass[hypothesis]
        load = mass * maps.mu[hypothesis] * belief.gravity
        finger = float(maps.mu_finger[hypothesis])
    centers, width = belief.grid.centers, belief.grid.width
    total = float(mass.sum())
    com = belief.grid.center_of(mass)
    away = centers - com
    second = (away.T * mass) @ away + total * width**2 / 12.0 * np.eye(2)
    upright = total * height**2 / 12.0
    inertia = np.zeros((3, 3))
    inertia[0, 0], inertia[1, 1] = second[1, 1] + upright, second[0, 0] + upright
    inertia[0, 1] = inertia[1, 0] = -second[0, 1]
    inertia[2, 2] = second[0, 0] + second[1, 1]
    feet, rubbing = _feet(centers, mass, load, _HALVINGS)
    friction = rubbing * len(feet) / (total * belief.gravity)
    return Body(total, np.append(com, 0.5 * height), inertia, feet, friction, finger)


def _feet(
    centers: FloatArray, mass: FloatArray, load: FloatArray, halvings: int
) -> tuple[FloatArray, FloatArray]:
    """(2^halvings, 2) centres of parts of equal mass, and (2^halvings,) friction of each, N."""
    middle = mass @ centers / mass.sum()
    if halvings == 0:
        return middle[None], np.array([load.sum()])
    away = centers - middle
    _, axes = np.linalg.eigh((away.T * mass) @ away)
    order = np.argsort(away @ axes[:, -1], kind="stable")
    half = 0.5 * mass.sum()
    below = np.cumsum(mass[order]) - mass[order]
    # The cell in the middle belongs to both halves.
    first = np.clip((half - below) / np.maximum(mass[order], 1e-300), 0.0, 1.0)
    halves = []
    for share in (first, 1.0 - first):
        kept = order[share > 0.0]
        part = share[share > 0.0]
        halves.append(_feet(centers[kept], part * mass[kept], part * load[kept], halvings - 1))
    return np.concatenate([halves[0][0], halves[1][0]]), np.concatenate([halves[0][1], halves[1][1]])


def convex_parts(grid: CellGrid) -> list[FloatArray]:
    """Convex polygons (k, 2), counter-clockwise, that fill the outline without gaps."""
    pieces = [shapely.orient_polygons(piece) for piece in convex_pieces(grid.polygon)]
    return [np.array(piece.exterior.coords)[:-1] for piece in pieces]


def export_belief(
    belief: Belief,
    to: Format,
    folder: str | os.PathLike[str],
    *,
    height: float = DEFAULT_HEIGHT,
    hypotheses: bool = False,
) -> list[Path]:
    """Write models for a simulator to a new folder: the mean, or one for each hypothesis.

    The object frame is that of the outline, with z = 0 on the table. `LOST` lists what the formats cannot
    represent, `TO_MIND` cautions.

    Args:
        to: `sdf`, `urdf` or `mjcf`.
        folder: a new one; for SDF and URDF it also holds meshes of the outline.
        height: of the object, m.
        hypotheses: write one file for each, named by its number and containing its probability.

    Returns:
        The models.

    Raises:
        BadInput: the folder is not empty, the format is unknown, or the height is out of range.

    Example:
        >>> import slipmap, tempfile
        >>> from slipmap.diagrams.application.simulator_models import export_belief
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=1, heldout=0)
        >>> belief = slipmap.identify(dataset, hypotheses=2, friction_laws=False).belief
        >>> folder = tempfile.mkdtemp() + "/models"
        >>> [path.name for path in export_belief(belief, "mjcf", folder, hypotheses=True)]
        ['hammer_00.xml', 'hammer_01.xml']
    """
    if to not in _WRITERS:
        raise BadInput(f"there is no format {to!r}; choose one of {', '.join(_WRITERS)}")
    if not LEAST_HEIGHT <= height <= LARGEST_HEIGHT:
        raise BadInput(f"height must lie between {LEAST_HEIGHT:g} and {LARGEST_HEIGHT:g} m, got {height}")
    target = Path(folder).absolute()
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise BadInput(f"{folder} exists already; name a new folder for the models")
    name = "".join(sign if sign.isalnum() else "_" for sign in belief.dataset).strip("_") or "object"
    numbers: Sequence[int | None] = range(len(belief)) if hypotheses else [None]
    texts = {}
    parts = convex_parts(belief.grid)
    for number in numbers:
        called = name if number is None else f"{name}_{number:02d}"
        root = _WRITERS[to](name, body_of(belief, number, height), parts, height)
        Xml.indent(root)
        texts[called + _ENDINGS[to]] = _comment(belief, number) + Xml.tostring(root, encoding="unicode")
    with replaced_folder(target) as fresh:
        fresh.mkdir()
        for file, text in texts.items():
            (fresh / file).write_text(f'<?xml version="1.0"?>\n{text}\n', encoding="utf-8")
        if to != "mjcf":
            for number, corners in enumerate(parts):
                (fresh / f"part_{number}.obj").write_text(_prism(corners, height), encoding="utf-8")
    return [target / file for file in texts]


def _comment(belief: Belief, hypothesis: int | None) -> str:
    if hypothesis is None:
        return f"<!-- The mean of {len(belief)} hypotheses of slipmap. -->\n"
    share = belief.probability[hypothesis]
    return f"<!-- Hypothesis {hypothesis} of {len(belief)} of slipmap, probability {share:.4g}. -->\n"


def _prism(corners: FloatArray, height: float) -> str:
    """An upright prism as OBJ, with faces outward."""
    count = len(corners)
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for z in (_FOOT, height) for x, y in corners]
    below, above = range(count, 0, -1), range(count + 1, 2 * count + 1)
    lines += ["f " + " ".join(map(str, face)) for face in (below, above)]
    for k in range(count):
        after = (k + 1) % count
        lines.append(f"f {k + 1} {after + 1} {count + after + 1} {count + k + 1}")
    return "\n".join(lines) + "\n"


def _child(parent: Xml.Element, tag: str, text: str = "", **attributes: str) -> Xml.Element:
    element = Xml.SubElement(parent, tag, attributes)
    element.text = text or None
    return element


def _numbers(values: Sequence[float] | FloatArray) -> str:
    return " ".join(f"{float(value):.9g}" for value in values)


def _of_pair(friction: float) -> float:
    """The coefficient that Drake, combining it with 1, turns into that of the pair."""
    return friction / (2.0 - friction) if friction < 1.9 else 19.0


def _mjcf(name: str, body: Body, parts: Sequence[FloatArray], height: float) -> Xml.Element:
    root = Xml.Element("mujoco", model=name)
    _child(root, "option", cone="elliptic")
    assets = _child(root, "asset")
    for number, corners in enumerate(parts):
        points = [_numbers((*corner, z)) for z in (_FOOT, height) for corner in corners]
        _child(assets, "mesh", name=f"{name}_part_{number}", vertex="  ".join(points))
    link = _child(_child(root, "worldbody"), "body", name=name)
    _child(link, "freejoint")
    i = body.inertia
    _child(
        link, "inertial", pos=_numbers(body.com), mass=_numbers([body.mass]),
        fullinertia=_numbers([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]),
    )  # fmt: skip
    for number in range(len(parts)):
        _child(
            link, "geom", name=f"{name}_outline_{number}", type="mesh", mesh=f"{name}_part_{number}",
            friction=_numbers([body.finger_friction, 0, 0]), condim="3", priority="1",
        )  # fmt: skip
    for number, (place, friction) in enumerate(zip(body.feet, body.friction, strict=True)):
        _child(
            link, "geom", name=f"{name}_foot_{number}", type="sphere", size=_numbers([_FOOT]),
            pos=_numbers((*place, _FOOT)), friction=_numbers([friction, 0, 0]), condim="3", priority="1",
            solimp=_SOFT,
        )  # fmt: skip
    return root


def _sdf(name: str, body: Body, parts: Sequence[FloatArray], height: float) -> Xml.Element:
    root = Xml.Element("sdf", {"version": "1.9", "xmlns:drake": "drake.mit.edu"})
    link = _child(_child(root, "model", name=name), "link", name=name)
    inertial = _child(link, "inertial")
    _child(inertial, "pose", _numbers([*body.com, 0, 0, 0]))
    _child(inertial, "mass", _numbers([body.mass]))
    _inertia(_child(inertial, "inertia"), body, as_text=True)
    shapes = [(f"outline_{number}", f"part_{number}.obj", body.finger_friction, np.zeros(3))
              for number in range(len(parts))]  # fmt: skip
    shapes += [
        (f"foot_{number}", "", float(friction), np.append(place, _FOOT))
        for number, (place, friction) in enumerate(zip(body.feet, body.friction, strict=True))
    ]
    for called, mesh, friction, place in shapes:
        collision = _child(link, "collision", name=called)
        _child(collision, "pose", _numbers([*place, 0, 0, 0]))
        geometry = _child(collision, "geometry")
        if mesh:
            shape = _child(geometry, "mesh")
            _child(shape, "uri", mesh)
            _child(shape, "drake:declare_convex")
            visual = _child(_child(link, "visual", name=f"{called}_visual"), "geometry")
            _child(_child(visual, "mesh"), "uri", mesh)
        else:
            _child(_child(geometry, "sphere"), "radius", _numbers([_FOOT]))
        ode = _child(_child(_child(collision, "surface"), "friction"), "ode")
        _child(ode, "mu", _numbers([friction]))
        _child(ode, "mu2", _numbers([friction]))
        drake = _child(collision, "drake:proximity_properties")
        for which in ("static", "dynamic"):
            _child(drake, f"drake:mu_{which}", _numbers([_of_pair(friction)]))
    return root


def _urdf(name: str, body: Body, parts: Sequence[FloatArray], height: float) -> Xml.Element:
    root = Xml.Element("robot", {"name": name, "xmlns:drake": "drake.mit.edu"})
    link = _child(root, "link", name=name)
    inertial = _child(link, "inertial")
    _child(inertial, "origin", xyz=_numbers(body.com), rpy="0 0 0")
    _child(inertial, "mass", value=_numbers([body.mass]))
    _inertia(_child(inertial, "inertia"), body, as_text=False)
    for number in range(len(parts)):
        for kind in ("visual", "collision"):
            element = _child(link, kind, name=f"outline_{number}_{kind}")
            mesh = _child(_child(element, "geometry"), "mesh", filename=f"part_{number}.obj")
            if kind == "collision":
                _child(mesh, "drake:declare_convex")
                _drake_friction(element, body.finger_friction)
    for number, (place, friction) in enumerate(zip(body.feet, body.friction, strict=True)):
        element = _child(link, "collision", name=f"foot_{number}")
        _child(element, "origin", xyz=_numbers((*place, _FOOT)), rpy="0 0 0")
        _child(_child(element, "geometry"), "sphere", radius=_numbers([_FOOT]))
        _drake_friction(element, float(friction))
    return root


def _drake_friction(element: Xml.Element, friction: float) -> None:
    properties = _child(element, "drake:proximity_properties")
    for which in ("static", "dynamic"):
        _child(properties, f"drake:mu_{which}", value=_numbers([_of_pair(friction)]))


def _inertia(element: Xml.Element, body: Body, *, as_text: bool) -> None:
    for row in range(3):
        for column in range(row, 3):
            key, value = f"i{'xyz'[row]}{'xyz'[column]}", _numbers([body.inertia[row, column]])
            if as_text:
                _child(element, key, value)
            else:
                element.set(key, value)


_WRITERS = {"sdf": _sdf, "urdf": _urdf, "mjcf": _mjcf}
