"""Loads when part of the object lies beyond the table's rim, and their effect on motion and derivatives."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings, strategies as st

from slipmap.models.effects import LIBRARY
from slipmap.models.geometry import compose, placed, relative
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.physics.balance import balance_margins
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.rollout import Maps, Push, Rollouts, Slider
from slipmap.models.physics.stepper import Stepper
from tests.models.effects.pushed_with_effects import BLOCK, EFFECTS, RADIUS, SHOWN, plain_maps, with_values
from tests.models.physics.sliding_objects import (
    GRAVITY,
    FloatArray,
    finger_push,
    l_shape,
    line,
    rectangle,
    star,
)

N = len(BLOCK)
TURN = 0.3
ROUND = Table("round", (-0.449, 0.02), radius=0.5)
SQUARE = Table("rectangle", (-0.45, 0.015), size=(1.0, 0.13))
TABLES = {"round": ROUND, "rectangle": SQUARE}
"""The block of `push_over` ends over the rim of each, and stays there."""


def push_over(duration: float = 0.5) -> Push:
    """The finger touches once, slides, and pushes the block over the rims of `TABLES` at 5 cm/s."""
    start = np.array([0.015, 0.01, TURN])
    begin = placed(np.array([-0.05 - RADIUS - 2e-4, 0.008]), start)
    velocity = 0.05 * np.array([np.cos(TURN + 0.6), np.sin(TURN + 0.6)])
    return finger_push(line(begin, velocity, duration, 0.005), 0.005, start_pose=start)


def bar(places: list[float], width: float = 0.02) -> CellGrid:
    """Cells along x."""
    half = np.array([max(np.abs(places)) + width / 2, width / 2])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    return CellGrid(np.column_stack([places, np.zeros(len(places))]), width, corners)


def loads(grid: CellGrid, mass: FloatArray, pose: FloatArray, table: Table) -> FloatArray:
    """(n,) loads of one object at one pose, N."""
    maps = Maps(mass, np.full(len(grid), 0.3), np.array([0.3]))
    return Slider(grid, RADIUS, table=table).loads(maps, np.asarray(pose, dtype=float))[0, 0]


def share(distance: FloatArray, width: float) -> FloatArray:
    """Share of a cell whose centre lies at this distance inside the rim."""
    t = np.clip(0.5 + distance / (np.sqrt(5 / 3) * width), 0.0, 1.0)
    return t**2 * (3 - 2 * t)


def test_a_beam_on_two_supports() -> None:
    """Two cells carry a third that hangs over; the balance of moments gives the load of each."""
    grid, mass = bar([-0.1, 0.0, 0.06]), np.array([0.3, 0.2, 0.25])
    for table in (Table("rectangle", (-0.47, 0.0), size=(1.0, 1.0)), Table("round", (-4.97, 0), radius=5.0)):
        found = loads(grid, mass, np.zeros(3), table)
        right = GRAVITY * (0.2 + 0.25 + 0.25 * 0.06 / 0.1)
        assert found == pytest.approx([GRAVITY * 0.75 - right, right, 0.0], abs=1e-5)


def test_what_hangs_over_lifts_the_far_end() -> None:
    """With a heavy overhang the cell at the far end would have to pull, and lifts off; the others hold."""
    grid, mass = bar([-0.1, -0.06, 0.0, 0.05]), np.array([0.1, 0.3, 0.2, 0.35])
    found = loads(grid, mass, np.zeros(3), Table("rectangle", (-0.48, 0.0), size=(1.0, 1.0)))
    center = mass @ grid.centers[:, 0] / mass.sum()
    assert center < 0.0
    held = GRAVITY * mass.sum() * center / -0.06
    assert found == pytest.approx([0.0, held, GRAVITY * mass.sum() - held, 0.0], abs=3e-5)


@st.composite
def lying(draw: st.DrawFn) -> tuple[CellGrid, FloatArray, FloatArray, Table]:
    """An object, its masses in ratios up to a thousand to one, a pose, and a table whose rim is near."""
    grid = draw(st.sampled_from([rectangle(8, 5, 0.02), l_shape(0.02), rectangle(12, 1, 0.02), BLOCK]))
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    mass = 0.01 * np.exp(draw(st.sampled_from([0.0, 1.0, 3.5])) * rng.uniform(-1, 1, len(grid)))
    angle, out = draw(st.floats(-3.1, 3.1)), draw(st.floats(-0.15, 0.01))
    if draw(st.booleans()):
        table = Table("round", (0.1, -0.2), radius=draw(st.sampled_from([0.3, 0.5, 2.0])))
        toward = draw(st.floats(-3.1, 3.1))
        place = np.array([0.1, -0.2]) + (table.radius + out) * np.array([np.cos(toward), np.sin(toward)])
    else:
        table = Table("rectangle", (0.1, -0.2), size=(0.8, 0.5))
        along = draw(st.floats(-0.3, 0.3))
        place = (
            np.array([0.5 + out, along - 0.2]) if draw(st.booleans()) else np.array([0.1 + along, 0.05 + out])
        )
    return grid, mass, np.array([*place, angle]), table


def inside(grid: CellGrid, pose: FloatArray, table: Table) -> list[FloatArray]:
    """Distances of the cells' centres from the rim, one array for each relevant direction."""
    off = placed(grid.centers, pose) - np.asarray(table.center)
    if table.radius is not None:
        return [(table.radius**2 - (off**2).sum(axis=1)) / (2 * table.radius)]
    assert table.size is not None
    return [half - np.abs(off[:, i]) for i, half in enumerate(0.5 * np.asarray(table.size))]


