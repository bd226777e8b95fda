"""Errors of pushes, maps, sliders and rollouts name the parameter; accepted input is taken literally."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from sliding_objects import FINGER_RADIUS, drive, finger_push, line, random_maps, rectangle

from slipmap.models.effects.effect import Effect, EffectError, Parameter
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.physics.rollout import Maps, Push, Slider, Smoothing
from slipmap.planners.table_push import TablePush

H = 0.01
STEPS = 20
GRID = rectangle(4, 3)
N = len(GRID)
MAPS = random_maps(np.random.default_rng(12), N)
TIP = line((-0.0251, 0.0), (0.05, 0.0), STEPS * H, H)
NAN = float("nan")


def with_value(array: np.ndarray, index: tuple[int, ...] | int, value: float) -> np.ndarray:
    changed = np.array(array, dtype=float)
    changed[index] = value
    return changed


def push(**changes: Any) -> Push:
    return Push(**{"h": H, "tip": TIP, "start_pose": np.zeros(3), **changes})


BAD_PUSHES: dict[str, tuple[dict[str, Any], str]] = {
    "no step length": ({"h": 0.0}, "h must be positive"),
    "negative step length": ({"h": -0.01}, "h must be positive"),
    "step length not a number": ({"h": NAN}, "h must be positive"),
    "infinite step length": ({"h": np.inf}, "h must be positive"),
    "tip in space": ({"tip": np.zeros((STEPS, 3))}, "tip"),
    "tip in one row": ({"tip": np.zeros(2)}, "tip"),
    "no step": ({"tip": TIP[:1]}, "tip"),
    "start in 3n": ({"start_pose": np.zeros(3 * N)}, "start_pose"),
    "start not a number": ({"start_pose": np.array([0, NAN, 0])}, "start_pose"),
    "twist of two": ({"start_twist": np.zeros(2)}, "start_twist"),
    "infinite twist": ({"start_twist": np.array([np.inf, 0, 0])}, "start_twist"),
    "times fall": ({"pose_times": np.array([0.1, 0.05])}, "pose_times"),
    "times before the push": ({"pose_times": np.array([-0.01, 0.05])}, "pose_times"),
    "times after the push": ({"pose_times": np.array([0.05, 0.21])}, "pose_times"),
    "force times fall": ({"force_times": np.array([0.1, 0.05])}, "force_times"),
    "force times after the push": ({"force_times": np.array([0.3])}, "force_times"),
    "negative span": ({"force_span": -0.1}, "force_span"),
    "span not a number": ({"force_span": NAN}, "force_span"),
    "wrench too short": ({"wrench": np.zeros((STEPS - 1, 5))}, "wrench"),
    "wrench of three": ({"wrench": np.zeros((STEPS, 3))}, "wrench"),
    "tip half there": ({"tip": with_value(TIP, (5, 1), NAN)}, "tip"),
    "tip at infinity": ({"tip": with_value(TIP, (5, 0), np.inf)}, "tip"),
    "lengths in mm": ({"tip": 1e3 * TIP + [0.0, 30.0]}, "start_pose in m"),
    "time not a number": ({"pose_times": np.array([0.05, NAN])}, "pose_times"),
    "force time not a number": ({"force_times": np.array([NAN])}, "force_times"),
    "table of times": ({"pose_times": np.zeros((2, 2))}, "pose_times"),
    "wrench not a number": ({"wrench": with_value(np.zeros((STEPS, 5)), (3, 0), NAN)}, "wrench"),
    "infinite wrench": ({"wrench": with_value(np.zeros((STEPS, 5)), (3, 4), np.inf)}, "wrench"),
}


def passing(cases: dict[str, Any]) -> list[Any]:
    return [pytest.param(*case, id=name) for name, case in cases.items()]


@pytest.mark.parametrize(("changes", "name"), passing(BAD_PUSHES))
def test_a_bad_push_is_refused_by_name(changes: dict[str, Any], name: str) -> None:
    push()
    with pytest.raises(ValueError, match=rf"^push: .*\b{name}\b"):
        push(**changes)


BAD_FORCES: dict[str, tuple[dict[str, Any], str]] = {
    "negative duration": ({"duration": -0.05}, "duration"),
    "longer than the push": ({"duration": 0.5}, "duration"),
    "duration not a number": ({"duration": NAN}, "duration"),
    "force in space": ({"force": (1.0, 0.0, 0.0)}, "force"),
    "point in space": ({"point": (0.0, 0.0, 0.0)}, "point"),
    "no step length": ({"h": 0.0}, "h must be positive"),
}


@pytest.mark.parametrize(("changes", "name"), passing(BAD_FORCES))
def test_a_bad_constant_force_is_refused_by_name(changes: dict[str, Any], name: str) -> None:
    good = {"force": (1.0, 0.0), "point": (0.0, 0.0), "duration": 0.05, "steps": STEPS, "h": H}
    Push.by_force(**good)
    with pytest.raises(ValueError, match=rf"^push: .*\b{name}\b"):
        Push.by_force(**{**good, **changes})


BAD_MAPS: dict[str, tuple[tuple[Any, Any, Any], str]] = {
    "shapes differ": ((np.ones(N), np.ones(N - 1), [0.3]), "mu"),
    "finger for another number": ((np.ones((2, N)), np.ones((2, N)), [0.3]), "mu_finger"),
    "negative mass": ((with_value(np.ones(N), 2, -0.1), np.ones(N), [0.3]), "mass"),
    "mass not a number": ((with_value(np.ones(N), 2, NAN), np.ones(N), [0.3]), "mass"),
    "negative friction": ((np.ones(N), with_value(np.ones(N), 2, -0.1), [0.3]), "mu"),
    "infinite friction": ((np.ones(N), with_value(np.ones(N), 2, np.inf), [0.3]), "mu"),
    "negative finger friction": ((np.ones(N), np.ones(N), [-0.3]), "mu_finger"),
    "no mass": ((np.zeros(N), np.ones(N), [0.3]), "mass"),
    "a table too many": ((np.ones((1, 1, N)), np.ones((1, 1, N)), [0.3]), "mass"),
}


@pytest.mark.parametrize(("values", "name"), passing(BAD_MAPS))
def test_bad_maps_are_refused_by_name(values: tuple[Any, Any, Any], name: str) -> None:
    with pytest.raises(ValueError, match=rf"^maps: .*\b{name}\b"):
        Maps(*values)


@pytest.mark.parametrize("radius", [0.0, -0.005, NAN, np.inf])
def test_a_bad_finger_is_refused_by_name(radius: float) -> None:
    with pytest.raises(ValueError, match="finger radius"):
        Slider(GRID, radius)


@pytest.mark.parametrize("gravity", [0.0, -9.81, NAN, np.inf])
def test_bad_gravity_is_refused_by_name(gravity: float) -> None:
    with pytest.raises(ValueError, match="gravity"):
        Slider(GRID, FINGER_RADIUS, gravity=gravity)


@pytest.mark.parametrize("name", ["slip_speed", "stick_speed", "penetration"])
@pytest.mark.parametrize("value", [0.0, -1e-5, NAN, np.inf])
def test_bad_smoothing_is_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        Slider(GRID, FINGER_RADIUS, smoothing=Smoothing(**{name: value})).rollout(MAPS, [push()])


@pytest.mark.parametrize(
    ("maps", "message"),
    [
        (Maps(np.ones(N + 1), np.ones(N + 1), np.array([0.3])), f"{N + 1} cells, the grid has {N}"),
        (Maps(np.ones(N), np.zeros(N), np.array([0.3])), "friction"),
    ],
)
def test_maps_that_do_not_fit_are_refused(maps: Maps, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Slider(GRID, FINGER_RADIUS).rollout(maps, [push()])


def start(name: str, value: np.ndarray) -> Callable[[], object]:
    return lambda: Slider(GRID, FINGER_RADIUS).rollout(MAPS, [push()], **{name: value})


@pytest.mark.parametrize("name", ["start_poses", "start_twists"])
@pytest.mark.parametrize(
    "value", [np.zeros(3), np.zeros((2, 1, 3)), np.zeros((1, 1, 4)), np.full((1, 1, 3), NAN)]
)
def test_bad_starts_are_refused_by_name(name: str, value: np.ndarray) -> None:
    with pytest.raises(ValueError, match=name):
        start(name, value)()


def test_no_pushes_are_refused_by_name() -> None:
    with pytest.raises(ValueError, match="push"):
        Slider(GRID, FINGER_RADIUS).rollout(MAPS, [])


class TestAcceptedInput:
    slider = Slider(GRID, FINGER_RADIUS)

    def test_poses_within_steps_lie_between_those_at_their_ends(self) -> None:
        ends = self.slider.rollout(MAPS, [push()]).poses[0]
        times = np.sort(np.concatenate([np.arange(1, STEPS + 1) * H, [0.0, 0.033, 0.157, 0.2]]))
        poses = self.slider.rollout(MAPS, [push(pose_times=times)], sensitivities=True).poses[0]
        grid = np.arange(STEPS + 1) * H
        for column in range(3):
            expected = np.interp(times, grid, [0.0, *ends[:, column]])
            assert poses[:, column] == pytest.approx(expected, abs=1e-8)

    def test_sensitivities_within_steps_lie_between_those_at_their_ends(self) -> None:
        times = np.array([0.05, 0.0525, 0.06])
        before, between, after = self.slider.rollout(
            MAPS, [push(pose_times=times)], sensitivities=True
        ).d_poses[0]
        assert between == pytest.approx(0.75 * before + 0.25 * after, abs=1e-6 * np.abs(after).max())

    def test_asking_for_sensitivities_does_not_change_the_motion(self) -> None:
        with_, without = (self.slider.rollout(MAPS, [push()], sensitivities=s) for s in (True, False))
        assert np.array_equal(with_.poses, without.poses)
        assert with_.d_poses.shape == (1, STEPS, 3, self.slider.columns)
        assert without.d_poses.size == 0

    def test_a_pose_may_be_asked_for_twice(self) -> None:
        poses = self.slider.rollout(MAPS, [push(pose_times=np.array([0.1, 0.1, 0.2]))]).poses[0]
        assert np.array_equal(poses[0], poses[1])

    def test_the_force_is_that_of_the_step_that_holds_the_time(self) -> None:
        every = finger_push(TIP, H)
        forces = self.slider.rollout(MAPS, [every]).forces[0]
        out = self.slider.rollout(
            MAPS, [push(force_times=np.array([0.034, 0.04, 0.041]))], sensitivities=True
        )
        assert np.array_equal(out.forces[0], forces[[3, 3, 4]])
        assert np.array_equal(out.d_forces[0, 0], out.d_forces[0, 1])

    def test_starts_of_the_models_take_the_place_of_the_pushs_own(self) -> None:
        maps = Maps(*(np.repeat(value, 2, axis=0) for value in (MAPS.mass, MAPS.mu, MAPS.mu_finger)))
        nowhere = np.full_like(TIP, NAN)
        poses = np.array([[[1.0, 2.0, 0.5]], [[3.0, 4.0, -0.5]]])
        twists = np.array([[[0.1, 0.0, 0.0]], [[0.0, 0.0, 0.0]]])
        out = self.slider.rollout(maps, [push(tip=nowhere)], start_poses=poses, start_twists=twists)
        assert out.poses[1] == pytest.approx(np.tile(poses[1], (STEPS, 1)), abs=1e-12)
        moved = out.poses[0, -1] - poses[0, 0]
        assert moved[:2] @ (np.cos(0.5), np.sin(0.5)) > 5e-4

    def test_a_missing_finger_pushes_nothing_while_it_is_missing(self) -> None:
        gaps = with_value(TIP, slice(8, 11), NAN)
        out = self.slider.rollout(MAPS, [finger_push(gaps, H)], sensitivities=True)
        touched = np.linalg.norm(out.forces[0], axis=1) > 0
        assert touched[6]
        assert not touched[7:11].any()
        assert touched[11:].any()
        assert np.all(out.d_forces[0, 7:11] == 0)

    def test_a_constant_force_acts_for_its_duration(self) -> None:
        made = Push.by_force((1.0, 2.0), (0.01, 0.02), duration=0.05, steps=STEPS, h=H, start_pose=(1, 2, 3))
        by_hand = np.zeros((STEPS, 5))
        by_hand[:5] = 1.0, 2.0, 0.01, 0.02, 0.0
        expected = drive(by_hand, H, start_pose=(1, 2, 3))
        results = [self.slider.rollout(MAPS, [p]).poses for p in (made, expected)]
        assert np.array_equal(*results)

    @pytest.mark.parametrize("duration", [0.0, 0.1, 0.4, 0.5, 0.9])  # steps more than two
    def test_a_force_that_ends_within_a_step_has_its_impulse(self, duration: float) -> None:
        push = Push.by_force((3.0, 4.0), (0.0, 0.0), duration=(2.0 + duration) * H, steps=STEPS, h=H)
        assert push.wrench is not None
        assert H * push.wrench[:, :2].sum(axis=0) == pytest.approx(
            (2.0 + duration) * H * np.array([3.0, 4.0])
        )
        assert not push.wrench[3:].any()

    def test_models_can_be_picked(self) -> None:
        rng = np.random.default_rng(13)
        maps = Maps(rng.uniform(0, 1, (4, N)), rng.uniform(0, 1, (4, N)), rng.uniform(0, 1, 4))
        assert len(maps) == 4
        assert np.array_equal(maps[2].mass, maps.mass[2:3])
        assert np.array_equal(maps[1:3].mu_finger, maps.mu_finger[1:3])
        assert np.array_equal(maps[np.array([3, 0])].mu, maps.mu[[3, 0]])


def test_the_last_push_is_minus_one() -> None:
    rollouts = Slider(GRID, FINGER_RADIUS).rollout(MAPS, [push(), push(pose_times=np.array([0.1]))])
    assert np.array_equal(rollouts.poses_of(-1), rollouts.poses_of(1)) and rollouts.poses_of(-1).size
    with pytest.raises(IndexError):
        rollouts.forces_of(2)


def test_what_is_no_push_is_refused_by_its_number() -> None:
    asked = TablePush([-0.06, 0.0], [0.04, 0.0], 0.05)  # type: ignore[arg-type]
    slider = Slider(GRID, FINGER_RADIUS)
    with pytest.raises(TypeError, match=r"push 1 must be a Push, such as a Candidate's .* got a TablePush"):
        slider.rollout(MAPS, [push(), asked])  # type: ignore[list-item]
    with pytest.raises(TypeError, match="push 0 must be a Push"):
        record_pushes(slider, MAPS[:1], [asked], np.random.default_rng(0))  # type: ignore[list-item]
    with pytest.raises(TypeError, match=r"rng must be a Generator, such as np\.random\.default_rng"):
        record_pushes(slider, MAPS[:1], [push()], 0)  # type: ignore[arg-type]


def test_effects_are_taken_by_name() -> None:
    for given in (["table_tilt"], (name for name in ["table_tilt"])):
        assert [effect.name for effect in Slider(GRID, FINGER_RADIUS, effects=given).effects] == [
            "table_tilt"
        ]
    with pytest.raises(EffectError, match="effect table_tilt is given twice"):
        Slider(GRID, FINGER_RADIUS, effects=["table_tilt", "table_tilt"])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"low": 1.0, "high": -1.0}, "low 1.0 must be below high -1.0"),
        ({"scale": 0.0}, "scale must be positive, got 0.0"),
        ({"null": 9.0}, "null or start 9.0 must lie between"),
        ({"name": "a b"}, "its name must be a Python identifier"),
    ],
)
def test_a_parameter_that_cannot_be_is_refused(changes: dict[str, Any], words: str) -> None:
    given = {"name": "thrust", "unit": "N", "meaning": "of air", "low": -5.0, "high": 5.0, "scale": 0.2}

    class Fan(Effect):
        name = "fan"
        sentence = "A fan blows."
        parameters = (Parameter(**{"null": 0.0, **given, **changes}),)

        def force(self, body: Any, p: Any) -> Any:
            return getattr(p, self.parameters[0].name), 0, 0

    with pytest.raises(EffectError, match=f"effect fan: parameter .*{words}"):
        Slider(GRID, FINGER_RADIUS, effects=[Fan()])
