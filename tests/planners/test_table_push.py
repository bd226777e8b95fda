"""A push on the table: what is refused, and when its finger is where."""

import numpy as np
import pytest

from slipmap.planners.table_push import TAP_SLOWING_DOWN, TAP_SPEEDING_UP, TOUCH_SPEED, TablePush

BEGIN = np.array([0.1, -0.2])


def along_x(length, speed, creep=0.0):
    return TablePush(BEGIN, BEGIN + np.array([length, 0.0]), speed, creep)


@pytest.mark.parametrize(
    ("push", "word"),
    [
        (lambda: along_x(0.0, 0.1), "same point"),
        (lambda: along_x(0.1, 0.0), "speed"),
        (lambda: along_x(np.nan, 0.1), "finite"),
        (lambda: along_x(0.1, 0.1, creep=0.1), "creep"),
        (lambda: along_x(100.0, 0.05), "100 m lie between begin and end; .* divide by 1000"),
        (lambda: along_x(0.1, 50.0), "speed is 50 m/s; .* divide by 1000"),
    ],
)
def test_what_cannot_be_pushed_is_refused(push, word):
    with pytest.raises(ValueError, match=word):
        push()


@pytest.mark.parametrize(
    ("length", "speed", "creep"),
    [(0.1, 0.05, 0.0), (0.02, 0.5, 0.0), (0.08, 0.3, 0.019), (0.03, 0.3, 0.019), (0.05, 0.3, 0.001)],
)
def test_the_finger_goes_its_way_from_rest_to_rest_as_fast_as_it_may(length, speed, creep):
    pace = along_x(length, speed, creep).pace(0.5, 1.0)
    times = np.linspace(-0.1, pace.duration + 0.1, 20001)
    ways = pace.at(times)
    h = times[1] - times[0]
    speeds = np.diff(ways) / h
    assert ways[0] == 0.0
    assert ways[-1] == pytest.approx(length, rel=1e-9)
    assert speeds.min() > -1e-9
    assert speeds.max() < speed + 1e-9
    hardest = (TAP_SPEEDING_UP, TAP_SLOWING_DOWN) if creep else (0.5, 1.0)
    accelerations = np.diff(speeds) / h
    assert accelerations.max() == pytest.approx(hardest[0], rel=1e-3)
    assert accelerations.min() == pytest.approx(-hardest[1], rel=1e-3)


def test_a_tap_touches_slowly():
    pace = along_x(0.08, 0.3, 0.019).pace(0.5, 1.0)
    times = np.linspace(0.0, pace.duration, 20001)
    ways = pace.at(times)
    slow = ways[1:] < 0.019
    assert (np.diff(ways) / np.diff(times))[slow].max() < TOUCH_SPEED + 1e-6


@pytest.mark.parametrize("creep", [0.0, 0.02])
def test_the_path_rests_goes_straight_and_rests(creep):
    push = TablePush(np.array([0.1, -0.2]), np.array([0.16, -0.12]), 0.3, creep=creep)
    path = push.path(1e-3, rest=0.25)
    speed = np.hypot(*np.diff(path, axis=0).T) / 1e-3
    assert (path[:251] == push.begin).all() and not (path[252] == push.begin).all()
    assert path[-250:] == pytest.approx(np.tile(push.end, (250, 1)), abs=1e-12)
    off_the_line = (path - push.begin) @ [push.direction[1], -push.direction[0]]
    assert np.abs(off_the_line).max() < 1e-12
    assert 0.1 < speed.max() <= 0.3 + 1e-9
    with pytest.raises(ValueError, match="step must be positive"):
        push.path(0.0)