@settings(max_examples=150, deadline=None)
@given(lying())
def test_loads_hold_the_weight_where_it_acts(case: tuple[CellGrid, FloatArray, FloatArray, Table]) -> None:
    """Sum and moments are kept; cells never pull, carry nothing off the table, and sink in by a plane."""
    grid, mass, pose, table = case
    center = mass @ grid.centers / mass.sum()
    found = loads(grid, mass, pose, table)
    assert np.isfinite(found).all() and (found >= 0).all()
    shares = np.prod([share(d, grid.width) for d in inside(grid, pose, table)], axis=0)
    assert (found[shares == 0] == 0).all()
    hull = shapely.MultiPoint(grid.centers[shares > 0.1]).convex_hull
    if hull.geom_type == "Polygon":
        hull = hull.buffer(-0.05 * grid.width)
    assume(hull.distance(shapely.Point(center)) < 1e-9)
    weight = GRAVITY * mass.sum()
    if shares.min() == 1:
        assert found == pytest.approx(GRAVITY * mass, rel=1e-12)
        return
    pressed = found > 1e-6 * weight / len(grid)
    plane = np.column_stack([np.ones(len(grid)), grid.centers])
    depth = found[pressed] / (GRAVITY * mass * shares)[pressed]
    fit, _, rank, _ = np.linalg.lstsq(plane[pressed], depth, rcond=None)
    assert plane[pressed] @ fit == pytest.approx(depth, abs=1e-6 * depth.max())
    # Where the plane is steep, what makes the minimum unique takes a share of both, see the module.
    taken = 1e-10 * (fit[0] - 1) if rank == 3 else 0.0
    assert found.sum() == pytest.approx(weight * (1 - taken), rel=1e-6)
    assert abs(taken) < 1e-4
    hold = 1e-7 * (grid.exterior**2).sum(axis=1).max() * fit[1:]
    assert found @ grid.centers == pytest.approx(weight * (center - hold), abs=1e-3 * weight * grid.width)
    assert np.linalg.norm(hold) < 0.1 * grid.width
    if np.linalg.matrix_rank(plane[pressed], tol=1e-6) == 3:
        lifted = ~pressed & (shares > 1e-4)
        assert (plane[lifted] @ fit <= 1e-4 * depth.max()).all()


@pytest.mark.parametrize("mass", [[0.0, 0.2, 0.3, 0.0], [0.0, 0.0, 0.5, 0.0], [0.2, 0.0, 0.0, 0.3]])
@pytest.mark.parametrize("edge", [-0.2, -0.09, -0.03, 0.03, 0.2])
def test_few_or_massless_cells_stay_finite_and_continuous(mass: list[float], edge: float) -> None:
    grid = bar([-0.1, -0.05, 0.0, 0.05])
    table = Table("rectangle", (edge - 0.5, 0.0), size=(1.0, 1.0))
    here, beside = (loads(grid, np.array(mass), np.array([x, 0.0, 0.0]), table) for x in (0.0, 1e-9))
    assert np.isfinite(here).all()
    assert beside == pytest.approx(here, abs=1e-3)
    assert here.sum() <= GRAVITY * sum(mass) * (1 + 1e-6)


