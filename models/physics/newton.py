"""One Newton iteration of the convex step: a quadratic model of inertia and friction, with exact contact.

With exact contact, its narrow valleys cost no evaluations of the cells. 3 × 3 matrices are tuples of their
upper triangle here: small arrays would cost more than the arithmetic.

A cell of friction load f_i = mu_i N_i that slides with velocity u_i (object frame) while the object turns at
omega dissipates power f_i φ_i with the smoothed norm

    φ_i = sqrt(|u_i|² + (ρ omega)² + ε²),    u_i = (v_x - omega r_iy, v_y + omega r_ix),    ρ = w / sqrt(12).

ρ represents the spin of a finite cell. w²/12 is the exact second-order term of the mean of |u| over a square
that slides faster than it spins, as nearly every cell does. For a disc of 60 cells that spins in place it
errs by -0.02 % of those squares' torque; the radius that is exact for a single square spinning in place
(0.3826 w) errs by +0.43 %. Cutting the disc into squares itself adds 0.52 % to 2/3 mu m g R.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from slipmap.models.physics.compiled import compiled
from slipmap.models.physics.contact import SEPARATE, cone_matrix, cone_state, springs

SPIN_RADIUS = 1.0 / math.sqrt(12.0)
"""Radius of gyration ρ of a cell's own friction, in cell widths."""

LANES = 8
"""Loops over cells run fastest on multiples of this; cells without load pad the arrays."""

_FAST = {"reassoc", "contract", "arcp", "nsz"}


class Cells(NamedTuple):
    """The cells in the form that a step uses."""

    load: NDArray[np.float64]  # (n,) friction loads f_i, N; n is a multiple of `LANES`
    # rx, ry: (n,) cell centres, m
    rx: NDArray[np.float64]
    ry: NDArray[np.float64]
    # rho2, eps2: ρ², m², and ε², m²/s²
    rho2: float
    eps2: float


