"""Contact of a round finger with the object's outline: where they touch, and with what force.

The contact is compliant and has a Coulomb cone. Its impulse is the impulse of springs, projected onto the
cone in the metric of the regularisation (Castro et al., "An unconstrained convex formulation of compliant
contact", 2022, the model behind Drake's SAP):

    y_n = -(gap⁺ + τ (gap⁺ - gap) / h) / (h R),   1/R_n = (1 + τ/h) / R,   y_t = v_t / R_t,
    γ = argmin over |γ_t| <= mu γ_n of |γ - y|² in the metric (R_n, R_t),

with the gap at the start and at the end of the step and the tangential speed v_t of the finger's surface
relative to the object. A finger of radius R that turns at omega_f moves its surface there by -R omega_f.

The impulse is the gradient of a convex function of the object's twist, so the step stays convex. Both
regularisations scale with the object's total friction load F, so the motion does not depend on the units of
mass: a finger that pushes with F penetrates by `penetration`, and creeps at `stick_speed` under an impulse
h F.

The damping grows with the depth x at the start of the step, as in the law of Hunt and Crossley (1975), but
levels off: τ = relaxation · x² / (x² + (penetration / 2)²). So a blow ends in pushing at any step length, and
no force acts before touch.

A finger of compliance C is a spring in series with the contact, and damped: its tip is C l off its recorded
place, and the lean l (world, N) follows the force F on the object,

    l⁺ = l + h/τ_f (F⁺ - l),   so   C F = b + τ_f db/dt   for the bend b = C l,

with τ_f = `FINGER_SETTLING`, or h if that is longer. The spring takes l and the damper the new force: the
implicit step itself damps like τ_f = h, so with l⁺ in the spring the bend's damping would depend on the step.

A limit of this contact: a finger that slips at v acts from a distance of mu h v, an artefact of the convex
model that shrinks with the step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from slipmap.models.physics.compiled import compiled

MAX_CONTACTS = 2
"""Most contacts of a round finger: in a concave corner it touches two edges."""

SEPARATE, STICK, SLIDE_FORWARD, SLIDE_BACK = 0, 1, 2, 3
"""State of one contact in one step; the finger slides forward along the tangent (-n_y, n_x), or back."""

CONTACT_COLUMNS = 7
"""Length of a contact's row: normal n_x, n_y; point r_x, r_y; gap; `turn` (1/m) and `slide` (-), by which a
unit tangential move of the tip turns the normal and shifts the point."""


class Cone(NamedTuple):
    """The law of all contacts of a push."""

    mu: float  # friction with the finger
    give: float  # penetration per force, m/N
    compliance: float  # of the finger within a step, C h/τ_f, in series with `give`, m/N
    tangential: float  # 1/R_t, kg
    damping: float  # largest τ/h, by which damping stiffens a contact within a step
    ramp: float  # penetration at which half of that acts, m


class Contact(NamedTuple):
    """One contact in one step, in the step's middle frame.

    With twist v the object moves at the contact with n_x v_x + n_y v_y + n_w omega along the normal and
    -n_y v_x + n_x v_y + t_w omega along the tangent.
    """

    # nx, ny: normal, out of the object
    nx: float
    ny: float
    # x, y: point of contact, m
    x: float
    y: float
    # nw, tw: n_w and t_w, m
    nw: float
    tw: float
    closing: float  # normal speed at which the step would end exactly in touch, m/s
    drag: float  # tangential speed of the finger's surface, m/s
    # turn, slide: see `CONTACT_COLUMNS`
    turn: float
    slide: float
    gap: float  # at the start of the step, as seen from its middle, m
    stiffening: float  # 1 + τ/h
    normal: float  # 1/R_n, kg
    ratio: float  # R_t / R_n


@compiled(forceinline=True)
def find_contacts(px, py, radius, margin, edges, out):  # type: ignore[no-untyped-def]
    """Find where a disc may touch the outline.

    Candidates are each face that the disc's centre faces and each convex corner in whose wedge it lies; the
    nearest `MAX_CONTACTS` within `margin` are kept. A centre inside the object gets only the nearest point of
    the outline.

    Args:
        px, py: centre of the disc in the object frame, m.
        radius: of the disc, m.
        margin: largest gap of interest, m.
        edges: (E, 4) outline edges, the object to the left.
        out: (MAX_CONTACTS, CONTACT_COLUMNS) result, see `CONTACT_COLUMNS`; normals point out of the object.

    Returns:
        Number of rows filled.
    """
    count = 0
    inside = False
    nearest = math.inf
    nearest_edge = -1
    reach = radius + margin
    for e in range(edges.shape[0]):
        ax = edges[e, 0]
        ay = edges[e, 1]
        ex = edges[e, 2] - ax
        ey = edges[e, 3] - ay
        dx = px - ax
        dy = py - ay
        length2 = ex * ex + ey * ey
        along = (dx * ex + dy * ey) / length2
        clamped = min(max(along, 0.0), 1.0)
        nx = dx - clamped * ex
        ny = dy - clamped * ey
        distance2 = nx * nx + ny * ny
        if distance2 < nearest:
            nearest = distance2
            nearest_edge = e
        # A ray along +x crosses an odd number of edges if it starts inside. Both edges at a corner must find
        # it on the same side of the ray, so coordinates are compared, not differences that were rounded.
        if (py < ay) != (py < edges[e, 3]) and dx < dy * ex / ey:
            inside = not inside
        if distance2 > reach * reach:
            continue
        side = dx * ey - dy * ex
        if 0.0 <= along <= 1.0 and side > 0.0:
            inverse = 1.0 / math.sqrt(length2)
            gap = side * inverse - radius
            x, y = ax + along * ex, ay + along * ey
            count = _keep_nearest(out, count, (ey * inverse, -ex * inverse, x, y, gap, 0.0, 1.0))
        elif along > 1.0:
            following = _following_edge(edges, e)
            fx = edges[following, 2] - edges[following, 0]
            fy = edges[following, 3] - edges[following, 1]
            cx = px - edges[e, 2]
            cy = py - edges[e, 3]
            # Straight corners count as convex: rounding may place the centre beside both of their edges.
            bend = ex * fy - ey * fx
            if cx * fx + cy * fy < 0.0 and bend > -1e-9 * math.sqrt(length2 * (fx * fx + fy * fy)):
                distance = math.sqrt(distance2)
                if distance > 0.0:
                    x, y, gap = edges[e, 2], edges[e, 3], distance - radius
                    corner = (cx / distance, cy / distance, x, y, gap, 1.0 / distance, 0.0)
                    count = _keep_nearest(out, count, corner)
    if inside and nearest > 0.0:
        e = nearest_edge
        ax = edges[e, 0]
        ay = edges[e, 1]
        ex = edges[e, 2] - ax
        ey = edges[e, 3] - ay
        length = math.sqrt(ex * ex + ey * ey)
        along = ((px - ax) * ex + (py - ay) * ey) / (length * length)
        depth = math.sqrt(nearest)
        if 0.0 <= along <= 1.0:
            x, y = ax + along * ex, ay + along * ey
            _fill(out, 0, (ey / length, -ex / length, x, y, -depth - radius, 0.0, 1.0))
        else:
            x, y = (ax, ay) if along < 0.0 else (edges[e, 2], edges[e, 3])
            nx, ny, gap = (x - px) / depth, (y - py) / depth, -depth - radius
            _fill(out, 0, (nx, ny, x, y, gap, -1.0 / depth, 0.0))
        count = 1
    return count


@compiled(forceinline=True)
def _following_edge(edges, e):  # type: ignore[no-untyped-def]
    """Edge that starts where edge `e` ends; rings are stored one after the other."""
    after = e + 1
    if after < edges.shape[0] and edges[after, 0] == edges[e, 2] and edges[after, 1] == edges[e, 3]:
        return after
    for first in range(edges.shape[0]):
        if edges[first, 0] == edges[e, 2] and edges[first, 1] == edges[e, 3]:
            return first
    return e


@compiled(forceinline=True)
def _fill(out, row, contact):  # type: ignore[no-untyped-def]
    out[row, 0], out[row, 1], out[row, 2], out[row, 3], out[row, 4], out[row, 5], out[row, 6] = contact


@compiled(forceinline=True)
def _keep_nearest(out, count, contact):  # type: ignore[no-untyped-def]
    """Insert a candidate so that rows stay sorted by gap; drop it if its normal and gap are there already."""
    nx, ny, _, _, gap, _, _ = contact
    for row in range(count):
        same = out[row, 0] * nx + out[row, 1] * ny > 1.0 - 1e-9
        if same and abs(out[row, 4] - gap) < 1e-9:
            return count
    place = count
    while place > 0 and out[place - 1, 4] > gap:
        place -= 1
    if place >= MAX_CONTACTS:
        return count
    last = min(count, MAX_CONTACTS - 1)
    for row in range(last, place, -1):
        for column in range(CONTACT_COLUMNS):
            out[row, column] = out[row - 1, column]
    _fill(out, place, contact)
    return min(count + 1, MAX_CONTACTS)


@compiled(forceinline=True)
def cone_of(mu, smoothing, load_sum, compliance, h):  # type: ignore[no-untyped-def]
    """`Cone` for steps of length h; smoothing (4,) as in `Common`, load_sum (N) over all cells."""
    tangential = h * h / (h * smoothing[1] / load_sum + compliance)
    give, ramp = smoothing[2] / load_sum, 0.5 * smoothing[2]
    return Cone(mu, give, compliance, tangential, smoothing[3] / h, ramp)


@compiled(forceinline=True)
def stiffening_of(gap, cone):  # type: ignore[no-untyped-def]
    """1 + τ/h of a contact with this gap at the start of the step."""
    if gap >= 0.0:
        return 1.0
    return 1.0 + cone.damping * gap * gap / (cone.ramp * cone.ramp + gap * gap)


@compiled(forceinline=True)
def stiffening_slope(gap, cone):  # type: ignore[no-untyped-def]
    """Derivative of `stiffening_of` with respect to the gap, 1/m."""
    if gap >= 0.0:
        return 0.0
    square = cone.ramp * cone.ramp
    return 2.0 * cone.damping * gap * square / ((square + gap * gap) * (square + gap * gap))


@compiled(forceinline=True)
def cone_state(y_n, y_t, mu, ratio):  # type: ignore[no-untyped-def]
    """State of a contact whose springs would give the impulse (y_n, y_t); `ratio` is R_t / R_n."""
    size = abs(y_t)
    if y_n > 0.0 and size <= mu * y_n:
        return STICK
    if y_n + mu * ratio * size <= 0.0:
        return SEPARATE
    return SLIDE_FORWARD if y_t > 0.0 else SLIDE_BACK


@compiled(forceinline=True)
def cone_matrix(mu, ratio, state):  # type: ignore[no-untyped-def]
    """Projection onto the cone in one state: γ = D y, returned as D_nn, D_nt, D_tn, D_tt.

    It is linear in each state, so D is also the derivative; on the border of two states, a one-sided one.
    """
    if state == STICK:
        return 1.0, 0.0, 0.0, 1.0
    if state == SEPARATE:
        return 0.0, 0.0, 0.0, 0.0
    slope = mu if state == SLIDE_FORWARD else -mu
    share = 1.0 / (1.0 + mu * mu * ratio)
    return share, slope * ratio * share, slope * share, mu * mu * ratio * share


@compiled(forceinline=True)
def springs(contact, cone, vx, vy, omega):  # type: ignore[no-untyped-def]
    """Impulses y_n and y_t, N s, of a contact's springs if the object moves with twist (v_x, v_y, omega)."""
    along_normal = contact.nx * vx + contact.ny * vy + contact.nw * omega
    along_tangent = contact.nx * vy - contact.ny * vx + contact.tw * omega
    return (along_normal - contact.closing) * contact.normal, (contact.drag - along_tangent) * cone.tangential