def test_no_part_on_the_table_carries_nothing() -> None:
    found = loads(BLOCK, plain_maps().mass[0], np.array([3.0, 0.0, 0.0]), ROUND)
    assert found == pytest.approx(0.0, abs=1e-12)


def test_a_rim_far_away_changes_no_bit() -> None:
    far = Table("round", (0.0, 0.0), radius=2.0)
    for effects in ([], [EFFECTS["viscous_friction"]], [EFFECTS["load_transfer"]]):
        maps = with_values(plain_maps(), SHOWN[effects[0].name]) if effects else plain_maps()
        one = Slider(BLOCK, RADIUS, effects=effects).rollout(maps, [push_over()], sensitivities=True)
        two = Slider(BLOCK, RADIUS, effects=effects, table=far).rollout(
            maps, [push_over()], sensitivities=True
        )
        assert np.array_equal(one.poses, two.poses) and np.array_equal(one.forces, two.forces)
        assert np.array_equal(one.d_poses, two.d_poses) and np.array_equal(one.d_forces, two.d_forces)
        assert not two.reached.any() and not two.tipped.any()


@pytest.mark.parametrize("name", TABLES)
def test_the_rim_is_felt(name: str) -> None:
    """The push goes over the rim far enough to matter, and the object stays on the table."""
    plain = Slider(BLOCK, RADIUS).rollout(plain_maps(), [push_over()])
    out = Slider(BLOCK, RADIUS, table=TABLES[name]).rollout(plain_maps(), [push_over()])
    assert np.abs(out.poses - plain.poses).max() > 1e-4
    assert out.reached.all() and not out.tipped.any()
    carried = Slider(BLOCK, RADIUS, table=TABLES[name]).loads(plain_maps(), out.poses[0])[0]
    assert (carried[-1] == 0).sum() >= 2 and (carried[0] > 0).all()


COLUMNS = {
    "mass": slice(0, N),
    "mu": slice(N, 2 * N),
    "mu_finger": slice(2 * N, 2 * N + 1),
    "place": slice(2 * N + 1, 2 * N + 3),
    "angle": slice(2 * N + 3, 2 * N + 4),
    "twist": slice(2 * N + 4, 2 * N + 7),
}
STEPS = {"mass": 3e-6, "mu": 1e-5, "mu_finger": 1e-5, "place": 3e-7, "angle": 3e-7, "twist": 6e-6}


@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize(
    "names",
    [
        (),
        ("viscous_friction",),
        ("table_tilt", "tracker_offset"),
        ("table_friction_field", "load_transfer"),
        ("anisotropic_object", "loose_mass"),
    ],
    ids=lambda names: " ".join(names) or "plain",
)
def test_derivatives_through_the_rim(names: tuple[str, ...], table: str) -> None:
    """Central differences of poses and forces with respect to all inputs of a rollout."""
    values = np.concatenate([np.zeros(0), *(SHOWN[name] for name in names)])
    slider = Slider(BLOCK, RADIUS, effects=[EFFECTS[name] for name in names], table=TABLES[table])
    maps, push = with_values(plain_maps(), values) if names else plain_maps(), push_over()
    at = np.concatenate([maps.mass[0], maps.mu[0], maps.mu_finger, push.start_pose, push.start_twist, values])
    steps = np.empty(len(at))
    for group, place in COLUMNS.items():
        steps[place] = STEPS[group]
    scales = [parameter.scale for name in names for parameter in EFFECTS[name].parameters]
    steps[2 * N + 7 :] = 1e-4 * np.maximum(np.abs(values), 0.01 * np.array(scales))

    def run(rows: FloatArray) -> Rollouts:
        return slider.rollout(
            Maps(rows[:, :N], rows[:, N : 2 * N], rows[:, 2 * N], rows[:, 2 * N + 7 :]),
            [push],
            start_poses=rows[:, None, 2 * N + 1 : 2 * N + 4],
            start_twists=rows[:, None, 2 * N + 4 : 2 * N + 7],
        )

    shifts = np.diag(steps)
    numeric = run(np.vstack([at + k * shifts for k in (-2, -1, 1, 2)]))
    out = slider.rollout(maps, [push], sensitivities=True)
    assert out.reached.all() and not out.tipped.any()
    groups = COLUMNS | {f"effect {k}": slice(k, k + 1) for k in range(2 * N + 7, len(at))}
    for reduced, samples in ((out.d_poses, numeric.poses), (out.d_forces, numeric.forces)):
        below2, below, above, above2 = samples.reshape(4, len(at), *samples.shape[1:])
        quotient = np.moveaxis((8 * (above - below) - (above2 - below2)) / 12, 0, -1) / steps
        analytic = slider.map_columns(maps, reduced)[0]
        for group, place in groups.items():
            size = np.abs(quotient[..., place]).max()
            error = np.abs(analytic - quotient)[..., place].max()
            assert error <= 2e-5 * size + 1e-8, f"{group}: {error / max(size, 1e-300):.1e}"


