"""For any object, maps and push, the model finds a solution, and the solution is possible."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings, strategies as st
from sliding_objects import (
    GRAVITY,
    finger_push,
    gaps_along,
    kinetic_energy,
    random_maps,
    rotation,
    star,
    twists_between,
    with_start,
)

from slipmap.models.objects.footprints import cells_from_polygon
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.rollout import Maps, Push, Slider, Smoothing


@dataclass(frozen=True)
class Scene:
    grid: CellGrid
    maps: Maps
    push: Push
    finger_radius: float

    @property
    def slider(self) -> Slider:
        return Slider(self.grid, self.finger_radius)


@st.composite
def grids(draw: st.DrawFn) -> CellGrid:
    """Stars with 3 to 9 corners, convex or not, somewhere around the object frame's origin."""
    _, outline = star(draw, 9, 0.025)
    return cells_from_polygon(outline, count=draw(st.integers(1, 60)))


@st.composite
def maps_of(draw: st.DrawFn, n: int) -> Maps:
    """Some cells without mass, some without friction, total mass from grams to a hundred kilograms."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scale = 10 ** draw(st.floats(-3, 2)) / n
    mass = scale * (rng.uniform(0, 1, n) * (rng.random(n) < 0.8) + 1e-3)
    mu = rng.uniform(0.05, 1, n) * (rng.random(n) < draw(st.sampled_from([0.5, 1.0])))
    mu[rng.integers(n)] = 0.4
    return Maps(mass, mu, np.array([draw(st.floats(0.01, 1.0))]))


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    """A finger that comes straight at some cell, then wanders; the object rests or moves."""
    grid = draw(grids())
    maps = draw(maps_of(len(grid)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    radius = draw(st.floats(0.002, 0.02))
    h = 10 ** draw(st.floats(-3, -1.7))
    speed = 10 ** draw(st.floats(-2.5, -0.5))
    steps = draw(st.integers(20, 120))
    heading = rng.uniform(0, 2 * np.pi)
    target = grid.centers[rng.integers(len(grid))]
    back = np.linspace(0.3, 0, 600)[:, None] * -rotation(heading)[:, 0]
    free = shapely.distance(grid.polygon, shapely.points(target + back)) > radius
    assume(free[0])
    start = (target + back)[np.argmin(free) - 1]
    curve = heading + np.linspace(0, rng.normal(0, 1), steps) + np.cumsum(rng.normal(0, 0.03, steps))
    moves = h * speed * np.column_stack([np.cos(curve), np.sin(curve)])
    pose = np.array([*rng.normal(0, 1, 2), rng.uniform(-np.pi, np.pi)])
    tip = pose[:2] + (start + np.vstack([np.zeros(2), np.cumsum(moves, axis=0)])) @ rotation(pose[2]).T
    twist = rng.normal(0, 1, 3) * [0.2, 0.2, 2.0] * draw(st.sampled_from([0.0, 1.0]))
    return Scene(grid, maps, finger_push(tip, h, start_pose=pose, start_twist=twist), radius)


thoroughly = settings(max_examples=60, deadline=None, derandomize=True, database=None)


@thoroughly
@given(scenes())
def test_every_step_is_solved_in_few_evaluations(scene: Scene) -> None:
    out = scene.slider.rollout(scene.maps, [scene.push], sensitivities=True)
    for values in (out.poses, out.forces, out.end, out.d_poses, out.d_forces):
        assert np.isfinite(values).all()
    assert out.evaluations[0, 0] <= 7 * (len(scene.push.tip) - 1)


@thoroughly
@given(scenes())
def test_energy_comes_from_the_finger_alone(scene: Scene) -> None:
    out = scene.slider.rollout(scene.maps, [scene.push])
    push = scene.push
    poses = with_start(out.poses[0], push)
    twists = np.vstack([push.start_twist, twists_between(poses, push.h)])
    kinetic = kinetic_energy(scene.grid, scene.maps.mass[0], twists)
    work = np.concatenate([[0], np.cumsum(np.sum(out.forces[0] * np.diff(push.tip, axis=0), axis=1))])
    # Friction and contact add none; the scale for rounding is what the finger's speed stands for.
    speed = np.abs(np.diff(push.tip, axis=0)).max() / push.h
    scale = kinetic.max() + scene.maps.mass.sum() * speed**2
    assert np.all(kinetic - kinetic[0] <= work + 1e-6 * scale)


@thoroughly
@given(scenes())
def test_the_finger_stays_out_of_the_object(scene: Scene) -> None:
    out = scene.slider.rollout(scene.maps, [scene.push])
    push = scene.push
    gaps = gaps_along(scene.grid, out.poses[0], push.tip[1:], scene.finger_radius)
    # Compression of a spring of stiffness load / penetration that stops the whole mass.
    twists = np.vstack([push.start_twist, twists_between(with_start(out.poses[0], push), push.h)])
    reach = np.abs(scene.grid.exterior).max()
    speeds = np.hypot(twists[:, 0], twists[:, 1]) + reach * np.abs(twists[:, 2])
    speed = speeds.max() + np.linalg.norm(np.diff(push.tip, axis=0), axis=1).max() / push.h
    load = float((scene.maps.mass * scene.maps.mu).sum()) * GRAVITY
    mass = float(scene.maps.mass.sum())
    impact = speed * np.sqrt(mass * Smoothing().penetration / load)
    assert gaps.min() > -0.7 * impact - 3 * Smoothing().penetration


@thoroughly
@given(scenes(), st.floats(1e-3, 1e3))
def test_the_unit_of_mass_does_not_matter(scene: Scene, factor: float) -> None:
    scaled = replace(scene, maps=Maps(scene.maps.mass * factor, scene.maps.mu, scene.maps.mu_finger))
    out, other = (s.slider.rollout(s.maps, [s.push]) for s in (scene, scaled))
    assert other.poses == pytest.approx(out.poses, abs=1e-9)
    scale = np.abs(out.forces).max() + 1e-12
    assert other.forces / factor == pytest.approx(out.forces, abs=1e-8 * scale)


@thoroughly
@given(grids(), st.integers(0, 2**32 - 1))
def test_an_untouched_object_at_rest_stays(grid: CellGrid, seed: int) -> None:
    rng = np.random.default_rng(seed)
    maps = random_maps(rng, len(grid))
    reach = np.linalg.norm(grid.exterior, axis=1).max() + 0.02
    around = np.linspace(0, 2 * np.pi, 50)
    tip = reach * np.column_stack([np.cos(around), np.sin(around)])
    out = Slider(grid, 0.01).rollout(maps, [finger_push(tip, 0.01)])
    assert np.all(out.poses == 0)
    assert np.all(out.forces == 0)
