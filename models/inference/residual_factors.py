"""What residuals may hang together with: the conditions that are looked at, as features and components.

A factor is a set of products feature × component. A component is a residual in some frame (along the
motion, towards the table's x, counter-clockwise …); a feature is a number that the conditions give. The
factor matters where the sum of such a product over pushes is larger than chance explains.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from models.inference.push_conditions import PHASE_NAMES, Conditions, Phase
from models.inference.residuals import Residuals
from models.physics.cell_grid import FloatArray

Columns = dict[str, FloatArray]

LEAST_SPREAD = 1e-9


@dataclass(frozen=True)
class Factor:
    """One condition that residuals are held against.

    Attributes:
        name: key, such as `table_direction`.
        title: for a person, such as `direction of motion on the table`.
        blocks: pairs of (features, components); all their products are tested together.
        along_the_push: whether it compares parts of one push, which a push known by its ends cannot show.
    """

    name: str
    title: str
    blocks: tuple[tuple[Callable[[Conditions], Columns], Callable[[Residuals], Columns]], ...]
    along_the_push: bool = False

    def products(self, residuals: Residuals) -> tuple[list[str], FloatArray, FloatArray]:
        """Names (d,), features (N, d) and components (N, d) of all products that can be formed.

        Features that vary with the conditions have mean 0 and mean square 1 over all pieces.
        """
        names, left, right = [], [], []
        for features, components in self.blocks:
            for what, values in components(residuals).items():
                for when, feature in features(residuals.at).items():
                    scaled = feature if when == ALWAYS else _standard(feature, residuals.weights)
                    if scaled is not None:
                        names.append(what if when == ALWAYS else f"{what}, {when}")
                        left.append(scaled)
                        right.append(values)
        if not names:
            return [], np.zeros((len(residuals.at), 0)), np.zeros((len(residuals.at), 0))
        return names, np.column_stack(left), np.column_stack(right)


def _standard(feature: FloatArray, weights: FloatArray) -> FloatArray | None:
    known = np.isfinite(feature)
    if not known.any():
        return None
    w = weights[known] / weights[known].sum()
    centred = np.where(known, feature - w @ feature[known], 0.0)
    spread = np.sqrt(w @ centred[known] ** 2)
    return centred / spread if spread > LEAST_SPREAD else None


ALWAYS = "always"


def _always(at: Conditions) -> Columns:
    return {ALWAYS: np.ones(len(at))}


def _table_place(at: Conditions) -> Columns:
    return {"more at larger table x": at.place[:, 0], "more at larger table y": at.place[:, 1]}


def _contact_place(at: Conditions) -> Columns:
    x, y = at.contact.T
    return {"more where contact has larger object x": x, "more where contact has larger object y": y}


def _speed(at: Conditions) -> Columns:
    return {"more at higher speed": np.log(np.maximum(at.speed, 1e-6))}


def _harmonics(angle: FloatArray, share: FloatArray, frame: str) -> Columns:
    waves = {
        f"moving towards {frame} +x against -x": np.cos(angle),
        f"moving towards {frame} +y against -y": np.sin(angle),
        f"moving along {frame} x against y": np.cos(2 * angle),
        f"moving along the {frame}'s diagonals": np.sin(2 * angle),
    }
    return {name: share * wave for name, wave in waves.items()}


def _table_direction(at: Conditions) -> Columns:
    return _harmonics(at.table_direction, at.translating, "table")


def _object_direction(at: Conditions) -> Columns:
    return _harmonics(at.object_direction, at.translating, "object")


def _phase(at: Conditions) -> Columns:
    return {f"more in {PHASE_NAMES[phase]}": (at.phase == phase).astype(float) for phase in Phase}


def _time(at: Conditions) -> Columns:
    return {"more later in the push": at.share}


def _order(at: Conditions) -> Columns:
    return {"more in later pushes": at.push.astype(float)}


def world(residuals: Residuals) -> Columns:
    """Components towards the table's axes."""
    return {"towards table x": residuals.relative[:, 0], "towards table y": residuals.relative[:, 1]}


def in_object(residuals: Residuals) -> Columns:
    """Components towards the object's axes."""
    x, y = residuals.relative[:, :2].T
    c, s = np.cos(residuals.at.angle), np.sin(residuals.at.angle)
    return {"towards object x": c * x + s * y, "towards object y": c * y - s * x}


def turning(residuals: Residuals) -> Columns:
    """Turning, counter-clockwise."""
    return {"turning counter-clockwise": residuals.relative[:, 2]}


def onward(residuals: Residuals) -> Columns:
    """Along the motion of the centroid and, for residual motion, in the sense of its turning."""
    unit = residuals.at.velocity / np.maximum(residuals.at.speed, 1e-12)[:, None]
    if residuals.values.shape[1] == 2:
        return {"along the motion": (unit[:, :2] * residuals.relative).sum(axis=1)}
    return {
        "along the motion": (unit[:, :2] * residuals.relative[:, :2]).sum(axis=1),
        "in the sense of its turning": unit[:, 2] * residuals.relative[:, 2],
    }


def sideways(residuals: Residuals) -> Columns:
    """To the left of the motion."""
    unit = residuals.at.velocity[:, :2] / np.maximum(residuals.at.speed, 1e-12)[:, None]
    x, y = residuals.relative[:, :2].T
    return {"to the left of the motion": unit[:, 0] * y - unit[:, 1] * x}


def _join(*components: Callable[[Residuals], Columns]) -> Callable[[Residuals], Columns]:
    return lambda residuals: {name: v for part in components for name, v in part(residuals).items()}


MOTION_FACTORS = (
    Factor("overall", "everywhere alike: too far or too short", ((_always, onward),)),
    Factor("table_drift", "one direction of the table", ((_always, _join(world, turning)),)),
    Factor("object_drift", "one direction of the object", ((_always, in_object),)),
    Factor("table_place", "place on the table", ((_table_place, _join(world, turning, onward)),)),
    Factor("contact_place", "place of contact on the object", ((_contact_place, _join(in_object, turning)),)),
    Factor("speed", "speed", ((_speed, onward),)),
    Factor(
        "table_direction",
        "direction of motion on the table",
        ((_table_direction, _join(onward, sideways, turning)),),
    ),
    Factor(
        "object_direction",
        "direction of motion seen from the object",
        ((_object_direction, _join(onward, sideways, turning)),),
    ),
    Factor("phase", "phase of the push", ((_phase, onward),), along_the_push=True),
    Factor("time", "time within the push", ((_time, onward),), along_the_push=True),
    Factor("order", "order of the pushes", ((_order, _join(onward, world, turning)),)),
)

FORCE_FACTORS = (
    Factor("overall", "everywhere alike: too strong or too weak", ((_always, onward),)),
    Factor("table_drift", "one direction of the table", ((_always, world),)),
    Factor("object_drift", "one direction of the object", ((_always, in_object),)),
    Factor("table_place", "place on the table", ((_table_place, _join(world, onward)),)),
    Factor("contact_place", "place of contact on the object", ((_contact_place, _join(in_object, onward)),)),
    Factor("speed", "speed", ((_speed, onward),)),
    Factor(
        "table_direction", "direction of motion on the table", ((_table_direction, _join(onward, sideways)),)
    ),
    Factor(
        "object_direction",
        "direction of motion seen from the object",
        ((_object_direction, _join(onward, sideways)),),
    ),
    Factor("phase", "phase of the push", ((_phase, onward),), along_the_push=True),
    Factor("time", "time within the push", ((_time, onward),), along_the_push=True),
    Factor("order", "order of the pushes", ((_order, _join(onward, world)),)),
)
