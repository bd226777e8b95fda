"""A magnet under the table: an effect of one's own, in a dozen lines."""

import sympy as sp

from slipmap import Effect, Parameter


class Magnet(Effect):
    name = "magnet"
    sentence = "A magnet under the table pulls the object towards one place."
    parameters = (
        Parameter("strength", "N", "how strongly it pulls", -20.0, 20.0, 0.1, null=0.0, weight_power=1.0),
        Parameter("place_x", "m", "where the magnet is", -2.0, 2.0, 0.2),
        Parameter("place_y", "m", "where the magnet is", -2.0, 2.0, 0.2),
    )

    def force(self, body, p):
        dx, dy = p.place_x - body.x, p.place_y - body.y
        pull = p.strength * sp.exp(-(dx**2 + dy**2) / (2 * 0.1**2)) / 0.1
        return pull * dx, pull * dy, 0

    def starts(self, scene):
        (x, y), step = scene.center, 0.5 * scene.reach
        return [{"place_x": x + i * step, "place_y": y + j * step} for i in (-1, 0, 1) for j in (-1, 0, 1)]
