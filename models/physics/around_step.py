"""What is done around each solved step: given forces and a first guess before it, force and way after it.

Shared by the rollouts of `kernel.py` and `effect_kernel.py` and by `single_step.py`, inlined into each.
"""

from __future__ import annotations

from typing import NamedTuple

from slipmap.models.physics.compiled import compiled
from slipmap.models.physics.kernel_tools import Turn, joined, turn_by, turned
from slipmap.models.physics.newton import Minimum
from slipmap.models.physics.step import Frame, Solved, solve_step, solved_step


class Applied(NamedTuple):
    """Impulse of given forces in a step, middle frame.

    Attributes:
        x, y: N s.
        turning: derivative of its moment about the origin by the object's angle, N m s.
        spin: its moment about the origin, N m s.
    """

    x: float
    y: float
    turning: float
    spin: float


class Way(NamedTuple):
    """How a step moves the pose: along the screw of v⁺, by h sinc(h omega/2) R(θ + h omega/2) v⁺.

    Attributes:
        quarter: `Turn` by h omega/4.
        half_cos, half_sin: of h omega/2.
        cos, sin: of the angle half-way.
        wx, wy: direction times speed, world.
        length: h sinc(h omega/2), s.
    """

    quarter: Turn
    half_cos: float
    half_sin: float
    cos: float
    sin: float
    wx: float
    wy: float
    length: float


@compiled(forceinline=True)
def applied_impulse(row, cos, sin, half_cos, half_sin, h):  # type: ignore[no-untyped-def]
    """`Applied` of one row of a push's wrenches.

    Args:
        row: (5,) force (world, N), its point (object frame, m) and a torque (N m).
        cos, sin: of the object's angle before the step.
        half_cos, half_sin: of the turn to the middle frame.
        h: step, s.
    """
    c, s = joined(cos, sin, half_cos, half_sin)
    fx, fy = turned(c, -s, row[0], row[1])
    px, py = row[2], row[3]
    return Applied(h * fx, h * fy, -h * (px * fx + py * fy), h * (px * fy - py * fx + row[4]))


@compiled(forceinline=True)
def add_applied_turning(A, applied, h):  # type: ignore[no-untyped-def]
    """Add to A, see `Slopes`, the derivatives by angle and spin, as given forces keep their direction."""
    for row, lever in enumerate((applied.y, -applied.x, applied.turning)):
        A[row, 2] -= lever
        A[row, 5] -= 0.5 * h * lever


@compiled(forceinline=True)
def bent_frame(frame, bend_x, bend_y, h):  # type: ignore[no-untyped-def]
    """The `Frame` of a finger that stands bend_x, bend_y (world, m) off its record and would straighten."""
    x, y = turned(frame.cos, -frame.sin, bend_x / h, bend_y / h)
    return Frame(frame.cos, frame.sin, frame.tip_x, frame.tip_y, frame.speed_x, frame.speed_y, x, y)


class Taken(NamedTuple):
    """A step that was taken.

    Attributes:
        new: twist after it.
        minimum: see `Solution`.
        solved: see `Solved`.
        impulse_x, impulse_y: of the finger on the object, middle frame, N s.
        way: see `Way`.
        evaluations: see `Solution`.
    """

    new: tuple[float, float, float]
    minimum: Minimum
    solved: Solved
    impulse_x: float
    impulse_y: float
    way: Way
    evaluations: int


@compiled(inline="always")
def take_step(step, start, derive, cos, sin):  # type: ignore[no-untyped-def]
    """`Taken` of a step from an angle with this cosine and sine; `start` is a guess of the new twist."""
    new, minimum, evaluations = solve_step(step, start, derive)
    solved = solved_step(step, new, minimum)
    x, y = finger_impulse(solved)
    return Taken(new, minimum, solved, x, y, way_of(new, cos, sin, step.h), evaluations)


@compiled(forceinline=True)
def finger_impulse(solved):  # type: ignore[no-untyped-def]
    """Impulse of the finger on the object (N s), middle frame."""
    first, second, impulse1, impulse2 = solved.first, solved.second, solved.impulse1, solved.impulse2
    x = -first.nx * impulse1.normal - first.ny * impulse1.tangential
    x -= second.nx * impulse2.normal + second.ny * impulse2.tangential
    y = first.nx * impulse1.tangential - first.ny * impulse1.normal
    y += second.nx * impulse2.tangential - second.ny * impulse2.normal
    return x, y


@compiled(forceinline=True)
def way_of(new, cos, sin, h):  # type: ignore[no-untyped-def]
    """`Way` of the twist v⁺ from an angle with this cosine and sine."""
    quarter = turn_by(0.25 * h * new[2])
    half_cos, half_sin = joined(quarter.cos, quarter.sin, quarter.cos, quarter.sin)
    c, s = joined(cos, sin, half_cos, half_sin)
    wx, wy = turned(c, s, new[0], new[1])
    return Way(quarter, half_cos, half_sin, c, s, wx, wy, h * quarter.sinc * quarter.cos)


@compiled(forceinline=True)
def way_by_spin(way, h):  # type: ignore[no-untyped-def]
    """Derivatives by omega of x and y after the step."""
    # Derivative of sinc(α) = sinc(α/2) cos(α/2) by omega, for α = h omega/2.
    slope = way.quarter.sinc_slope * way.quarter.cos - way.quarter.sinc * way.quarter.sin
    slope *= 0.25 * h * h
    bend = 0.5 * h * way.length
    return slope * way.wx - bend * way.wy, slope * way.wy + bend * way.wx


@compiled(forceinline=True, fastmath={"contract"})
def weighted(weights, past):  # type: ignore[no-untyped-def]
    """Guess of the next twist: weighted sum of the last three, the newest first.

    Where a push is smooth it saves Newton's second evaluation.
    """
    a, b, c = weights
    last, second, third = past
    return (
        a * last[0] + b * second[0] + c * third[0],
        a * last[1] + b * second[1] + c * third[1],
        a * last[2] + b * second[2] + c * third[2],
    )


@compiled(forceinline=True, fastmath={"contract"})
def best_weights(new, past, size):  # type: ignore[no-untyped-def]
    """Weights of the extrapolation that would have come nearest to `new`; those to use next.

    The candidates are the polynomials of order 0 to 2 through the last twists. `size` is the object's radius,
    m, at which rotation counts.
    """
    constant = (1.0, 0.0, 0.0)
    linear = (2.0, -1.0, 0.0)
    quadratic = (3.0, -3.0, 1.0)
    best, nearest = constant, _distance(new, past[0], size)
    for weights in (linear, quadratic):
        error = _distance(new, weighted(weights, past), size)
        if error < nearest:
            best, nearest = weights, error
    return best


@compiled(forceinline=True)
def _distance(a, b, size):  # type: ignore[no-untyped-def]
    return abs(a[0] - b[0]) + abs(a[1] - b[1]) + size * abs(a[2] - b[2])
