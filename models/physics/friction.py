"""Friction of cells under effects: an ellipse instead of a circle, drag, and blades.

A cell of load f_i under a friction factor s_i dissipates f_i s_i φ_i with

    φ_i = sqrt(uᵀ Q_i u + (ρ omega)² + ε²),

where Q_i is symmetric and positive definite; Q = 1 is Coulomb's law of `newton.py`. Drag adds
½ D_i (|u_i|² + w²/6 omega²), and a blade that resists motion along n with F adds F sqrt((b·v)² + ε²) with
b = (n_x, n_y, r × n). A friction pyramid, the simulators' substitute for the cone, replaces part of the norm:
c φ_i + d (ψ(u_i·e) + ψ(u_i·n)), with perpendicular unit vectors e and n and
ψ(w) = sqrt(w² + (ρ omega)²/4 + ε_p²). With e along x and d = 1 it is a square; a diamond has e along the
diagonal and d = 1/√2, since max(|x|, |y|) = (|x + y| + |x - y|)/2. All of them are convex in the twist v, so
the step stays a convex problem.

The formulas of effects are evaluated at y (Y,), which joins

    the state before the step: x, y, θ (world), v_x, v_y, omega (object frame);
    memory: nothing, or the last force of the finger on the object (world, N), a bending finger's lean (see
    `contact.py`), and the effects' own numbers;
    m, s_x, s_y, J;  and the effects' parameters.

`slipmap.models.effects.formulas` writes functions with this layout; rollouts and single steps call them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slipmap.models.physics.compiled import compiled
from slipmap.models.physics.newton import coulomb_sums, quadratic_of, register_cells

# Numbers of entries in the arguments of formulas.
STATE = 6
FORCE = 2
LEAN = STATE + FORCE  # of a bending finger: the index of its first component
INERTIA = 4

BODY_OUTPUTS = 5
"""Number of outputs of a body: wrench (middle frame: 2 forces, torque about the origin), inertia factor,
compliance of the finger (m/N). Each blade adds F, b_x, b_y, b_omega. If there are pyramids, c follows, and d,
e_x, e_y of each."""

INERTIA_FACTOR = 3
COMPLIANCE = 4

FINGER_SETTLING = 0.01
"""Time constant with which a bending finger settles, s. The time step alone would damp it too, but by as much
as the step is long."""

CONSTANTS = 11
"""Number of constants: time in the middle of the step, h, index of the push in the experiment, gravity, cell
width, the cells' centroid (2), the inverse of their second moments about it (xx, xy, yy; 1/m²), their number.
"""

AFTER = 8
"""Number of inputs of memory formulas besides y: x, y, θ, v_x, v_y, omega after the step, its force (2)."""

RIDGE = 10.0
"""ε_p in units of ε: with sharper pyramids, a step in which all cells slide along one side would need many
more evaluations."""

RIDGE_SPIN = 0.25
"""Share of ρ² in ψ. The mean of |w| over a cell is |w| at its centre unless w changes sign within the cell:
for spinning cells ρ² itself would give 3 % too much, and a quarter of it errs by less than 1 %."""

_FAST = {"reassoc", "contract", "arcp", "nsz"}


class EffectCells(NamedTuple):
    """The cells in the form that a step with effects uses."""

    # (n,) friction loads times their factors, f_i s_i, N; n is a multiple of `LANES`
    load: NDArray[np.float64]
    # rx, ry: (n,) cell centres, object frame, m
    rx: NDArray[np.float64]
    ry: NDArray[np.float64]
    # rho2, eps2: ρ², m², and ε², m²/s²
    rho2: float
    eps2: float
    stretched: bool  # whether any Q is not 1
    # qxx, qxy, qyy: (n,) each cell's Q, object frame; empty unless stretched
    qxx: NDArray[np.float64]
    qxy: NDArray[np.float64]
    qyy: NDArray[np.float64]
    longest: float  # largest eigenvalue of all Q, or 1 if that is larger
    drag: tuple[float, float, float, float]  # Σ D, Σ D r_x, Σ D r_y, Σ D (|r|² + w²/6)
    blades: NDArray[np.float64]  # (k, 4) F, b
    cone: float  # c, 1 without pyramids
    pyramids: NDArray[np.float64]  # (k, 3) d, e_x, e_y


@compiled(forceinline=True)
def _ridge(pyramid, k):  # type: ignore[no-untyped-def]
    """d and a unit vector of a pyramid (3,): e for even k, the perpendicular n for odd k."""
    d, ex, ey = pyramid[0], pyramid[1], pyramid[2]
    return (d, ex, ey) if k % 2 == 0 else (d, -ey, ex)


@compiled(fastmath=_FAST)
def _stretched_sums(cells, v):  # type: ignore[no-untyped-def]
    """The sums of `newton.coulomb_sums` with each cell's Q.

    These are Σ a g (3) and Σ a (JᵀQJ + ρ²) - Σ b g gᵀ (6), with a = f/φ, b = f/φ³ and
    g = Jᵀ Q u + (0, 0, ρ² omega).
    """
    vx, vy, omega = v
    load, rx, ry = cells.load, cells.rx, cells.ry
    qxx, qxy, qyy = cells.qxx, cells.qxy, cells.qyy
    spin = cells.rho2 * omega
    constant = spin * omega + cells.eps2
    gx = gy = gw = a_sum = 0.0
    hxx = hxy = hyy = hxw = hyw = hww = bend = 0.0
    for i in range(load.shape[0]):
        x = rx[i]
        y = ry[i]
        xx, xy, yy = qxx[i], qxy[i], qyy[i]
        ux = vx - omega * y
        uy = vy + omega * x
        px = xx * ux + xy * uy
        py = xy * ux + yy * uy
        inverse = 1.0 / math.sqrt(ux * px + uy * py + constant)
        a = load[i] * inverse
        flat = a * inverse
        b = flat * inverse
        pw = x * py - y * px + spin
        # Q times the last column of J.
        tx = x * xy - y * xx
        ty = x * yy - y * xy
        bend += flat
        a_sum += a
        gx += a * px
        gy += a * py
        gw += a * pw
        hxx += a * xx - b * px * px
        hxy += a * xy - b * px * py
        hyy += a * yy - b * py * py
        hxw += a * tx - b * px * pw
        hyw += a * ty - b * py * pw
        hww += a * (x * ty - y * tx) - b * pw * pw
    # The bound on the third derivative scales with the ellipse's long axis.
    bend *= cells.longest * math.sqrt(cells.longest)
    return (gx, gy, gw), (hxx, hxy, hxw, hyy, hyw, hww + cells.rho2 * a_sum), bend


@compiled(fastmath=_FAST)
def _ridge_sums(cells, v, ex, ey):  # type: ignore[no-untyped-def]
    """The sums of friction along one unit vector e.

    Returns:
        Gradient along e and about the origin; Hessian as e e, e omega, omega omega; the bound on its change.
    """
    vx, vy, omega = v
    load, rx, ry = cells.load, cells.rx, cells.ry
    along = vx * ex + vy * ey
    rho2 = RIDGE_SPIN * cells.rho2
    spin = rho2 * omega
    constant = spin * omega + RIDGE * RIDGE * cells.eps2
    ge = gw = hee = hew = hww = bend = 0.0
    for i in range(load.shape[0]):
        arm = rx[i] * ey - ry[i] * ex
        w = along + omega * arm
        inverse = 1.0 / math.sqrt(w * w + constant)
        a = load[i] * inverse
        flat = a * inverse
        b = flat * inverse
        turning = w * arm + spin
        bend += flat
        ge += a * w
        gw += a * turning
        hee += a - b * w * w
        hew += a * arm - b * w * turning
        hww += a * (arm * arm + rho2) - b * turning * turning
    return (ge, gw), (hee, hew, hww), bend


@compiled()
def _effect_model(cells, inertia, star, h, v):  # type: ignore[no-untyped-def]
    """`smooth_model` of `EffectCells`."""
    (gx, gy, gw), (hxx, hxy, hxw, hyy, hyw, hww), bend = (
        _stretched_sums(cells, v) if cells.stretched else coulomb_sums(cells, v)
    )
    vx, vy, omega = v
    if cells.pyramids.shape[0] > 0:
        cone = cells.cone
        gx, gy, gw, bend = cone * gx, cone * gy, cone * gw, cone * bend
        hxx, hxy, hyy = cone * hxx, cone * hxy, cone * hyy
        hxw, hyw, hww = cone * hxw, cone * hyw, cone * hww
        for k in range(2 * cells.pyramids.shape[0]):
            d, ex, ey = _ridge(cells.pyramids[k // 2], k)
            (ge, gspin), (hee, hew, hspin), more = _ridge_sums(cells, v, ex, ey)
            gx += d * ge * ex
            gy += d * ge * ey
            gw += d * gspin
            hxx += d * hee * ex * ex
            hxy += d * hee * ex * ey
            hyy += d * hee * ey * ey
            hxw += d * hew * ex
            hyw += d * hew * ey
            hww += d * hspin
            bend += d * more
    drag, drag_x, drag_y, drag_w = cells.drag
    hxx += drag
    hyy += drag
    hxw -= drag_y
    hyw += drag_x
    hww += drag_w
    gx += drag * vx - drag_y * omega
    gy += drag * vy + drag_x * omega
    gw += drag_x * vy - drag_y * vx + drag_w * omega
    for k in range(cells.blades.shape[0]):
        force, nx, ny, nw = cells.blades[k, 0], cells.blades[k, 1], cells.blades[k, 2], cells.blades[k, 3]
        along = nx * vx + ny * vy + nw * omega
        phi2 = along * along + cells.eps2
        inverse = 1.0 / math.sqrt(phi2)
        slope = force * along * inverse
        curve = force * cells.eps2 * inverse / phi2
        gx += slope * nx
        gy += slope * ny
        gw += slope * nw
        hxx += curve * nx * nx
        hxy += curve * nx * ny
        hyy += curve * ny * ny
        hxw += curve * nx * nw
        hyw += curve * ny * nw
        hww += curve * nw * nw
        bend += force / phi2
    return quadratic_of(inertia, star, h, v, (gx, gy, gw), (hxx, hxy, hxw, hyy, hyw, hww)), bend


register_cells(EffectCells, _effect_model)


@compiled(fastmath={*_FAST, "nnan"})
def longest_axis(qxx, qxy, qyy):  # type: ignore[no-untyped-def]
    """`EffectCells.longest` of the cells' Q."""
    longest = 2.0
    for i in range(qxx.shape[0]):
        apart = qxx[i] - qyy[i]
        longest = max(longest, qxx[i] + qyy[i] + math.sqrt(apart * apart + 4.0 * qxy[i] * qxy[i]))
    return 0.5 * longest


