"""Simulated pushes of an object with known maps, recorded as sensors would, for demonstrations and checks."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely

from slipmap.models.geometry import rotated, seen_from
from slipmap.models.measurements.push_dataset import Noise, PushDataset, gaps
from slipmap.models.measurements.trial import Channel, Role, Trial
from slipmap.models.measurements.trial_tables import if_turning
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Maps, Push, Slider
from slipmap.models.settings import check_kind, check_several

GOOD_SENSORS = Noise(position=0.25e-3, angle=float(np.radians(0.15)), tip=0.05e-3, force=0.05)
"""A marker tracker, a stiff arm and a wrist force sensor."""


DEEPEST = 5e-3
"""Depth of a finger that begins a push, m, beyond which no error of the sensors explains it."""


def record_pushes(
    slider: Slider,
    maps: Maps,
    pushes: Sequence[Push],
    rng: np.random.Generator,
    *,
    noise: Noise = GOOD_SENSORS,
    heldout: int = 0,
    rate: float = 100.0,
    name: str = "simulated",
    description: str = "",
    height: float | None = None,
    mass: float | None = None,
) -> PushDataset:
    """Simulate pushes and record them with independent normal noise on every row.

    A row of force is the mean over 1 / rate, stamped at its midpoint, as from a sensor with a filter.

    A push in which the object tips over the table's rim is refused: a record would end in poses of a fall,
    which no model of sliding explains.

    Args:
        slider: the object's model; its table becomes that of the dataset.
        maps: the true maps, one model.
        pushes: B pushes by a finger, each from its own start pose. They are made one after another; if their
            orders are different whole numbers, in these.
        rng: source of the noise.
        noise: standard deviations; None is no noise. The torque has that of the force times the radius. Each
            push touches the object elsewhere by the error of the outline.
        heldout: number of last pushes to hold out; the others are for learning.
        rate: rows per second of every channel.
        name, description: of the dataset.
        height, mass: of the object, m and kg, if the dataset is to state them.

    Raises:
        TypeError: something other than pushes and a generator.
        ValueError: several models, a push without a finger or with one that begins inside the object, one in
            which the object tips, a number of held-out pushes that does not fit, or a rate that is not
            positive.

    Example:
        >>> import numpy as np
        >>> import slipmap
        >>> grid, truth = slipmap.hammer()
        >>> push = slipmap.candidate_pushes(grid, 0.008, np.random.default_rng(0), 1)[0].push([0, 0, 0])
        >>> slider = slipmap.Slider(grid, finger_radius=0.008)
        >>> dataset = slipmap.record_pushes(slider, truth, [push], np.random.default_rng(0))
        >>> dataset.trials[0].role
        'fit'
    """
    if len(maps) != 1:
        raise ValueError(f"recording: needs exactly one model, the true maps, got {len(maps)}")
    check_several("recording: pushes", pushes, "such as [push]")
    if not 0 <= heldout <= len(pushes) or not pushes:
        raise ValueError(
            f"recording: cannot hold out {heldout} of {len(pushes)} pushes; it takes at least one push, of"
            " which 0 to all may be held out"
        )
    if not (np.isfinite(rate) and rate > 0):
        raise ValueError(f"recording: rate must be positive, got {rate} Hz")
    check_kind("recording: rng", rng, np.random.Generator, "such as np.random.default_rng(0)")
    for index, push in enumerate(pushes):
        check_kind(f"recording: push {index}", push, Push, "such as a Candidate's push(pose)")
    for index, push in enumerate(pushes):
        check_begins_clear(f"recording: push {index}", slider, push.start_pose, push.tip[0])
    orders = [push.order for push in pushes]
    if len(set(orders)) < len(orders) or any(order < 0 or order % 1 for order in orders):
        orders = [float(index) for index in range(len(pushes))]
    timed = [
        _sampled(replace(push, order=order), rate, index)
        for index, (push, order) in enumerate(zip(pushes, orders, strict=True))
    ]
    rollouts = slider.rollout(maps, [_touching_elsewhere(push, noise.outline, rng) for push in timed])
    if rollouts.tipped.any():
        index = int(np.argmax(rollouts.tipped[0]))
        raise ValueError(
            f"recording: in push {index} the object tips over the table's rim {rollouts.tips[0, index]:.2f} s"
            " after its start; leave this push out or make it shorter"
        )
    trials = []
    for index, push in enumerate(timed):
        assert push.pose_times is not None
        role: Role = "heldout" if index >= len(pushes) - heldout else "fit"
        tip = Channel(_ends(push), push.tip).at(push.pose_times)
        poses = Channel(push.pose_times, rollouts.poses_of(index)[0])
        wrench = _wrench(slider.grid, push, poses, rollouts.forces_of(index)[0], rate)
        force, angle = noise.force or 0.0, None
        if push.tip_angle is not None:
            turned = np.interp(push.pose_times, _ends(push), push.tip_angle)
            angle = if_turning(Channel(push.pose_times, turned[:, None]))
        trials.append(
            Trial(
                f"trials/{index:03d}.json",
                role,
                _measured(rng, poses, [noise.position, noise.position, noise.angle]),
                _measured(rng, Channel(push.pose_times, tip), [noise.tip, noise.tip]),
                _measured(rng, wrench, [force, force, force * slider.finger_radius]),
                order=int(push.order),
                tip_angle=angle,
            )
        )
    digest = hashlib.sha256()
    for channel in (channel for trial in trials for channel in trial.channels.values()):
        digest.update(channel.time.tobytes() + channel.values.tobytes())
    return PushDataset(
        name=name,
        description=description,
        grid=slider.grid,
        height=height,
        mass=mass,
        finger_radius=slider.finger_radius,
        table=slider.table,
        gravity=slider.gravity,
        noise=noise,
        trials=tuple(trials),
        fingerprint=digest.hexdigest(),
    )


def _touching_elsewhere(push: Push, outline: float | None, rng: np.random.Generator) -> Push:
    """The push with its finger displaced as if the outline were off, with this standard deviation."""
    return push if outline is None else replace(push, tip=push.tip + outline * rng.standard_normal(2))


def check_begins_clear(name: str, slider: Slider, pose: FloatArray, tip: FloatArray) -> None:
    """Raise ValueError for a finger that is first felt deep inside the object, which would be shot away.

    Args:
        name: what begins, for the message.
        slider: the object and the finger's radius.
        pose: (3,) of the object.
        tip: (2,) centre of the finger, world, m; NaN where there is none.
    """
    depth = -float(gaps(slider, tip[None], pose)[0]) if np.isfinite(tip).all() else 0.0
    if depth > DEEPEST:
        raise ValueError(
            f"{name} begins with the finger {1e3 * depth:.0f} mm inside the object; let it begin clear of it"
        )


def _sampled(push: Push, rate: float, index: int) -> Push:
    """The push with poses at `rate` and forces at every step."""
    if not np.isfinite(push.tip).all():
        raise ValueError(f"recording: push {index} has no finger, but a recorded push needs one")
    steps = len(push.tip) - 1
    rows = np.arange(int(np.floor(steps * push.h * rate * (1 + 1e-12))) + 1) / rate
    if len(rows) < 3 or push.h * rate > 1.0:
        raise ValueError(
            f"recording: push {index} lasts {steps * push.h:.3g} s in steps of {push.h:.3g} s; at {rate:g} Hz"
            " there must be at least three rows, and a step for each"
        )
    return replace(push, pose_times=rows, force_times=_ends(push)[1:] - 0.5 * push.h, force_span=0.0)


def _ends(push: Push) -> FloatArray:
    """(N + 1,) times of the ends of steps, s."""
    return push.h * np.arange(len(push.tip), dtype=float)


def _measured(rng: np.random.Generator, true: Channel, levels: Sequence[float | None]) -> Channel:
    sigma = np.array([level or 0.0 for level in levels])
    return Channel(true.time, true.values + sigma * rng.standard_normal(true.values.shape))


def _wrench(grid: CellGrid, push: Push, poses: Channel, forces: FloatArray, rate: float) -> Channel:
    """Mean force from row to row of the pose, and the torque about the tip: (contact - tip) × force."""
    row = np.minimum((push.force_times * rate).astype(int), len(poses.time) - 2)
    count = np.bincount(row)
    mean = np.column_stack([np.bincount(row, weights=component) / count for component in forces.T])
    time = 0.5 * (poses.time[:-1] + poses.time[1:])
    pose = poses.at(time)
    local = seen_from(Channel(_ends(push), push.tip).at(time), pose)
    outline = grid.polygon.boundary
    nearest = shapely.line_interpolate_point(
        outline, shapely.line_locate_point(outline, shapely.points(local))
    )
    arm = rotated(shapely.get_coordinates(nearest) - local, pose[:, 2])
    torque = arm[:, 0] * mean[:, 1] - arm[:, 1] * mean[:, 0]
    return Channel(time, np.column_stack([mean, torque]))
