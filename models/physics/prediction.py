"""Guess of the next twist from the last ones: where a push is smooth it saves Newton's second evaluation."""

from __future__ import annotations

from models.physics.compiled import compiled


@compiled(forceinline=True, fastmath={"contract"})
def weighted(weights, past):  # type: ignore[no-untyped-def]
    """Weighted sum of the last three twists, the newest first."""
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