@compiled(fastmath=_FAST)
def drag_sums(drag, rx, ry, cell_width):  # type: ignore[no-untyped-def]
    """`EffectCells.drag` of the cells' drags (n,), N s/m."""
    total = total_x = total_y = total_w = 0.0
    own = cell_width * cell_width / 6.0
    for i in range(drag.shape[0]):
        x, y, d = rx[i], ry[i], drag[i]
        total += d
        total_x += d * x
        total_y += d * y
        total_w += d * (x * x + y * y + own)
    return total, total_x, total_y, total_w


@compiled(fastmath={"contract"})
def load_gradients(cells, v, by_load):  # type: ignore[no-untyped-def]
    """Fill by_load (3, n): derivative of friction's gradient at the twist v per load f_i s_i of each cell."""
    vx, vy, omega = v
    spin = cells.rho2 * omega
    constant = spin * omega + cells.eps2
    rx, ry = cells.rx, cells.ry
    row_x, row_y, row_w = by_load[0], by_load[1], by_load[2]
    if cells.stretched:
        qxx, qxy, qyy = cells.qxx, cells.qxy, cells.qyy
        for i in range(row_x.shape[0]):
            ux = vx - omega * ry[i]
            uy = vy + omega * rx[i]
            px = qxx[i] * ux + qxy[i] * uy
            py = qxy[i] * ux + qyy[i] * uy
            inverse = 1.0 / math.sqrt(ux * px + uy * py + constant)
            row_x[i] = px * inverse
            row_y[i] = py * inverse
            row_w[i] = (rx[i] * py - ry[i] * px + spin) * inverse
    else:
        for i in range(row_x.shape[0]):
            ux = vx - omega * ry[i]
            uy = vy + omega * rx[i]
            inverse = 1.0 / math.sqrt(ux * ux + uy * uy + constant)
            row_x[i] = ux * inverse
            row_y[i] = uy * inverse
            row_w[i] = (rx[i] * uy - ry[i] * ux + spin) * inverse
    if cells.pyramids.shape[0] > 0:
        for a in range(3):
            for i in range(row_x.shape[0]):
                by_load[a, i] *= cells.cone
        spin = RIDGE_SPIN * cells.rho2 * omega
        constant = spin * omega + RIDGE * RIDGE * cells.eps2
        for k in range(2 * cells.pyramids.shape[0]):
            d, ex, ey = _ridge(cells.pyramids[k // 2], k)
            along = vx * ex + vy * ey
            for i in range(row_x.shape[0]):
                arm = rx[i] * ey - ry[i] * ex
                w = along + omega * arm
                a = d / math.sqrt(w * w + constant)
                row_x[i] += a * w * ex
                row_y[i] += a * w * ey
                row_w[i] += a * (w * arm + spin)


@compiled()
def pyramid_slopes(cells, dnumbers, v, h, G):  # type: ignore[no-untyped-def]
    """Add to G (3, Y) the derivative of the gradient through c and through d and e of each pyramid.

    `dnumbers` (1 + 3 k, Y) holds the derivatives of these; v is the twist after the step.
    """
    vx, vy, omega = v
    load, rx, ry = cells.load, cells.rx, cells.ry
    spin = RIDGE_SPIN * cells.rho2 * omega
    constant = spin * omega + RIDGE * RIDGE * cells.eps2
    (gx, gy, gw), _, _ = _stretched_sums(cells, v) if cells.stretched else coulomb_sums(cells, v)
    for j in range(G.shape[1]):
        change = h * dnumbers[0, j]
        G[0, j] += change * gx
        G[1, j] += change * gy
        G[2, j] += change * gw
    for k in range(2 * cells.pyramids.shape[0]):
        d, ex, ey = _ridge(cells.pyramids[k // 2], k)
        (ge, gspin), _, _ = _ridge_sums(cells, v, ex, ey)
        # Changes of both sums with the vector's x and y.
        ge_x = ge_y = gw_x = gw_y = 0.0
        for i in range(load.shape[0]):
            x, y = rx[i], ry[i]
            ux, uy = vx - omega * y, vy + omega * x
            arm = x * ey - y * ex
            w = ux * ex + uy * ey
            inverse = 1.0 / math.sqrt(w * w + constant)
            a = load[i] * inverse
            b = a * inverse * inverse
            steep = a - b * w * w
            ge_x += steep * ux
            ge_y += steep * uy
            gw_x += steep * ux * arm - a * w * y - b * w * ux * spin
            gw_y += steep * uy * arm + a * w * x - b * w * uy * spin
        row = 1 + 3 * (k // 2)
        for j in range(G.shape[1]):
            dd, dx, dy = dnumbers[row, j], dnumbers[row + 1, j], dnumbers[row + 2, j]
            if k % 2 == 1:
                dx, dy = -dy, dx
            along = dd * ge + d * (ge_x * dx + ge_y * dy)
            G[0, j] += h * (along * ex + d * ge * dx)
            G[1, j] += h * (along * ey + d * ge * dy)
            G[2, j] += h * (dd * gspin + d * (gw_x * dx + gw_y * dy))


@compiled(fastmath={"contract"})
def drag_gradients(cells, v, h, cell_width, by_drag):  # type: ignore[no-untyped-def]
    """Fill by_drag (3, n): h times the gradient's derivative with respect to the drag of each cell."""
    vx, vy, omega = v
    rx, ry = cells.rx, cells.ry
    turning = cell_width * cell_width / 6.0 * omega
    row_x, row_y, row_w = by_drag[0], by_drag[1], by_drag[2]
    for i in range(row_x.shape[0]):
        ux = vx - omega * ry[i]
        uy = vy + omega * rx[i]
        row_x[i] = h * ux
        row_y[i] = h * uy
        row_w[i] = h * (rx[i] * uy - ry[i] * ux + turning)


@compiled(fastmath=_FAST)
def stretch_gradients(cells, v, h, by_stretch):  # type: ignore[no-untyped-def]
    """Fill by_stretch (9, n): h times the derivatives in q_xx, q_xy, q_yy of each cell, three rows each."""
    vx, vy, omega = v
    qxx, qxy, qyy = cells.qxx, cells.qxy, cells.qyy
    spin = cells.rho2 * omega
    constant = spin * omega + cells.eps2
    for i in range(by_stretch.shape[1]):
        x, y = cells.rx[i], cells.ry[i]
        ux = vx - omega * y
        uy = vy + omega * x
        px = qxx[i] * ux + qxy[i] * uy
        py = qxy[i] * ux + qyy[i] * uy
        pw = x * py - y * px + spin
        phi2 = ux * px + uy * py + constant
        a = h * cells.cone * cells.load[i] / math.sqrt(phi2)
        b = a / phi2
        by_xx, by_xy, by_yy = 0.5 * b * ux * ux, b * ux * uy, 0.5 * b * uy * uy
        by_stretch[0, i] = a * ux - by_xx * px
        by_stretch[1, i] = -by_xx * py
        by_stretch[2, i] = -a * y * ux - by_xx * pw
        by_stretch[3, i] = a * uy - by_xy * px
        by_stretch[4, i] = a * ux - by_xy * py
        by_stretch[5, i] = a * (x * ux - y * uy) - by_xy * pw
        by_stretch[6, i] = -by_yy * px
        by_stretch[7, i] = a * uy - by_yy * py
        by_stretch[8, i] = a * x * uy - by_yy * pw


@compiled(fastmath={"contract"})
def weigh_cells(load, factor, h, by_load, by_factor):  # type: ignore[no-untyped-def]
    """Fill by_factor (3, n): the gradient's derivative per friction factor; 0 for factors cut at 0."""
    for a in range(3):
        row, slope = by_factor[a], by_load[a]
        for i in range(load.shape[0]):
            row[i] = h * load[i] * slope[i] if factor[i] > 0.0 else 0.0