@compiled()
def padded_cells(load, rx, ry, cell_width, slip_speed):  # type: ignore[no-untyped-def]
    """`Cells` of n loads and centres, padded with cells without load; `slip_speed` is ε."""
    n = load.shape[0]
    rows = np.zeros((3, (n + LANES - 1) // LANES * LANES))
    for i in range(n):
        rows[0, i], rows[1, i], rows[2, i] = load[i], rx[i], ry[i]
    return Cells(rows[0], rows[1], rows[2], (SPIN_RADIUS * cell_width) ** 2, slip_speed * slip_speed)


@compiled(fastmath=_FAST, forceinline=True)
def friction_moments(load, rx, ry, vx, vy, omega, rho2, eps2):  # type: ignore[no-untyped-def]
    """Sums over cells from which energy, gradient and Hessian of Σ f_i φ_i follow.

    With s = 1/φ, a = f s, b = f s³ and g = Jᵀu = (u_x, u_y, r × u + ρ² omega), the gradient is
    Σ a g and the Hessian Σ a JᵀJ - Σ b g gᵀ. The loop contains only sums, so that it vectorises.

    Returns:
        Σ f φ, Σ a, Σ a r_x, Σ a r_y, Σ a |r|², then Σ b g gᵀ as xx, xy, yy, xω, yω, ωω, and last Σ f s²,
        which bounds how fast the Hessian changes.
    """
    energy = 0.0
    a_sum = 0.0
    ax = 0.0
    ay = 0.0
    arr = 0.0
    bxx = 0.0
    bxy = 0.0
    byy = 0.0
    bxw = 0.0
    byw = 0.0
    bww = 0.0
    bend = 0.0
    constant = rho2 * omega * omega + eps2
    spin = rho2 * omega
    for i in range(load.shape[0]):
        x = rx[i]
        y = ry[i]
        ux = vx - omega * y
        uy = vy + omega * x
        phi2 = ux * ux + uy * uy + constant
        inverse = 1.0 / math.sqrt(phi2)
        a = load[i] * inverse
        energy += a * phi2
        a_inverse = a * inverse
        b = a_inverse * inverse
        bend += a_inverse
        gw = x * uy - y * ux + spin
        a_sum += a
        ax += a * x
        ay += a * y
        arr += a * (x * x + y * y)
        bux = b * ux
        buy = b * uy
        bxx += bux * ux
        bxy += bux * uy
        byy += buy * uy
        bxw += bux * gw
        byw += buy * gw
        bww += b * gw * gw
    return energy, a_sum, ax, ay, arr, bxx, bxy, byy, bxw, byw, bww, bend


@compiled(forceinline=True, fastmath={"contract"})
def plain_gradients(cells, v, by_load):  # type: ignore[no-untyped-def]
    """Fill by_load (3, n): derivative of Coulomb friction's gradient at the twist v per load of each cell."""
    vx, vy, omega = v
    spin = cells.rho2 * omega
    constant = spin * omega + cells.eps2
    rx, ry = cells.rx, cells.ry
    row_x, row_y, row_w = by_load[0], by_load[1], by_load[2]
    for i in range(row_x.shape[0]):
        ux = vx - omega * ry[i]
        uy = vy + omega * rx[i]
        inverse = 1.0 / math.sqrt(ux * ux + uy * uy + constant)
        row_x[i] = ux * inverse
        row_y[i] = uy * inverse
        row_w[i] = (rx[i] * uy - ry[i] * ux + spin) * inverse


class Quadratic(NamedTuple):
    """Gradient and Hessian (upper triangle) in v_x, v_y, omega of a convex function at one twist."""

    gx: float
    gy: float
    gw: float
    xx: float
    xy: float
    xw: float
    yy: float
    yw: float
    ww: float


class Impulse(NamedTuple):
    """State of one contact in its cone and its impulses γ_n, γ_t in one step, N s."""

    state: int
    normal: float
    tangential: float


class Minimum(NamedTuple):
    """Minimum of a quadratic model with contacts: the step to it, the inverse Hessian there, and contacts."""

    dx: float
    dy: float
    dw: float
    xx: float
    xy: float
    xw: float
    yy: float
    yw: float
    ww: float
    first: Impulse
    second: Impulse


def smooth_model(cells, inertia, star, h, v):  # type: ignore[no-untyped-def]
    """Inertia and friction at the twist v, without the contact; compilation selects by the class of `cells`.

    Args:
        cells: `Cells`, or another class with a registered implementation, such as `EffectCells`.
        inertia: m, s_x, s_y, J.
        star: momentum of the free motion: two linear components, N s, and the angular one, N m s.
        h: step, s.
        v: twist.

    Returns:
        The `Quadratic`, and the bound Σ f s² on its change, see `friction_moments`.
    """
    raise TypeError("smooth_model runs only in compiled code")


def register_cells(kind: type, implementation: Callable[..., Any]) -> None:
    """Make `smooth_model` call `implementation` for cells of the named tuple class `kind`."""

    @overload(smooth_model, jit_options={"forceinline": True})
    def chosen(cells, inertia, star, h, v):  # type: ignore[no-untyped-def]
        if getattr(cells, "instance_class", None) is not kind:
            return None
        return lambda cells, inertia, star, h, v: implementation(cells, inertia, star, h, v)


@compiled(forceinline=True, fastmath={"contract"})
def coulomb_sums(cells, v):  # type: ignore[no-untyped-def]
    """Sums over cells under Coulomb friction at the twist v.

    Returns:
        Gradient (3) and Hessian (6: xx, xy, xω, yy, yω, ωω) of Σ f_i φ_i, and Σ f s², see `friction_moments`.
    """
    vx, vy, omega = v
    _, a, ax, ay, arr, bxx, bxy, byy, bxw, byw, bww, bend = friction_moments(
        cells.load, cells.rx, cells.ry, vx, vy, omega, cells.rho2, cells.eps2
    )
    spin = arr + cells.rho2 * a
    gradient = (a * vx - ay * omega, a * vy + ax * omega, ax * vy - ay * vx + spin * omega)
    return gradient, (a - bxx, -bxy, -(ay + bxw), a - byy, ax - byw, spin - bww), bend


@compiled(forceinline=True, fastmath={"contract"})
def quadratic_of(inertia, star, h, v, gradient, hessian):  # type: ignore[no-untyped-def]
    """`Quadratic` of inertia and friction, from the arguments of `smooth_model` and the sums over cells."""
    m, sx, sy, J = inertia
    vx, vy, omega = v
    gx, gy, gw = gradient
    xx, xy, xw, yy, yw, ww = hessian
    return Quadratic(
        m * vx - sy * omega - star[0] + h * gx,
        m * vy + sx * omega - star[1] + h * gy,
        sx * vy - sy * vx + J * omega - star[2] + h * gw,
        m + h * xx,
        h * xy,
        -sy + h * xw,
        m + h * yy,
        sx + h * yw,
        J + h * ww,
    )


@compiled(forceinline=True, fastmath={"contract"})
def _coulomb_model(cells, inertia, star, h, v):  # type: ignore[no-untyped-def]
    """`smooth_model` of plain Coulomb friction on `Cells`."""
    gradient, hessian, bend = coulomb_sums(cells, v)
    return quadratic_of(inertia, star, h, v, gradient, hessian), bend


register_cells(Cells, _coulomb_model)


@compiled(forceinline=True, fastmath={"contract"})
def with_contact(model, contact, cone, state, y_n, y_t):  # type: ignore[no-untyped-def]
    """The model plus the energy of a contact with spring impulses y_n, y_t that keeps its state."""
    if state == SEPARATE:
        return model
    nn, nt, tn, tt = cone_matrix(cone.mu, contact.ratio, state)
    gamma_n = nn * y_n + nt * y_t
    gamma_t = tn * y_n + tt * y_t
    nx, ny, nw = contact.nx, contact.ny, contact.nw
    tx, ty, tw = -ny, nx, contact.tw
    hnn = nn * contact.normal
    hnt = -nt * cone.tangential
    htt = tt * cone.tangential
    # Rows of (h_nn n + h_nt t) nᵀ + (h_nt n + h_tt t) tᵀ.
    ax, ay, aw = hnn * nx + hnt * tx, hnn * ny + hnt * ty, hnn * nw + hnt * tw
    bx, by, bw = hnt * nx + htt * tx, hnt * ny + htt * ty, hnt * nw + htt * tw
    return Quadratic(
        model.gx + nx * gamma_n - tx * gamma_t,
        model.gy + ny * gamma_n - ty * gamma_t,
        model.gw + nw * gamma_n - tw * gamma_t,
        model.xx + ax * nx + bx * tx,
        model.xy + ax * ny + bx * ty,
        model.xw + ax * nw + bx * tw,
        model.yy + ay * ny + by * ty,
        model.yw + ay * nw + by * tw,
        model.ww + aw * nw + bw * tw,
    )


@compiled(forceinline=True, fastmath={"contract"})
def minimum_of(model, first, second):  # type: ignore[no-untyped-def]
    """`Minimum` of a quadratic model; `first` and `second` are passed through."""
    a, b, c, d, e, f = model.xx, model.xy, model.xw, model.yy, model.yw, model.ww
    cxx = d * f - e * e
    cxy = c * e - b * f
    cxw = b * e - c * d
    scale = 1.0 / (a * cxx + b * cxy + c * cxw)
    xx = cxx * scale
    xy = cxy * scale
    xw = cxw * scale
    yy = (a * f - c * c) * scale
    yw = (b * c - a * e) * scale
    ww = (a * d - b * b) * scale
    dx = -(xx * model.gx + xy * model.gy + xw * model.gw)
    dy = -(xy * model.gx + yy * model.gy + yw * model.gw)
    dw = -(xw * model.gx + yw * model.gy + ww * model.gw)
    return Minimum(dx, dy, dw, xx, xy, xw, yy, yw, ww, first, second)


@compiled(forceinline=True, fastmath={"contract"})
def _impulse_after(contact, cone, state, y_n, y_t, way):  # type: ignore[no-untyped-def]
    """Contact after the step (d_x, d_y, d_w), as if it kept its state.

    Returns:
        The `Impulse`, the state that the springs then imply, and the difference to the impulse in that state.
    """
    dx, dy, dw = way
    y_n += (contact.nx * dx + contact.ny * dy + contact.nw * dw) * contact.normal
    y_t -= (contact.nx * dy - contact.ny * dx + contact.tw * dw) * cone.tangential
    nn, nt, tn, tt = cone_matrix(cone.mu, contact.ratio, state)
    impulse = Impulse(state, nn * y_n + nt * y_t, tn * y_n + tt * y_t)
    true_state = cone_state(y_n, y_t, cone.mu, contact.ratio)
    error = 0.0
    if true_state != state:
        nn, nt, tn, tt = cone_matrix(cone.mu, contact.ratio, true_state)
        error = abs(impulse.normal - nn * y_n - nt * y_t) + abs(impulse.tangential - tn * y_n - tt * y_t)
    return impulse, true_state, error


@compiled(forceinline=True, fastmath={"contract"})
def solve_with_contacts(model, v, first, second, count, cone):  # type: ignore[no-untyped-def]
    """Minimise the quadratic model around v plus the exact energy of the first `count` contacts.

    For each combination of contact states the problem is linear. The states that the last candidate implies
    are tried first. If they cycle, trying all combinations finds the minimum, which is unique.

    Returns:
        `Minimum`.
    """
    none = Impulse(SEPARATE, 0.0, 0.0)
    if count == 0:
        return minimum_of(model, none, none)
    vx, vy, omega = v
    n1, t1 = springs(first, cone, vx, vy, omega)
    n2, t2 = springs(second, cone, vx, vy, omega)
    state1 = cone_state(n1, t1, cone.mu, first.ratio)
    state2 = cone_state(n2, t2, cone.mu, second.ratio) if count > 1 else SEPARATE
    best1, best2 = state1, state2
    best_error = math.inf
    followed = 5
    last = followed + 4**count
    attempt = 0
    while True:
        total = with_contact(model, first, cone, state1, n1, t1)
        total = with_contact(total, second, cone, state2, n2, t2)
        minimum = minimum_of(total, none, none)
        way = (minimum.dx, minimum.dy, minimum.dw)
        impulse1, true1, error = _impulse_after(first, cone, state1, n1, t1, way)
        impulse2, true2 = none, SEPARATE
        if count > 1:
            impulse2, true2, error2 = _impulse_after(second, cone, state2, n2, t2, way)
            error += error2
        scale = (
            abs(impulse1.normal) + abs(impulse1.tangential) + abs(impulse2.normal) + abs(impulse2.tangential)
        )
        if error <= 1e-13 * scale or attempt == last:
            return Minimum(
                minimum.dx, minimum.dy, minimum.dw, minimum.xx, minimum.xy, minimum.xw, minimum.yy,
                minimum.yw, minimum.ww, impulse1, impulse2,
            )  # fmt: skip
        if error < best_error:
            best_error = error
            best1, best2 = state1, state2
        attempt += 1
        if attempt < followed:
            state1, state2 = true1, true2
        elif attempt < last:
            state1, state2 = (attempt - followed) % 4, (attempt - followed) // 4
        else:
            state1, state2 = best1, best2


@compiled(forceinline=True, fastmath={"contract"})
def _contact_slope(contact, cone, v, d):  # type: ignore[no-untyped-def]
    """Derivative of one contact's energy at v along d."""
    y_n, y_t = springs(contact, cone, v[0], v[1], v[2])
    nn, nt, tn, tt = cone_matrix(cone.mu, contact.ratio, cone_state(y_n, y_t, cone.mu, contact.ratio))
    along_normal = contact.nx * d[0] + contact.ny * d[1] + contact.nw * d[2]
    along_tangent = contact.nx * d[1] - contact.ny * d[0] + contact.tw * d[2]
    return (nn * y_n + nt * y_t) * along_normal - (tn * y_n + tt * y_t) * along_tangent


@compiled(forceinline=True, fastmath={"contract"})
def slope_along(model, v, d, first, second, count, cone):  # type: ignore[no-untyped-def]
    """Derivative of the step's whole function along d, at v; `model` holds its smooth part there."""
    slope = model.gx * d[0] + model.gy * d[1] + model.gw * d[2]
    if count > 0:
        slope += _contact_slope(first, cone, v, d)
    if count > 1:
        slope += _contact_slope(second, cone, v, d)
    return slope
