"""Algorithm 1 against steps worked out by hand."""

import numpy as np
import pytest

from slipmap.models.inference.paper_method import FLOOR, EqualSteps, algorithm_1, bound_schedule, soft_max
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.newton import SPIN_RADIUS
from slipmap.models.physics.rollout import Maps, Push, Slider

G = 9.81
DT = 0.01
SPEED = 0.5
MASS_MAX, MU_MAX = 0.2, 0.6


def row_of_cells(n: int, width: float = 0.02) -> Slider:
    """n cells along x, their middle at the origin."""
    x = (np.arange(n) - (n - 1) / 2) * width
    half = np.array([n, 1]) * width / 2
    outline = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    return Slider(CellGrid(np.column_stack([x, 0 * x]), width, outline), 0.005, G)


def free(poses: np.ndarray) -> EqualSteps:
    """Poses of an object that no finger touches."""
    return EqualSteps(DT, poses, np.full((len(poses), 2), np.nan))


def gliding(y: list[float] | np.ndarray) -> EqualSteps:
    return free(np.array([[0.0, value, 0.0] for value in y]))


def run(slider: Slider, push: EqualSteps, **changes) -> tuple[Maps, np.ndarray, np.ndarray]:
    parameters = {
        "hypotheses": 1,
        "mass_max": MASS_MAX,
        "mu_max": MU_MAX,
        "mu_finger": 0.3,
        "learning_rate": 1.0,
        "temperature": 1.0,
    }
    return algorithm_1(slider, [push], **(parameters | changes))


# Bounds, projection, soft-max


def test_first_half_raises_the_friction_bound_and_second_half_the_mass_bound():
    mass, mu = bound_schedule(4, 8.0, 2.0)
    np.testing.assert_allclose(mu, [1.0, 2.0, 2.0, 2.0])
    np.testing.assert_allclose(mass, [8.0, 8.0, 4.0, 8.0])