@pytest.mark.parametrize("names", [(), ("viscous_friction",), ("loose_mass",)], ids=" ".join)
def test_derivatives_of_a_slide_from_the_rim_to_the_middle(names: tuple[str, ...]) -> None:
    """At the end all cells are supported again."""
    values = np.concatenate([np.zeros(0), *(SHOWN[name] for name in names)])
    slider = Slider(BLOCK, RADIUS, effects=[EFFECTS[name] for name in names], table=ROUND)
    maps = with_values(plain_maps(), values) if names else plain_maps()
    start, twist = np.array([0.035, 0.02, TURN]), np.array([-1.2, 0.3, 1.0])
    push = Push(0.005, np.full((31, 2), np.nan), start, twist)
    out = slider.rollout(maps, [push], sensitivities=True)
    carried = slider.loads(maps, out.poses[0])[0]
    assert (carried[0] == 0).any() and carried[-1] == pytest.approx(GRAVITY * maps.mass[0], rel=1e-12)
    analytic = slider.map_columns(maps, out.d_poses)[0]
    for group, i, step in (("mass", 4, 1e-6), ("mass", 10, 1e-6), ("mu", 3, 1e-5), ("mu", 12, 1e-5)):
        ends = []
        for sign in (-1, 1):
            mass, mu = maps.mass.copy(), maps.mu.copy()
            (mass if group == "mass" else mu)[0, i] += sign * step
            ends.append(slider.rollout(Maps(mass, mu, maps.mu_finger, maps.effects), [push]).poses[0])
        expected = (ends[1] - ends[0]) / (2 * step)
        found = analytic[..., COLUMNS[group]][..., i]
        assert found == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())


def test_derivatives_of_pushes_that_stay_and_that_come_near() -> None:
    """Joint and separate rollouts agree; pushes far from the rim have no mass columns, or zeros there."""
    slider, maps = Slider(BLOCK, RADIUS, table=ROUND), plain_maps()
    away = push_over()
    inner = finger_push(away.tip - [0.3, 0.0], away.h, start_pose=away.start_pose - [0.3, 0, 0])
    alone = [slider.rollout(maps, [push], sensitivities=True) for push in (inner, away)]
    both = slider.rollout(maps, [inner, away], sensitivities=True)
    assert both.reached.tolist() == [[False, True]]
    assert [out.d_poses.shape[-1] - slider.columns for out in (*alone, both)] == [0, N, N]
    assert np.array_equal(both.d_poses_of(0)[..., : slider.columns], alone[0].d_poses)
    assert np.array_equal(both.d_poses_of(1), alone[1].d_poses)
    assert not both.d_poses_of(0)[..., slider.columns :].any()
    assert not both.d_forces[:, : both.force_at[1], :, slider.columns :].any()


