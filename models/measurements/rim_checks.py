"""Check pushes against the declared table: whether it carries the object before and after each of them."""

from collections.abc import Sequence
from functools import partial

import numpy as np
import shapely
from numpy.typing import NDArray

from slipmap.models.geometry import placed, seen_from
from slipmap.models.measurements import parsing
from slipmap.models.measurements.push_dataset import Setup
from slipmap.models.measurements.trial import Trial
from slipmap.models.physics.cell_grid import FloatArray

_RIM_ERROR = 0.01  # m by which the rim, or the outline there, may be off
_LEAST_SUPPORT = 0.05  # of the outline's area, without which nothing stands
_FINE = 61  # places of a centre of mass tried along each side of the outline
_TABLE = "table.center and its size in dataset.yaml must be in m, in the frame of object_pose"


def beside_table(setup: Setup, trial: Trial) -> str | None:
    """What is wrong if no table carries the object when a push begins; None if one does or none is given."""
    if setup.table is None:
        return None
    lies = shapely.transform(setup.grid.polygon, partial(placed, pose=trial.object_pose.values[0]))
    if lies.distance(setup.table.polygon) == 0.0:
        return None
    return (
        "the object begins wholly beyond the table's rim; table.center and its size must be in m, in the"
        " frame of object_pose"
    )


def beyond_table(setup: Setup, trials: Sequence[Trial]) -> tuple[str | None, float]:
    """What contradicts the declared table, or where the object fell off it; None if nothing does.

    An object at rest has its centre of mass over the part of its outline that the table carries. If no centre
    of mass is carried at the start of every push, the table or the poses are wrong. An object has fallen only
    if no centre that all starts allow is carried at its end. Pushes found by `beside_table` do not count.

    Returns:
        The complaint, and the share of the pushes that begin where the object cannot rest.
    """
    if setup.table is None:
        return None, 0.0
    chosen = [trial for trial in trials if beside_table(setup, trial) is None]
    resting = [trial for trial in chosen if not trial.initial_velocity().any()]
    exterior = setup.grid.exterior
    sides = np.linspace(exterior.min(axis=0), exterior.max(axis=0), _FINE)
    slack = _RIM_ERROR + 0.5 * float(np.hypot(*(sides[1] - sides[0])))  # the centre lies between places tried
    tried = np.stack(np.meshgrid(*sides.T), axis=-1).reshape(-1, 2)
    tried = tried[shapely.contains_xy(setup.grid.polygon.convex_hull, *tried.T)]
    carried = np.array([_carried(setup, trial.object_pose.values[0], tried, slack) for trial in resting])
    votes = carried.reshape(-1, len(tried)).sum(axis=0)
    best = int(votes.argmax())
    if unstable := [trial for trial, row in zip(resting, carried, strict=True) if not row[best]]:
        text = (
            f"in {len(unstable)} of {len(trials)} pushes the object begins where it would fall off the table,"
            f" wherever its centre of mass is ({_middles(setup, unstable, 0)}); {_TABLE}"
        )
        return text, len(unstable) / len(trials)
    allowed = tried[votes == votes[best]]
    fallen = [one for one in chosen if not _carried(setup, one.object_pose.values[-1], allowed, slack).any()]
    if not fallen:
        return None, 0.0
    text = (
        f"{parsing.listed([trial.name for trial in fallen])}: the object ends where no table carries it, so"
        f" it fell ({_middles(setup, fallen, -1)}); end the trial where it tips. If it did not fall, {_TABLE}"
    )
    return text, 0.0


def _carried(setup: Setup, pose: FloatArray, centers: FloatArray, slack: float) -> NDArray[np.bool_]:
    """(M,) whether an object at a pose (3,) can rest with its centre of mass at each of `centers` (M, 2),
    object frame, and the rim up to `slack` m further out."""
    assert setup.table is not None
    if setup.table.margin(placed(setup.grid.exterior, pose)).min() >= 0.0:
        return np.ones(len(centers), dtype=bool)
    top = shapely.transform(setup.table.polygon.buffer(slack), partial(seen_from, pose=pose))
    part = setup.grid.polygon.intersection(top)
    enough = part.area > _LEAST_SUPPORT * setup.grid.polygon.area
    return np.asarray(shapely.contains_xy(part.convex_hull, *centers.T) & enough)


def _middles(setup: Setup, trials: Sequence[Trial], row: int) -> str:
    """How far the middle of the outline lies beyond the rim in a row of pushes, at most."""
    assert setup.table is not None
    center = np.array(setup.grid.polygon.centroid.coords[0])
    poses = np.array([trial.object_pose.values[row] for trial in trials])
    off = -float(setup.table.margin(placed(center, poses)).min())
    side = "beyond" if off > 0.0 else "inside"
    return (
        f"the middle of its outline is {'up to ' * (len(trials) > 1)}{1e3 * abs(off):.0f} mm {side} the rim"
    )
