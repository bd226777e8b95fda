"""The paper's 3n vectors against planar rigid-body mechanics."""

import numpy as np
import paper_reference as paper
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose

from slipmap.models.objects import cells_from_polygon

W = 0.02
L_CELLS = W * np.array([[0, 0], [1, 0], [2, 0], [0, 1], [0, 2], [1, 2], [0, 3]], dtype=float) + [0.013, -0.04]
seeds = st.integers(0, 2**32 - 1)


def turn(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def transform(q):
    """Homogeneous matrix of a planar pose."""
    T = np.eye(3)
    T[:2, :2], T[:2, 2] = turn(q[2]), q[:2]
    return T


def compose(a, b):
    return np.array([*(transform(a) @ [b[0], b[1], 1])[:2], a[2] + b[2]])


def circle(radius):
    angle = 2 * np.pi * np.arange(360) / 360
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


# --- poses and velocities -----------------------------------------------------------------------------------


def test_pose_vector_of_a_quarter_turn():
    x = paper.cell_poses([1.0, 2.0, np.pi / 2], [[0.3, 0.0], [0.0, 0.1]])
    assert_allclose(x, [1.0, 2.3, np.pi / 2, 0.9, 2.0, np.pi / 2])


def test_velocity_vector_of_a_spin_about_the_first_cell():
    # Object frame at the first cell; the second is 0.3 m ahead, along the world's y, and moves to its left.
    v = paper.cell_velocities([0.0, 0.0, 2.0], [5.0, 6.0, np.pi / 2], [[0.0, 0.0], [0.3, 0.0]])
    assert_allclose(v, [0, 0, 2, -0.6, 0, 2], atol=1e-15)


def test_twist_is_in_the_object_frame():
    v = paper.cell_velocities([1.0, 0.0, 0.0], [0.0, 0.0, np.pi / 2], [[0.1, 0.2]])
    assert_allclose(v, [0, 1, 0], atol=1e-15)


@settings(deadline=None)
@given(seed=seeds)
def test_velocity_is_the_rate_of_the_pose_along_a_screw(seed):
    rng = np.random.default_rng(seed)
    q, v = rng.uniform(-2, 2, 3), rng.uniform(-2, 2, 3)

    def pose(t):
        a = v[2] * t
        # Exact displacement of a constant body twist.
        V = np.array([[np.sinc(a / np.pi), -a / 2 * np.sinc(a / 2 / np.pi) ** 2], [0, 0]])
        V[1] = [-V[0, 1], V[0, 0]]
        return compose(q, [*(t * V @ v[:2]), a])

    h = 1e-5
    rate = (paper.cell_poses(pose(h), L_CELLS) - paper.cell_poses(pose(-h), L_CELLS)) / (2 * h)
    assert_allclose(paper.cell_velocities(v, q, L_CELLS), rate, atol=1e-8)


def test_leading_axes():
    rng = np.random.default_rng(2)
    q, v = rng.standard_normal((4, 5, 3)), rng.standard_normal((5, 3))
    x, xdot = paper.cell_poses(q, L_CELLS), paper.cell_velocities(v, q, L_CELLS)
    assert x.shape == xdot.shape == (4, 5, 3 * len(L_CELLS))
    assert_allclose(x[3, 2], paper.cell_poses(q[3, 2], L_CELLS))
    assert_allclose(xdot[3, 2], paper.cell_velocities(v[2], q[3, 2], L_CELLS))


@given(seed=seeds)
def test_choice_of_the_world_frame(seed):
    rng = np.random.default_rng(seed)
    q, v, g = rng.uniform(-2, 2, (3, 3))
    before = paper.cell_poses(q, L_CELLS).reshape(-1, 3)
    after = paper.cell_poses(compose(g, q), L_CELLS).reshape(-1, 3)
    for a, b in zip(before, after, strict=True):
        assert_allclose(b, compose(g, a), atol=1e-12)
    rates = paper.cell_velocities(v, q, L_CELLS).reshape(-1, 3)
    turned = paper.cell_velocities(v, compose(g, q), L_CELLS).reshape(-1, 3)
    assert_allclose(turned[:, :2], rates[:, :2] @ turn(g[2]).T, atol=1e-12)
    assert_allclose(turned[:, 2], rates[:, 2])


# --- mass and friction --------------------------------------------------------------------------------------


def test_diagonals_have_the_order_of_the_pose():
    assert_allclose(paper.mass_matrix_diagonal([2.0, 3.0], 0.6), [2, 2, 0.12, 3, 3, 0.18])
    assert_allclose(paper.friction_diagonal([0.2, 0.5]), [0.2, 0.2, 0.2, 0.5, 0.5, 0.5])
    assert paper.mass_matrix_diagonal(np.ones((4, 7)), W).shape == (4, 21)
    assert paper.friction_diagonal(np.ones((4, 7))).shape == (4, 21)


@given(seed=seeds)
def test_reduced_mass_matrix_is_that_of_the_rigid_body(seed):
    rng = np.random.default_rng(seed)
    mass, q = rng.uniform(0, 3, len(L_CELLS)), rng.uniform(-3, 3, 3)
    J = paper.rigid_reduction(q, L_CELLS)
    M = J.T @ (paper.mass_matrix_diagonal(mass, W)[:, None] * J)
    m, (sx, sy) = mass.sum(), mass @ L_CELLS
    polar = sum(mi * (rx**2 + ry**2 + W**2 / 6) for mi, (rx, ry) in zip(mass, L_CELLS, strict=True))
    assert_allclose(M, [[m, 0, -sy], [0, m, sx], [-sy, sx, polar]], rtol=1e-12, atol=1e-14)


def test_reduced_inertia_of_a_full_square_is_analytic():
    grid = cells_from_polygon([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]], count=49)
    J = paper.rigid_reduction([0.3, 0.1, 1.2], grid.centers)
    M = J.T @ (paper.mass_matrix_diagonal(np.full(49, 2.0 / 49), grid.width)[:, None] * J)
    assert_allclose(M, np.diag([2.0, 2.0, 2.0 * 0.2**2 / 6]), atol=1e-14)