@pytest.mark.parametrize("late", [0.0, 2.4])
@pytest.mark.parametrize("table", TABLES)
def test_a_force_over_a_span_is_the_mean_of_its_steps(table: str, late: float) -> None:
    """With derivatives, where a span begins far from the rim and ends near it, and if forces are late."""
    near = push_over()
    push = finger_push(near.tip - [0.03, 0.0], near.h, start_pose=near.start_pose - [0.03, 0.0, 0.0])
    effects = [EFFECTS["force_latency"]] if late else []
    maps = with_values(plain_maps(), np.array([late * push.h])) if late else plain_maps()
    slider = Slider(BLOCK, RADIUS, effects=effects, table=TABLES[table])
    every = slider.rollout(maps, [push], sensitivities=True)
    rim = int(np.argmax(np.abs(every.d_forces[0, ..., slider.columns :]).sum(axis=(1, 2)) > 0))
    assert rim > 10
    spans = [slice(3, 8), slice(rim - 2, rim + 3), slice(rim + 3, rim + 8)]
    times = push.h * np.array([0.5 * (span.start + span.stop) for span in spans])
    averaged = replace(push, force_times=times, force_span=5 * push.h)
    out = slider.rollout(maps, [averaged], sensitivities=True)
    for row, span in enumerate(spans):
        assert out.forces[0, row] == pytest.approx(every.forces[0, span].mean(axis=0), abs=1e-12)
        expected = every.d_forces[0, span].mean(axis=0)
        assert out.d_forces[0, row] == pytest.approx(expected, abs=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize("names", [(), ("viscous_friction",), ("loose_mass",)], ids=" ".join)
def test_steps_end_where_the_rollout_ends(names: tuple[str, ...], table: str) -> None:
    values = np.concatenate([np.zeros(0), *(SHOWN[name] for name in names)])
    effects = [EFFECTS[name] for name in names]
    maps, push = with_values(plain_maps(), values) if names else plain_maps(), push_over()
    slider = Slider(BLOCK, RADIUS, effects=effects, table=TABLES[table])
    stepper = pickle.loads(pickle.dumps(Stepper(BLOCK, RADIUS, push.h, effects, table=TABLES[table])))
    out = slider.rollout(maps, [push], sensitivities=True)
    models = stepper.models(maps)
    state, size = stepper.start(models, push.start_pose), stepper.size
    by_mass = np.zeros((size, N))
    first = 2 * N + 1
    for k in range(len(push.tip) - 1):
        state, jacobian = stepper.step(models, state, tip=push.tip[k : k + 2], time=k * push.h, derive=True)
        own = jacobian[0]
        by_memory = own[:, first + 6 + len(values) :][:, : size - 6]
        by_mass = own[:, :N] + own[:, first : first + 6] @ by_mass[:6] + by_memory @ by_mass[6:]
    assert state[0, :6] == pytest.approx(out.end[0, 0], abs=1e-10)
    expected = slider.map_columns(maps, out.d_poses)[0, -1, :, :N]
    assert by_mass[:3] == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("name", TABLES)
def test_a_moved_world_changes_nothing(name: str) -> None:
    """Moving object, finger and table together moves the motion with them."""
    slider, maps, push = Slider(BLOCK, RADIUS, table=TABLES[name]), plain_maps(), push_over()
    frame = np.array([0.3, -0.2, 0.7])
    moved = Push(push.h, placed(push.tip, frame), compose(frame, push.start_pose))
    here = slider.rollout(maps, [push], sensitivities=True)
    there = slider.rollout(maps, [moved], table_poses=frame[None, None], sensitivities=True)
    assert relative(frame, there.poses) == pytest.approx(here.poses, abs=1e-11)
    assert slider.rollout(maps, [moved]).poses != pytest.approx(there.poses, abs=1e-5)
    for column in (3, N + 2):
        one, two = (slider.map_columns(maps, out.d_poses)[0, -1, :, column] for out in (here, there))
        turned = placed(one[:2], np.array([0.0, 0.0, frame[2]]))
        assert two == pytest.approx([*turned, one[2]], abs=1e-9 * np.abs(one).max())
    by_start = [
        slider.map_columns(maps, out.d_poses)[0, -1, :, 2 * N + 1 : 2 * N + 4] for out in (here, there)
    ]
    c, s = np.cos(frame[2]), np.sin(frame[2])
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    assert by_start[1] == pytest.approx(turn @ by_start[0] @ turn.T, abs=1e-8)


@pytest.mark.parametrize("name", TABLES)
def test_tipping_is_on_record(name: str) -> None:
    """Tipping begins when the centre of mass passes the rim; loads and poses stay finite."""
    slider, maps, push = Slider(BLOCK, RADIUS, table=TABLES[name]), plain_maps(), push_over()
    push = Push(0.005, np.full((41, 2), np.nan), push.start_pose, np.array([1.0, 0.2, 1.0]))
    out = slider.rollout(maps, [push], sensitivities=True)
    center = maps.mass[0] @ BLOCK.centers / maps.mass[0].sum()
    margins = balance_margins(BLOCK, center[None], out.poses[0], TABLES[name])[:, 0]
    first = int(np.argmax(margins < 0))
    assert first > 0
    assert out.tips[0, 0] == pytest.approx((first + 1) * push.h, abs=1.01 * push.h)
    assert np.isfinite(out.d_poses).all() and np.isfinite(out.poses).all()
    assert not slider.rollout(maps, [push_over()]).tipped.any()
    at_end = Push(
        0.005, np.full((2, 2), np.nan), np.array([*out.poses[0, first, :2], out.poses[0, first, 2]])
    )
    assert slider.rollout(maps, [at_end]).tips[0, 0] == 0.0


def test_a_concave_object_tips_over_the_table() -> None:
    """The centre of mass of an L lies between its arms, over the table, which carries only one arm."""
    grid = l_shape(0.02)
    mass = np.where((grid.centers[:, 1] > 0.15) | (grid.centers[:, 0] > 0.13), 0.2, 0.001)
    slider = Slider(grid, RADIUS, table=Table("rectangle", (0.52, 0.0), size=(1.0, 1.0)))
    maps = Maps(mass, np.full(len(grid), 0.3), np.array([0.3]))
    rest = Push(0.01, np.full((3, 2), np.nan), np.zeros(3))
    center = mass @ grid.centers / mass.sum()
    assert center[0] > 0.03
    assert balance_margins(grid, center[None], np.zeros((1, 3)), slider.table)[0, 0] < 0
    assert slider.rollout(maps, [rest]).tips[0, 0] == 0.0


@settings(max_examples=25, deadline=None)
@given(st.data())
def test_any_object_slid_over_any_rim_stays_finite(data: st.DataObject) -> None:
    _, corners = star(data.draw, 7, 0.04)
    points = np.array([(x, y) for x in np.arange(-0.15, 0.15, 0.02) for y in np.arange(-0.15, 0.15, 0.02)])
    outline = CellGrid(points[:1], 0.02, corners)
    held = np.array([outline.polygon.contains(shapely.Point(p)) for p in points])
    assume(held.any())
    grid = CellGrid(points[held], 0.02, corners)
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    mass = rng.uniform(0, 0.03, len(grid)) * (rng.random(len(grid)) > 0.3) + 1e-6
    maps = Maps(mass, rng.uniform(0.1, 0.6, len(grid)), np.array([0.3]))
    table = data.draw(st.sampled_from([ROUND, SQUARE, Table("round", (0, 0), radius=0.02)]))
    twist = np.array(data.draw(st.tuples(*[st.floats(-1.5, 1.5)] * 3)))
    push = Push(0.01, np.full((60, 2), np.nan), np.zeros(3), twist)
    out = Slider(grid, RADIUS, table=table).rollout(maps, [push], sensitivities=True)
    assert np.isfinite(out.d_poses).all() and np.isfinite(out.poses).all()


def test_a_table_without_its_measure_is_refused() -> None:
    with pytest.raises(ValueError, match="radius"):
        Slider(BLOCK, RADIUS, table=Table("round", (0.0, 0.0)))
    with pytest.raises(ValueError, match="table_poses"):
        Slider(BLOCK, RADIUS, table=ROUND).rollout(plain_maps(), [push_over()], table_poses=np.zeros((1, 3)))


def test_effects_of_the_library_know_their_names() -> None:
    assert {effect.name for effect in LIBRARY} == set(EFFECTS)