def test_the_middle_model_of_an_odd_number_belongs_to_the_second_half():
    mass, mu = bound_schedule(5, 10.0, 1.0)
    np.testing.assert_allclose(mu, [0.4, 0.8, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(mass, [10.0, 10.0, 2.0, 6.0, 10.0])


def test_every_model_starts_at_half_its_bounds():
    maps, _, _ = run(row_of_cells(2), gliding([0, 0.005, 0.01]), hypotheses=4, learning_rate=1e-30)
    np.testing.assert_allclose(maps.mu, np.outer([0.15, 0.3, 0.3, 0.3], [1, 1]))
    np.testing.assert_allclose(maps.mass, np.outer([0.1, 0.1, 0.05, 0.1], [1, 1]))


@pytest.mark.parametrize(("last", "share"), [(0.0055, 1.0), (0.0105, FLOOR)])
def test_a_step_beyond_the_bounds_ends_on_them(last, share):
    """An object that stops at once wants more friction than any bound; one that speeds up, less than none."""
    maps, _, _ = run(row_of_cells(1), gliding([0, 0.005, last]), hypotheses=4, learning_rate=1e9)
    np.testing.assert_allclose(maps.mu[:, 0], share * np.array([0.3, 0.6, 0.6, 0.6]), rtol=1e-12)


def test_soft_max_weighs_by_exponentials_of_the_loss():
    loss = 1e6 + 0.3 * np.log([2.0, 1.0, 4.0])
    np.testing.assert_allclose(soft_max(loss, 0.3), [2 / 7, 4 / 7, 1 / 7], rtol=1e-6)


def test_the_probabilities_are_the_soft_max_of_the_losses():
    maps, loss, probability = run(row_of_cells(1), gliding([0, 0.005, 0.01]), hypotheses=4, temperature=1e-4)
    ratio = probability / probability[0]
    assert loss[1] > 1.5 * loss[0]
    np.testing.assert_allclose(ratio, np.exp(-(loss - loss[0]) / 1e-4))
    assert probability.sum() == pytest.approx(1)
    assert len(maps) == 4


# One step by hand


def test_friction_of_one_gliding_cell_takes_the_step_worked_out_by_hand():
    """Friction mu g slows the cell, so x = x_1 + (v - mu g h) h, ∂x/∂mu = -g h², and mass does not matter."""
    travelled = 0.0048
    maps, loss, _ = run(row_of_cells(1), gliding([0, SPEED * DT, SPEED * DT + travelled]), learning_rate=5e4)
    mu = MU_MAX / 2
    error = (SPEED - mu * G * DT) * DT - travelled
    assert loss[0] == pytest.approx(abs(error), rel=1e-6)
    expected = mu - 5e4 * MU_MAX**2 * error * (-G * DT**2)
    assert abs(expected - mu) > 0.001
    assert maps.mu[0, 0] == pytest.approx(expected, rel=1e-6)
    assert maps.mass[0, 0] == pytest.approx(MASS_MAX / 2, rel=1e-9)


def test_friction_of_two_gliding_cells_answers_to_shift_and_turn():
    """Friction on one of two cells slows the whole by half as much and turns it about its middle."""
    # Cells of a metre: levers count as much as angles in the norm of 3n numbers.
    a, width, m, mu = 0.5, 1.0, MASS_MAX / 2, MU_MAX / 2
    end_speed = SPEED - mu * G * DT
    shift, turn = 2e-4, 3e-3
    first = SPEED * DT
    push = free(np.array([[0, 0, 0], [0, first, 0], [0, first + end_speed * DT + shift, turn]]))
    rate = 1e4
    maps, loss, _ = run(row_of_cells(2, width), push, learning_rate=rate)

    # The step's Hessian for turning: inertia, and friction of cells that spin while they slide.
    hessian = 2 * m * (a**2 + width**2 / 6) + DT * 2 * mu * m * G * (SPIN_RADIUS * width) ** 2 / end_speed
    expected = []
    for x in (-a, a):
        by_shift = -DT * (m * G * DT) / (2 * m)
        by_turn = -DT * (m * G * DT) * x / hessian
        # Cells sit at -a and a, the prediction did not turn: p - p^g = -(shift + x sin turn) along y.
        gradient = sum(
            -(shift + c * np.sin(turn)) * (by_shift + c * by_turn) - turn * by_turn for c in (-a, a)
        )
        expected.append(mu - rate * MU_MAX**2 * gradient)
    assert np.ptp(expected) > 0.01
    np.testing.assert_allclose(maps.mu[0], expected, rtol=1e-5)
    np.testing.assert_allclose(maps.mass[0], MASS_MAX / 2, rtol=1e-6)
    cells = [[c * (1 - np.cos(turn)), shift + c * np.sin(turn), turn] for c in (-a, a)]
    assert loss[0] == pytest.approx(np.linalg.norm(cells), rel=1e-6)


def test_the_loss_is_the_norm_over_all_cells_of_position_and_angle():
    """An object at rest is predicted to rest."""
    moved = np.array([0.003, -0.004, 0.01])
    _, loss, _ = run(row_of_cells(1), free(np.array([np.zeros(3), np.zeros(3), moved])))
    assert loss[0] == pytest.approx(np.linalg.norm(moved), rel=1e-9)


def test_loss_follows_the_simulated_trajectory():
    """A glide at constant speed: behind by mu g h² after one step, then by 3 and 6 times that (line 19)."""
    push = gliding(SPEED * DT * np.arange(5))
    _, loss, _ = run(row_of_cells(4), push, learning_rate=1e-30)
    assert loss[0] == pytest.approx(np.sqrt(4) * (1 + 3 + 6) * MU_MAX / 2 * G * DT**2, rel=1e-6)


def test_maps_change_at_every_time_step_by_the_error_from_the_observed_state():
    """On that glide each step errs by the present -mu g h², so mu shrinks by the same factor each time."""
    push = gliding(SPEED * DT * np.arange(5))
    rate = 2e5
    factor = 1 - rate * MU_MAX**2 * (G * DT**2) ** 2
    assert 0.5 < factor < 0.95
    maps, _, _ = run(row_of_cells(1), push, learning_rate=rate)
    assert maps.mu[0, 0] == pytest.approx(MU_MAX / 2 * factor**3, rel=1e-5)
    again, loss, _ = run(row_of_cells(1), push, learning_rate=rate, epochs=2)
    assert again.mu[0, 0] == pytest.approx(MU_MAX / 2 * factor**6, rel=1e-5)
    # The loss is that of the last pass alone, with the maps as they were at each step.
    mu = MU_MAX / 2 * factor ** np.arange(3, 6)
    slowed = np.cumsum(mu) * G * DT**2
    assert loss[0] == pytest.approx(np.cumsum(slowed).sum(), rel=1e-5)


def test_each_model_steps_in_units_of_its_own_bound():
    push = gliding([0, SPEED * DT, SPEED * DT + 0.0048])
    maps, loss, _ = run(row_of_cells(1), push, hypotheses=4, learning_rate=1e4)
    bound = np.array([0.3, 0.6, 0.6, 0.6])
    error = (SPEED - bound / 2 * G * DT) * DT - 0.0048
    np.testing.assert_allclose(maps.mu[:, 0], bound / 2 + 1e4 * bound**2 * error * G * DT**2, rtol=1e-6)
    np.testing.assert_allclose(loss, np.abs(error), rtol=1e-6)


def test_under_a_finger_both_maps_descend_the_gradient_of_the_squared_error():
    """Against finite differences, summed over three steps from observed states, for small changes."""
    slider = row_of_cells(3)
    turn = np.array([0, 0.05, 0.13, 0.19, 0.27])
    poses = np.column_stack([0.03 * turn**2, 0.08 * turn, turn])
    tip = np.column_stack([np.full(5, 0.021), -0.0155 + 0.005 * np.arange(5)])
    push = EqualSteps(DT, poses, tip)
    rate = 0.3
    maps, _, _ = run(slider, push, learning_rate=rate)
    steps = [Push(DT, tip[t : t + 2], poses[t], push.twists[t - 1]) for t in range(1, 4)]
    x = slider.grid.centers[:, 0]

    def error(mass: np.ndarray, mu: np.ndarray) -> float:
        """Sum of ½ |x - x^g|² over the steps."""
        q = slider.rollout(Maps(mass, mu, np.array([0.3])), steps).poses[0]
        ours, theirs = (
            np.hstack([p[:, :1] + np.outer(np.cos(p[:, 2]), x), p[:, 1:2] + np.outer(np.sin(p[:, 2]), x)])
            for p in (q, poses[2:])
        )
        return 0.5 * float(((ours - theirs) ** 2).sum() + 3 * ((q - poses[2:])[:, 2] ** 2).sum())

    for index, (bound, result) in enumerate([(MASS_MAX, maps.mass[0]), (MU_MAX, maps.mu[0])]):
        gradient = []
        for i in range(3):
            ends = []
            for sign in (1, -1):
                moved = [np.full(3, MASS_MAX / 2), np.full(3, MU_MAX / 2)]
                moved[index][i] += sign * 1e-4 * bound
                ends.append(error(*moved))
            gradient.append((ends[0] - ends[1]) / (2e-4 * bound))
        change = result / bound - 0.5
        assert 1e-6 < np.abs(change).max() < 1e-3
        np.testing.assert_allclose(change, -rate * bound * np.array(gradient), rtol=1e-2, atol=1e-8)


# Observed pushes


def test_observed_twists_are_those_that_the_model_moved_with():
    slider = row_of_cells(3)
    maps = Maps([0.1, 0.2, 0.4], [0.3, 0.2, 0.1], [0.3])
    pose, twist = np.array([0.1, 0.2, 2.0]), np.array([0.4, -0.3, 5.0])
    glides = [Push(DT, np.full((k + 1, 2), np.nan), pose, twist) for k in range(1, 5)]
    ends = slider.rollout(maps, glides).end[0]
    push = free(ends[:, :3])
    np.testing.assert_allclose(push.twists, ends[1:, 3:], rtol=1e-9)
    step = push.transitions()[1]
    np.testing.assert_allclose(step.start_pose, ends[2][:3])
    np.testing.assert_allclose(slider.rollout(maps, [step]).poses[0, 0], ends[3][:3], rtol=1e-9)


def test_neither_the_order_of_cells_nor_the_world_frame_matters():
    slider = row_of_cells(3)
    poses = np.array([[0, 0, 0], [0.0002, 0.004, 0.05], [0.0006, 0.0085, 0.13], [0.0012, 0.0135, 0.22]])
    tip = np.column_stack([np.full(4, 0.021), -0.0155 + 0.005 * np.arange(4)])
    reference, loss, _ = run(slider, EqualSteps(DT, poses, tip), learning_rate=2.0, hypotheses=2)
    assert np.ptp(reference.mu[0]) > 1e-4

    order = [2, 0, 1]
    grid = slider.grid
    permuted = Slider(CellGrid(grid.centers[order], grid.width, grid.exterior), slider.finger_radius, G)
    maps, same_loss, _ = run(permuted, EqualSteps(DT, poses, tip), learning_rate=2.0, hypotheses=2)
    np.testing.assert_allclose(maps.mu, reference.mu[:, order], rtol=1e-7)
    np.testing.assert_allclose(maps.mass, reference.mass[:, order], rtol=1e-7)
    np.testing.assert_allclose(same_loss, loss, rtol=1e-7)

    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    shift = np.array([1.0, -2.0])
    moved = np.column_stack([poses[:, :2] @ turn + shift, poses[:, 2] + np.arctan2(turn[0, 1], turn[0, 0])])
    maps, same_loss, _ = run(
        slider, EqualSteps(DT, moved, tip @ turn + shift), learning_rate=2.0, hypotheses=2
    )
    np.testing.assert_allclose(maps.mu, reference.mu, rtol=1e-7)
    np.testing.assert_allclose(maps.mass, reference.mass, rtol=1e-7)
    np.testing.assert_allclose(same_loss, loss, rtol=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"hypotheses": 0}, "at least one hypothesis"),
        ({"mass_max": 0.0}, "mass_max must be positive"),
        ({"mu_max": np.nan}, "mu_max must be positive"),
        ({"learning_rate": -1.0}, "learning_rate -1.0"),
        ({"epochs": 0}, "epochs 0"),
        ({"temperature": 0.0}, "temperature must be positive"),
    ],
)
def test_parameters_out_of_range_are_named(changes, message):
    with pytest.raises(ValueError, match=message):
        run(row_of_cells(1), gliding([0, 0.005, 0.01]), **changes)


def test_pushes_that_cannot_be_used_are_refused():
    with pytest.raises(ValueError, match="no pushes"):
        algorithm_1(
            row_of_cells(1), [], mass_max=1.0, mu_max=1.0, mu_finger=0.3, learning_rate=1.0, temperature=1.0
        )
    with pytest.raises(ValueError, match="T >= 2"):
        gliding([0, 0.1])
    with pytest.raises(ValueError, match=r"tip must have shape \(3, 2\)"):
        EqualSteps(DT, np.zeros((3, 3)), np.zeros((2, 2)))
    with pytest.raises(ValueError, match="dt must be positive"):
        EqualSteps(0.0, np.zeros((3, 3)), np.zeros((3, 2)))
