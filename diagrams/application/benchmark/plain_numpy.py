"""The convex step in plain numpy, written from its formula: a check of the compiled step, and of its speed.

For an object with a convex outline and one finger. Per step, in the frame at its predicted mid-point,

    v⁺ = argmin ½ (v - v*)ᵀ M (v - v*) + h Σ f_i sqrt(vᵀ K_i v + ε²) + ½ γ(v)ᵀ R γ(v)

where K_i = J_iᵀ J_i + diag(0, 0, ρ²) and J_i maps the twist to the velocity of cell i. It shares only the
definition of the model with the compiled kernel.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
import shapely
from scipy.optimize import brentq

from slipmap.models.geometry import turn
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import Maps, Push, Slider

_Derivatives = tuple[FloatArray, FloatArray]
_Function = Callable[[FloatArray], _Derivatives]

_TOLERANCE = 1e-9  # m/s, for the Newton step; convergence is quadratic
_MAX_ITERATIONS = 100


def rollout(slider: Slider, maps: Maps, push: Push) -> FloatArray:
    """(N + 1, 3) poses under the first of the maps, including the start.

    Raises:
        ValueError: the finger's centre enters the object.
        ArithmeticError: a step was not solved.
    """
    n, h = len(slider.grid), push.h
    mass, load = maps.mass[0], maps.mass[0] * maps.mu[0] * slider.gravity
    r, w = slider.grid.centers, slider.grid.width
    J = np.zeros((n, 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1.0
    J[:, 0, 2], J[:, 1, 2] = -r[:, 1], r[:, 0]
    M = np.einsum("i,ixa,ixb->ab", mass, J, J) + np.diag([0, 0, mass.sum() * w**2 / 6])
    K = np.einsum("ixa,ixb->iab", J, J) + np.diag([0, 0, w**2 / 12])
    smoothing, total = slider.smoothing, load.sum()
    # Springs 1/R along the normal and the tangent.
    springs = np.array([h * h * total / smoothing.penetration, h * total / smoothing.stick_speed])

    q, v = push.start_pose.copy(), push.start_twist.copy()
    poses = [q]
    for tip0, tip1 in zip(push.tip[:-1], push.tip[1:], strict=True):
        contact = _contact(slider, _moved(q, v, h / 2), tip0, tip1, v, h)
        free = _free_momentum(M, v, h)
        smooth = partial(_smooth_derivatives, M, free, K, h * load, smoothing.slip_speed)
        touch = partial(_contact_derivatives, *contact, springs, maps.mu_finger[0]) if contact else None
        v = _minimum(partial(_derivatives, smooth, touch), v)
        q = _moved(q, v, h)
        poses.append(q)
    return np.array(poses)


def _derivatives(smooth: _Function, touch: _Function | None, u: FloatArray) -> _Derivatives:
    """Gradient and Hessian of the whole function at the twist u."""
    gradient, hessian = smooth(u)
    if touch is None:
        return gradient, hessian
    slope, curvature = touch(u)
    return gradient + slope, hessian + curvature


def _smooth_derivatives(
    M: FloatArray, free: FloatArray, K: FloatArray, impulse: FloatArray, eps: float, u: FloatArray
) -> _Derivatives:
    """Gradient and Hessian of inertia, with momentum `free` of v*, and friction, with h f_i in `impulse`."""
    Ku = K @ u
    phi = np.sqrt(Ku @ u + eps**2)
    a = impulse / phi
    return M @ u - free + a @ Ku, M + np.tensordot(a, K, 1) - (Ku.T * (a / phi**2)) @ Ku


def _moved(q: FloatArray, v: FloatArray, duration: float) -> FloatArray:
    """Pose after a motion with constant twist in the object frame, the exponential of a planar screw."""
    angle = duration * v[2]
    straight = np.sinc(angle / (2 * np.pi))  # numpy's sinc has a π in it
    way = duration * straight * turn(q[2] + angle / 2) @ v[:2]
    return np.array([*(q[:2] + way), q[2] + angle])


def _free_momentum(M: FloatArray, v: FloatArray, h: float) -> FloatArray:
    """M v* without forces: in the rotated frame, the centre of mass keeps its velocity and the spin."""
    centre = np.array([M[1, 2], -M[0, 2]]) / M[0, 0]
    lever = np.array([-centre[1], centre[0]])
    velocity = turn(-h * v[2]) @ (v[:2] + v[2] * lever)
    return M @ np.array([*(velocity - v[2] * lever), v[2]])


def _contact(
    slider: Slider, q: FloatArray, tip0: FloatArray, tip1: FloatArray, v: FloatArray, h: float
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Contact rows C (2, 3), offsets b (2,) and factors (2,): C u - b times the factors are the speeds of the
    normal and the tangential spring.

    None where the finger is out of reach.
    """
    to_object = turn(-q[2])
    tip = to_object @ ((tip0 + tip1) / 2 - q[:2])
    finger = to_object @ ((tip1 - tip0) / h)
    ring = slider.grid.polygon.exterior
    point = np.array(ring.interpolate(ring.project(shapely.Point(tip))).coords[0])
    away = tip - point
    normal = away / np.linalg.norm(away)
    if slider.grid.polygon.contains(shapely.Point(tip)):
        raise ValueError("the finger's centre is inside the object")
    gap = np.linalg.norm(away) - slider.finger_radius
    if gap > 2e-3 + 4 * h * (np.linalg.norm(finger) + np.linalg.norm(v[:2])):
        return None
    tangent = np.array([-normal[1], normal[0]])
    lever = np.array([-point[1], point[0]])
    C = np.array([[*normal, normal @ lever], [*-tangent, -tangent @ lever]])
    # The gap is known at the middle of the step; finger and object have closed or opened it until then.
    gap += 0.5 * h * (C[0] @ v - normal @ finger)
    depth = max(-gap, 0.0)
    share = depth**2 / (depth**2 + (slider.smoothing.penetration / 2) ** 2)
    stiffening = 1.0 + share * slider.smoothing.relaxation / h
    b = np.array([normal @ finger + gap / (h * stiffening), -tangent @ finger])
    return C, b, np.array([stiffening, 1.0])


