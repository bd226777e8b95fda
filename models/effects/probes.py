"""Probes: dependences that residuals may show when no effect of the library explains them.

A probe is an effect without a name in physics: a flexible law of one argument. The diagnosis lets probes
compete so that an unknown effect shows up as `it depends on …` instead of being blamed on the nearest known
effect.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from slipmap.models.effects.effect import Effect, Parameter, Scene
from slipmap.models.effects.symbols import REST_SPEED, force_at_mass_center, sp


def _amplitudes(prefix: str, count: int, scale: float, unit: str = "1") -> tuple[Parameter, ...]:
    return tuple(
        Parameter(f"{prefix}{k}", unit, "coefficient", -100.0, 100.0, scale, 0.0) for k in range(count)
    )


def _combined(p: Any, prefix: str, terms: Sequence[Any]) -> Any:
    """Sum of the terms times the amplitudes with this prefix."""
    return sum(getattr(p, f"{prefix}{k}") * term for k, term in enumerate(terms))


def _factor(exponent: Any) -> Any:
    """exp of an exponent, kept between e⁻³ and e³."""
    return sp.exp(3 * sp.tanh(exponent / 3))


class ForceByPlace(Effect):
    name = "force_by_place"
    belongs_to = "table"
    sentence = "A force on the object that depends on its position on the table."
    parameters = (*_amplitudes("x", 6, 0.03), *_amplitudes("y", 6, 0.03))

    def force(self, body: Any, p: Any) -> Any:
        u, v = body.x / 0.2, body.y / 0.2
        terms = (1, u, v, u * u, u * v, v * v)
        fx, fy = body.weight * _combined(p, "x", terms), body.weight * _combined(p, "y", terms)
        return force_at_mass_center(body, fx, fy)


class FrictionByPlace(Effect):
    name = "friction_by_place"
    belongs_to = "table"
    sentence = "Friction that depends on the position on the table."
    parameters = _amplitudes("a", 9, 0.2)

    def friction(self, cell: Any, p: Any) -> Any:
        u, v = cell.x / 0.3, cell.y / 0.3
        terms = (u, v, u * u, u * v, v * v, u**3, u * u * v, u * v * v, v**3)
        return _factor(_combined(p, "a", terms))


class FrictionBySpeed(Effect):
    name = "friction_by_speed"
    belongs_to = "table"
    sentence = "Friction that depends on speed."
    parameters = _amplitudes("a", 4, 0.2)

    def friction(self, cell: Any, p: Any) -> Any:
        u = sp.log(1 + cell.speed / 0.01)
        return _factor(_combined(p, "a", [(u / 2) ** k for k in range(1, 5)]))


class FrictionByDirection(Effect):
    name = "friction_by_direction"
    belongs_to = "table"
    sentence = "Friction that depends on the direction of motion."
    parameters = (*_amplitudes("t", 4, 0.1), *_amplitudes("o", 4, 0.1))

    def friction(self, cell: Any, p: Any) -> Any:
        cx, cy = cell.ux / cell.speed, cell.uy / cell.speed
        ox, oy = cell.along_x / cell.speed, cell.along_y / cell.speed
        on_table = _combined(p, "t", (cx, cy, cx * cx - cy * cy, 2 * cx * cy))
        return _factor(on_table + _combined(p, "o", (ox, oy, ox * ox - oy * oy, 2 * ox * oy)))


class FrictionByTime(Effect):
    name = "friction_by_time"
    belongs_to = "table"
    sentence = "Friction that depends on the time since the push began."
    parameters = _amplitudes("a", 3, 0.2)

    def friction(self, cell: Any, p: Any) -> Any:
        t = cell.time / 2
        return _factor(_combined(p, "a", [t**k for k in range(1, 4)]))


class FrictionByOrder(Effect):
    name = "friction_by_order"
    sentence = "Friction that changes from push to push."
    parameters = _amplitudes("a", 4, 0.2)

    def friction(self, cell: Any, p: Any) -> Any:
        k = cell.order / 20
        return _factor(_combined(p, "a", [k**i for i in range(1, 5)]))


class ForceByTime(Effect):
    name = "force_by_time"
    belongs_to = "table"
    sentence = "A force on the object that comes and goes with time."
    parameters = (
        *_amplitudes("x", 2, 0.03),
        *_amplitudes("y", 2, 0.03),
        Parameter("rate", "rad/s", "angular frequency", 0.2, 100.0, 2.0, start=3.0),
    )

    def force(self, body: Any, p: Any) -> Any:
        c, s = sp.cos(p.rate * body.time), sp.sin(p.rate * body.time)
        fx, fy = body.weight * (p.x0 * c + p.x1 * s), body.weight * (p.y0 * c + p.y1 * s)
        return force_at_mass_center(body, fx, fy)

    def starts(self, scene: Scene) -> list[dict[str, float]]:
        return [{"rate": rate} for rate in (1.5, 3.0, 5.0, 8.0, 12.0, 20.0)]


class ForceOnObject(Effect):
    name = "force_on_object"
    sentence = "A force or torque that turns with the object."
    parameters = (*_amplitudes("f", 2, 0.03), *_amplitudes("t", 2, 0.002, "m"))

    def force(self, body: Any, p: Any) -> Any:
        fx = body.weight * (body.cos * p.f0 - body.sin * p.f1)
        fy = body.weight * (body.sin * p.f0 + body.cos * p.f1)
        # t1 resists or helps rotation in either direction.
        spin = body.omega / sp.sqrt(body.omega**2 + np.pi**2 * 100 * REST_SPEED**2)
        return fx, fy, body.com_x * fy - body.com_y * fx + body.weight * (p.t0 - p.t1 * spin)


class ForceBySpeed(Effect):
    name = "force_by_speed"
    belongs_to = "table"
    sentence = "A force along or across the object's velocity that depends on its speed or rotation."
    parameters = _amplitudes("a", 4, 0.05)

    def force(self, body: Any, p: Any) -> Any:
        speed = sp.sqrt(body.com_vx**2 + body.com_vy**2 + REST_SPEED**2)
        ux, uy = body.com_vx / speed, body.com_vy / speed
        along = -p.a0 * speed / 0.1 - p.a1 * (speed / 0.1) ** 2
        across = p.a2 * speed / 0.1 + p.a3 * body.omega
        fx = body.weight * (along * ux - across * uy)
        fy = body.weight * (along * uy + across * ux)
        return force_at_mass_center(body, fx, fy)


PROBES: tuple[Effect, ...] = (
    ForceByPlace(),
    FrictionByPlace(),
    FrictionBySpeed(),
    FrictionByDirection(),
    FrictionByTime(),
    FrictionByOrder(),
    ForceByTime(),
    ForceOnObject(),
    ForceBySpeed(),
)