@given(seed=seeds)
def test_reduction_gives_the_velocity_of_any_twist(seed):
    rng = np.random.default_rng(seed)
    q, v = rng.uniform(-2, 2, (2, 3))
    assert_allclose(paper.rigid_reduction(q, L_CELLS) @ v, paper.cell_velocities(v, q, L_CELLS), atol=1e-13)


# --- forces -------------------------------------------------------------------------------------------------


def test_force_vector_is_on_one_cell():
    assert_allclose(paper.wrench_on_cell(1, [3.0, 4.0], 5.0, 3), [0, 0, 0, 3, 4, 5, 0, 0, 0])


def test_wrench_of_a_force_at_a_lever():
    # World force along y on a cell 0.3 m along the object's x. With the object turned by 90° the force is
    # along its x axis and has no lever.
    force = paper.wrench_on_cell(0, [0.0, 2.0], 0.5, 1)
    assert_allclose(paper.planar_wrench(force, [7, 8, 0], [[0.3, 0.0]]), [0, 2, 0.3 * 2 + 0.5])
    assert_allclose(paper.planar_wrench(force, [7, 8, np.pi / 2], [[0.3, 0.0]]), [2, 0, 0.5], atol=1e-15)


@given(seed=seeds, cell=st.integers(0, len(L_CELLS) - 1))
def test_wrench_has_the_power_of_the_force(seed, cell):
    rng = np.random.default_rng(seed)
    q, v, f = rng.uniform(-2, 2, (3, 3))
    force = paper.wrench_on_cell(cell, f[:2], f[2], len(L_CELLS))
    power = force @ paper.cell_velocities(v, q, L_CELLS)
    assert paper.planar_wrench(force, q, L_CELLS) @ v == pytest.approx(power, abs=1e-12)