def _contact_derivatives(
    C: FloatArray, b: FloatArray, factors: FloatArray, springs: FloatArray, mu: float, u: FloatArray
) -> _Derivatives:
    """Gradient and Hessian of ½ γᵀ R γ, where γ is the projection of the springs' impulses y on the cone."""
    springs = factors * springs
    y_n, y_t = springs * (C @ u - b)
    ratio = springs[0] / springs[1]
    if abs(y_t) <= mu * y_n:
        projection = np.eye(2)
    elif y_n + mu * ratio * abs(y_t) <= 0:
        projection = np.zeros((2, 2))
    else:
        # Onto the cone's surface: along the ray (1, ±mu), in the metric R.
        ray = np.array([1.0, np.copysign(mu, y_t)])
        projection = np.outer(ray, ray / springs) / (ray @ (ray / springs))
    gamma = projection @ (y_n, y_t)
    return C.T @ gamma, C.T @ (projection * springs) @ C


def _minimum(function: _Function, v: FloatArray) -> FloatArray:
    """Minimum by Newton's method, with an exact line search wherever the full step overshoots.

    Raises:
        ArithmeticError: no convergence.
    """
    for _ in range(_MAX_ITERATIONS):
        gradient, hessian = function(v)
        d = np.asarray(np.linalg.solve(hessian, -gradient), dtype=np.float64)
        if np.abs(d).max() < _TOLERANCE:
            return v + d
        along = partial(_slope, function, v, d)
        overshoots = along(1.0) > -0.5 * gradient @ d
        v = v + d * (brentq(along, 0.0, 1.0, rtol=1e-3) if overshoots else 1.0)
    raise ArithmeticError("plain numpy: a step was not solved")


def _slope(function: _Function, v: FloatArray, d: FloatArray, t: float) -> float:
    """Derivative along d at v + t d."""
    return float(function(v + t * d)[0] @ d)
