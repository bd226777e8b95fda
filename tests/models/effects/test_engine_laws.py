"""Friction laws that simulators use instead of Coulomb's, against explicit sums over the cells."""

from __future__ import annotations

import numpy as np
import pytest
from pushed_with_effects import EFFECTS, block, coast_of, slide

from slipmap.models.physics.cell_grid import FloatArray

MU, G, MASS, H = 0.3, 9.81, 0.5, 1e-3
GRID = block(6, 4)
YAW = 0.7
ARMS = np.linalg.norm(GRID.centers, axis=1)
MOMENT = MASS / len(GRID) * np.sum(ARMS**2 + GRID.width**2 / 6)


def acceleration(name: str, values: list[float], velocity: list[float], spin: float = 0.0) -> FloatArray:
    """(3,) mean acceleration over 20 steps of a block released with a velocity in the world."""
    c, s = np.cos(YAW), np.sin(YAW)
    x, y = velocity
    twist = [c * x + s * y, c * y - s * x, spin]
    push = coast_of(twist, 20 * H, H, start=(0.0, 0.0, YAW))
    effects = [EFFECTS[name]] if name else []
    end = slide(effects, values, push, grid=GRID, mass=MASS, mu=MU).end[0, 0]
    c, s = np.cos(end[2]), np.sin(end[2])
    after = np.array([c * end[3] - s * end[4], s * end[3] + c * end[4], end[5]])
    return (after - [x, y, spin]) / (20 * H)


@pytest.mark.parametrize("share", [0.4, 1.0])
@pytest.mark.parametrize(
    ("name", "degrees", "whole"),
    [
        # Friction over μ N of a whole pyramid; the object is turned, so that its own axes would show.
        ("friction_diamond", 20.0, (-1.0, 0.0)),
        ("friction_diamond", 135.0, (0.5, -0.5)),
        ("friction_diamond", 260.0, (0.0, 1.0)),
        ("friction_square", 20.0, (-1.0, -1.0)),
        ("friction_square", 225.0, (1.0, 1.0)),
        ("friction_square", 90.0, (0.0, -1.0)),
    ],
)
def test_a_pyramid_has_the_worlds_axes(
    name: str, degrees: float, whole: tuple[float, float], share: float
) -> None:
    way = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    found = acceleration(name, [share], (3.0 * way).tolist())
    wanted = MU * G * ((share - 1) * way + share * np.array(whole))
    assert found[:2] == pytest.approx(wanted, abs=2e-3 * MU * G)
    assert found[2] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("name", ["friction_diamond", "friction_square"])
def test_a_spin_meets_each_cells_friction_along_its_own_way(name: str) -> None:
    found = acceleration(name, [1.0], [0.0, 0.0], spin=4.0)[2]
    # Many points of each cell, halfway through the turn of these steps.
    x, y = (GRID.width * ((np.arange(20) + 0.5) / 20 - 0.5) for _ in range(2))
    points = (GRID.centers[:, None] + np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)).reshape(-1, 2)
    angle = np.arctan2(*points.T[::-1]) + YAW + 4.0 * 10 * H
    along, across = np.abs(np.sin(angle)), np.abs(np.cos(angle))
    norm = along + across if name == "friction_square" else np.maximum(along, across)
    torque = MU * G * MASS * np.mean(norm * np.linalg.norm(points, axis=1))
    assert -found == pytest.approx(torque / MOMENT, rel=0.01)


def test_a_pyramids_edge_holds_the_object_at_rest_and_stops_it() -> None:
    push = coast_of([0.2, 0.05, 0.0], 0.3, H)
    for name in ("friction_diamond", "friction_square"):
        out = slide([EFFECTS[name]], [1.0], push, grid=GRID, mass=MASS, mu=MU)
        assert np.abs(out.end[0, 0, 3:]).max() < 1e-9


@pytest.mark.parametrize("share", [-0.4, 0.3])
def test_load_follows_slip_and_keeps_its_sum(share: float) -> None:
    spun = acceleration("slip_load", [share], [0.0, 0.0], spin=4.0)[2]
    even = acceleration("", [], [0.0, 0.0], spin=4.0)[2]
    loads = 1 + share * (ARMS**2 / np.mean(ARMS**2) - 1)
    assert spun / even == pytest.approx(np.sum(loads * ARMS) / np.sum(ARMS), rel=5e-3)
    slid = acceleration("slip_load", [share], [1.0, 0.0])
    assert slid == pytest.approx([-MU * G, 0.0, 0.0], abs=1e-6)


def test_torsional_friction_is_a_torque_against_every_spin() -> None:
    radius = 4e-3
    for velocity in ([0.0, 0.0], [1.0, 0.3]):
        more = acceleration("torsional_friction", [radius], velocity, spin=3.0)
        less = acceleration("", [], velocity, spin=3.0)
        assert (less - more)[2] == pytest.approx(radius * MASS * G / MOMENT, rel=0.02)


@pytest.mark.parametrize(
    ("angle", "point", "radius", "twist", "h"),
    [
        (
            -1.1010026025984894,
            (-0.02865863663374821, -0.006886421116679323),
            0.005,
            (0.3603280605772534, 0.021721480021407058, -4.538016970430181),
            0.01,
        ),
        (
            1.8661042949703734,
            (-0.025216196609092207, 0.0015945797180705462),
            0.02,
            (0.13463005586694898, 0.3357543314873237, 6.808062966879245),
            0.02,
        ),
    ],
)
def test_a_blade_and_a_torque_that_hold_at_once_bring_it_to_rest(
    angle: float, point: tuple[float, float], radius: float, twist: tuple[float, float, float], h: float
) -> None:
    """Sharp bends of two laws beside that of rest take a hundred sums over the cells in a step."""
    effects = [EFFECTS["skate"], EFFECTS["torsional_friction"]]
    values = [1.0, angle, *point, radius]
    end = slide(effects, values, coast_of(twist, 100 * h, h), grid=block(6, 4, 0.01), mass=0.48, mu=MU).end[
        0, 0
    ]
    assert np.abs(end[3:]).max() < 1e-9