# --- joints -------------------------------------------------------------------------------------------------


def test_joints_are_the_sides_that_cells_share():
    pairs = paper.joints(L_CELLS, W)
    lattice = np.rint((L_CELLS - L_CELLS[0]) / W).astype(int)
    n = range(len(lattice))
    expected = {(i, j) for i in n for j in n if i < j and np.abs(lattice[i] - lattice[j]).sum() == 1}
    assert {tuple(sorted(pair)) for pair in pairs.tolist()} == expected
    assert len(pairs) == len(expected)


def test_joints_connect_parts_by_the_shortest_way():
    centers = W * np.array([[0, 0], [1, 0], [2, 1], [5, 1], [6, 1]], dtype=float)
    pairs = {tuple(sorted(pair)) for pair in paper.joints(centers, W).tolist()}
    assert pairs == {(0, 1), (3, 4), (1, 2), (2, 3)}


@settings(deadline=None)
@given(seed=seeds)
def test_rigid_motion_fulfils_the_constraints(seed):
    rng = np.random.default_rng(seed)
    q, v = rng.uniform(-2, 2, (2, 3))
    Je = paper.equality_jacobian(q, L_CELLS, W)
    assert_allclose(Je @ paper.cell_velocities(v, q, L_CELLS), 0, atol=1e-13)


@pytest.mark.parametrize("angle", [0.0, 1.1])
@pytest.mark.parametrize(
    "centers",
    [L_CELLS, L_CELLS[[0, 1, 4, 5]], np.vstack([L_CELLS, L_CELLS[0] + 5 * W]), L_CELLS[:1]],
    ids=["an L", "two parts", "far cell", "one cell"],
)
def test_only_rigid_motions_fulfil_the_constraints(centers, angle):
    Je = paper.equality_jacobian([0.4, 0.2, angle], centers, W).toarray()
    n = len(centers)
    scaled = Je / np.tile([1, 1, W], n)  # lengths in cells, so that the rank does not depend on the unit
    assert Je.shape[1] == 3 * n
    singular = np.linalg.svd(scaled, compute_uv=False) if n > 1 else np.zeros(0)
    assert np.sum(singular > 1e-6) == 3 * n - 3


def test_constraint_notices_each_way_of_coming_apart():
    Je = paper.equality_jacobian([0, 0, 0], [[0, 0], [W, 0]], W).toarray()
    assert_allclose(Je @ [0, 0, 0, 1, 0, 0], [-1, 0, 0], atol=1e-15)  # pulled off
    assert_allclose(Je @ [0, 0, 0, 0, 1, 0], [0, -1, 0], atol=1e-15)  # sheared off
    # The right cell spins about its own centre: its side runs down at W/2 times the rate, and it turns.
    assert_allclose(Je @ [0, 0, 0, 0, 0, 1], [0, W / 2, -1], atol=1e-15)


def test_constraint_forces_do_no_work_on_the_rigid_body():
    rng = np.random.default_rng(4)
    q = np.array([0.1, 0.2, 0.7])
    Je = paper.equality_jacobian(q, L_CELLS, W)
    multipliers = rng.standard_normal(Je.shape[0])
    assert_allclose(paper.planar_wrench(Je.T @ multipliers, q, L_CELLS), 0, atol=1e-12)


def test_thousands_of_cells_stay_sparse():
    grid = cells_from_polygon(circle(0.1), count=2000)
    n = len(grid)
    Je = paper.equality_jacobian([0, 0, 0.3], grid.centers, grid.width)
    assert Je.nnz < 40 * n
    v = paper.cell_velocities([0.1, -0.2, 3.0], [0, 0, 0.3], grid.centers)
    assert_allclose(Je @ v, 0, atol=1e-12)


# --- ADD ----------------------------------------------------------------------------------------------------


