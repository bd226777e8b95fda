"""Partial derivatives of a step's gradient by what effects add to it: blades, and a finger that bends."""

from __future__ import annotations

import math

from models.physics.compiled import compiled
from models.physics.contact import SEPARATE, SLIDE_FORWARD, STICK, springs
from models.physics.step_derivative import add_column


@compiled()
def blade_slopes(blades, dblades, v, eps2, h, G):  # type: ignore[no-untyped-def]
    """Add to G (3, Y) the derivative of Σ_k h F w/φ b, with w = b·v and φ = sqrt(w² + ε²).

    Args:
        blades: (k, 4) F, b.
        dblades: (4 k, Y) their derivatives.
        v: twist after the step.
        eps2: ε².
        h: step, s.
        G: (3, Y).
    """
    for k in range(blades.shape[0]):
        force = blades[k, 0]
        along = blades[k, 1] * v[0] + blades[k, 2] * v[1] + blades[k, 3] * v[2]
        inverse = 1.0 / math.sqrt(along * along + eps2)
        ratio = along * inverse
        curve = force * eps2 * inverse * inverse * inverse
        for j in range(G.shape[1]):
            dx, dy, dw = dblades[4 * k + 1, j], dblades[4 * k + 2, j], dblades[4 * k + 3, j]
            common = dblades[4 * k, j] * ratio + curve * (v[0] * dx + v[1] * dy + v[2] * dw)
            G[0, j] += h * (common * blades[k, 1] + force * ratio * dx)
            G[1, j] += h * (common * blades[k, 2] + force * ratio * dy)
            G[2, j] += h * (common * blades[k, 3] + force * ratio * dw)


@compiled(forceinline=True)
def _by_stiffness(contact, impulse, cone, v, dnormal, dtangential):  # type: ignore[no-untyped-def]
    """Change of γ_n and γ_t if 1/R_n and 1/R_t change by dnormal and dtangential."""
    if impulse.state == SEPARATE:
        return 0.0, 0.0
    y_n, y_t = springs(contact, cone, v[0], v[1], v[2])
    dy_n = y_n * dnormal / contact.normal
    dy_t = y_t * dtangential / cone.tangential
    if impulse.state == STICK:
        return dy_n, dy_t
    slope = cone.mu if impulse.state == SLIDE_FORWARD else -cone.mu
    dratio = contact.ratio * (dnormal / contact.normal - dtangential / cone.tangential)
    share = 1.0 / (1.0 + cone.mu * cone.mu * contact.ratio)
    dgn = share * (
        dy_n + slope * (dratio * y_t + contact.ratio * dy_t) - cone.mu * cone.mu * dratio * impulse.normal
    )
    return dgn, slope * dgn


@compiled()
def add_contact_scale(  # type: ignore[no-untyped-def]
    first, second, impulse1, impulse2, cone, v, h, stick_speed, load_sum, scale_g, scale_f
):  # fmt: skip
    """Derivatives of the contact's part by the sum of loads and by the finger's compliance, at fixed v⁺.

    With 1/R_n = h²/(give/s + C), s the contact's stiffening by damping, and 1/R_t = h²/(h creep + C), where
    give and creep = stick_speed / Σ f fall with the sum of loads.

    Args:
        first: nearest contact.
        second: next contact.
        impulse1: solved `Impulse` of the first.
        impulse2: the same of the second.
        cone: law of the contacts.
        v: twist after the step.
        h: step, s.
        stick_speed: see `Smoothing`, m/s.
        load_sum: Σ f, N.
        scale_g: (3, 2) result, gradient by Σ f and by C.
        scale_f: (2, 2) result, impulse on the object (middle frame) by the same.
    """
    scale_g[:, :] = 0.0
    scale_f[:, :] = 0.0
    by_creep = -cone.tangential * cone.tangential / (h * h)
    creep = stick_speed / load_sum
    for k in range(2):
        contact = first if k == 0 else second
        impulse = impulse1 if k == 0 else impulse2
        by_give = -contact.normal * contact.normal / (h * h)
        give = cone.give / contact.stiffening
        for column in range(2):
            if column == 0:
                dn, dt = -by_give * give / load_sum, -by_creep * h * creep / load_sum
            else:
                dn, dt = by_give, by_creep
            dgn, dgt = _by_stiffness(contact, impulse, cone, v, dn, dt)
            scale_g[0, column] += contact.nx * dgn + contact.ny * dgt
            scale_g[1, column] += contact.ny * dgn - contact.nx * dgt
            scale_g[2, column] += contact.nw * dgn - contact.tw * dgt
            scale_f[0, column] -= contact.nx * dgn + contact.ny * dgt
            scale_f[1, column] += contact.nx * dgt - contact.ny * dgn


@compiled()
def add_spring_columns(  # type: ignore[no-untyped-def]
    v, new, h, cone, frame, first, second, impulse1, impulse2, last, compliance, A, dforce
):  # fmt: skip
    """Derivatives by the last force (world, two columns) and by the compliance that bent the finger with it.

    The bent finger stands compliance · force off its record and would straighten within the step.

    Args:
        v: twist before the step.
        new: twist after it.
        h: step, s.
        cone: law of the contacts.
        frame: middle frame, with the finger as bent.
        first: nearest contact.
        second: next contact.
        impulse1: solved `Impulse` of the first.
        impulse2: the same of the second.
        last: last force on the object, world, N.
        compliance: C, m/N.
        A: (3, 3) result, gradient.
        dforce: (2, 3) result, impulse in the middle frame.
    """
    A[:, :] = 0.0
    dforce[:, :] = 0.0
    for k in range(2):
        contact = first if k == 0 else second
        impulse = impulse1 if k == 0 else impulse2
        if impulse.state == SEPARATE:
            continue
        common = (v, new, h, cone, frame, contact, impulse, A, dforce)
        for j in range(3):
            fx = compliance if j == 0 else (last[0] if j == 2 else 0.0)
            fy = compliance if j == 1 else (last[1] if j == 2 else 0.0)
            dx = frame.cos * fx + frame.sin * fy
            dy = frame.cos * fy - frame.sin * fx
            add_column(j, -dx, -dy, 0.0, 0.0, dx / h, dy / h, 0.0, 0.0, common)