@given(seed=seeds)
def test_add_of_a_translation_is_its_length(seed):
    rng = np.random.default_rng(seed)
    q, d = rng.uniform(-2, 2, 3), rng.uniform(-1, 1, 2)
    assert paper.add(q, q + np.append(d, 0), L_CELLS) == pytest.approx(np.hypot(*d), abs=1e-14)


def test_add_of_a_turn_is_analytic():
    # Chord of a turn: 2 r sin(a/2); mean distance of a disc's points from its centre: 2/3 R.
    grid = cells_from_polygon(circle(0.1), count=3000)
    a = 0.8
    value = paper.add([1, 2, 0.3], [1, 2, 0.3 + a], grid.centers)
    assert value == pytest.approx(2 * np.sin(a / 2) * 2 / 3 * 0.1, rel=2e-3)
    assert paper.add([1, 2, 0.3], [1, 2, 0.3 + 2 * np.pi], grid.centers) == pytest.approx(0, abs=1e-12)


@given(seed=seeds)
def test_add_is_symmetric_and_free_of_the_frames(seed):
    rng = np.random.default_rng(seed)
    a, b, g = rng.uniform(-2, 2, (3, 3))
    value = paper.add(a, b, L_CELLS)
    assert paper.add(b, a, L_CELLS) == pytest.approx(value)
    assert paper.add(compose(g, a), compose(g, b), L_CELLS) == pytest.approx(value)
    # Another object frame: poses q ∘ g see the cells at g⁻¹ r.
    seen = (L_CELLS - g[:2]) @ turn(g[2])
    assert paper.add(compose(a, g), compose(b, g), seen) == pytest.approx(value)


def test_add_over_trajectories():
    rng = np.random.default_rng(8)
    a, b = rng.standard_normal((2, 6, 50, 3))
    values = paper.add(a, b, L_CELLS)
    assert values.shape == (6, 50)
    assert values[4, 30] == pytest.approx(float(paper.add(a[4, 30], b[4, 30], L_CELLS)))
    assert paper.add(a, b[0, 0], L_CELLS).shape == (6, 50)


# --- wrong input --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: paper.cell_poses([1, 2], L_CELLS), "pose q: expected three numbers"),
        (
            lambda: paper.cell_poses([[1, 2, 3], [1, np.nan, 3]], L_CELLS),
            r"pose q: entry \(1, 1\) is not finite",
        ),
        (lambda: paper.cell_poses([1, 2, 3], [1, 2]), "cell centres: expected an"),
        (lambda: paper.cell_velocities([1, 2, np.inf], [0, 0, 0], L_CELLS), "twist v: entry"),
        (
            lambda: paper.mass_matrix_diagonal([1, -2], W),
            "mass: must be finite and not negative, cell 1 has -2",
        ),
        (lambda: paper.mass_matrix_diagonal([1, 2], 0), "cell width must be a positive length in m, got 0"),
        (lambda: paper.mass_matrix_diagonal(1.0, W), "mass: expected one value a cell"),
        (
            lambda: paper.friction_diagonal([[0.1, 0.2], [np.nan, 0.2]]),
            "friction coefficient: .* cell 0 has nan",
        ),
        (lambda: paper.rigid_reduction([[0, 0, 0]], L_CELLS), r"expected one pose \(3,\)"),
        (lambda: paper.wrench_on_cell(3, [1, 0], 0, 3), "cell must be from 0 to 2, got 3"),
        (lambda: paper.wrench_on_cell(-1, [1, 0], 0, 3), "cell must be from 0 to 2, got -1"),
        (lambda: paper.wrench_on_cell(0, [1, 0, 0], 0, 3), "force and torque: expected three"),
        (lambda: paper.planar_wrench(np.zeros(6), [0, 0, 0], L_CELLS), "for 7 cells"),
        (lambda: paper.equality_jacobian([[0, 0, 0]], L_CELLS, W), r"expected one pose \(3,\)"),
        (lambda: paper.equality_jacobian([0, 0, 0], L_CELLS, -1), "cell width"),
    ],
)
def test_wrong_input_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
