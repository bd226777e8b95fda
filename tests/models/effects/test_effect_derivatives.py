"""Effects at their nulls are nothing at all; away from them, sensitivities are the difference quotients.

Kinks are kept out: the finger touches once and stays on one side of the object, sliding all the while,
or there
is no finger; and no pose is asked for at the end of a step where the tracker is late.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy as sp
from pushed_with_effects import (
    BLOCK,
    EFFECTS,
    RADIUS,
    SHOWN,
    coasting,
    plain_maps,
    sliding_push,
    with_values,
)

from slipmap.models.effects import LIBRARY, Effect, Parameter
from slipmap.models.physics.rollout import Maps, Push, RolloutError, Slider

N = len(BLOCK)
PUSHES = {"finger": sliding_push(), "coasting": coasting()}
GROUPS = {"mass": slice(0, N), "mu": slice(N, 2 * N), "mu_finger": slice(2 * N, 2 * N + 1),
          "start_pose": slice(2 * N + 1, 2 * N + 4), "start_twist": slice(2 * N + 4, 2 * N + 7)}  # fmt: skip
STEPS = {"mass": 3e-6, "mu": 1e-4, "mu_finger": 1e-5, "start_pose": 3e-7, "start_twist": 6e-6}
# Twists: well below the speed by which effects are smoothed at rest, well above rounding.


def test_every_effect_of_the_library_has_values_here() -> None:
    assert list(SHOWN) == [effect.name for effect in LIBRARY]
    for effect in LIBRARY:
        assert len(SHOWN[effect.name]) == len(effect.parameters)
        assert np.all((np.array(SHOWN[effect.name]) != effect.nulls)[effect.amplitudes])


class RootOfSpeed(Effect):
    """Has no derivative at rest; a file that defines it is refused."""

    name = "root_of_speed"
    sentence = "Drag that grows with the root of the speed."
    parameters = (Parameter("size", "N", "drag at 1 m/s", 0.0, 1.0, 0.1, 0.0),)

    def force(self, body: Any, p: Any) -> Any:
        return -p.size * sp.sqrt(sp.sqrt(body.vx**2 + body.vy**2)) * body.vx, 0, 0


def test_a_derivative_that_is_not_finite_is_told() -> None:
    slider, maps = Slider(BLOCK, RADIUS, effects=[RootOfSpeed()]), with_values(plain_maps(), [0.5])
    assert np.isfinite(slider.rollout(maps, [sliding_push()]).poses).all()
    with pytest.raises(RolloutError, match="a derivative is not finite"):
        slider.rollout(maps, [sliding_push()], sensitivities=True)


@pytest.mark.parametrize("push", PUSHES.values(), ids=PUSHES.keys())
@pytest.mark.parametrize("name", EFFECTS)
def test_at_its_null_an_effect_is_nothing(name: str, push: Push) -> None:
    effect = EFFECTS[name]
    maps = plain_maps()
    plain = Slider(BLOCK, RADIUS).rollout(maps, [push], sensitivities=True)
    # Whatever the parameters without a null are.
    values = np.where(effect.amplitudes, effect.nulls, SHOWN[name])
    slider = Slider(BLOCK, RADIUS, effects=[effect])
    out = slider.rollout(with_values(maps, values), [push], sensitivities=True)
    assert out.poses == pytest.approx(plain.poses, rel=1e-11, abs=1e-13)
    assert out.end == pytest.approx(plain.end, rel=1e-9, abs=1e-12)
    assert out.forces == pytest.approx(plain.forces, rel=1e-9, abs=1e-9)
    plain_columns = plain.d_poses.shape[-1]
    for mine, theirs in ((out.d_poses, plain.d_poses), (out.d_forces, plain.d_forces)):
        if theirs.size:
            size = np.abs(theirs).max(axis=(0, 1, 2))
            assert np.all(np.abs(mine[..., :plain_columns] - theirs) <= 1e-8 * size + 1e-13)
    # And without any values given.
    assert slider.rollout(maps, [push]).poses == pytest.approx(out.poses, abs=1e-13)


@pytest.mark.parametrize("push", PUSHES.values(), ids=PUSHES.keys())
@pytest.mark.parametrize("name", EFFECTS)
def test_sensitivities_are_the_central_differences(name: str, push: Push) -> None:
    effect = EFFECTS[name]
    check([effect], np.array(SHOWN[name]), push)


@pytest.mark.parametrize(
    "names",
    [
        ("stribeck_friction", "table_tilt", "finger_compliance"),
        ("skate", "load_transfer", "tracker_offset"),
        ("anisotropic_object", "loose_mass", "tracker_scale", "sensor_latency"),
    ],
    ids=" ".join,
)
def test_sensitivities_of_effects_together(names: tuple[str, ...]) -> None:
    values = np.concatenate([SHOWN[name] for name in names])
    check([EFFECTS[name] for name in names], values, PUSHES["finger"])


@pytest.mark.parametrize(
    "names", [("finger_compliance",), ("finger_compliance", "load_transfer")], ids=" ".join
)
def test_sensitivities_of_a_finger_that_settles_over_several_steps(names: tuple[str, ...]) -> None:
    values = np.concatenate([SHOWN[name] for name in names])
    # The path has a kink within 2e-4 of this compliance, so the steps are short.
    check([EFFECTS[name] for name in names], values, sliding_push(0.4, 4e-3), step=3e-5)


def check(effects, values: np.ndarray, push: Push, step: float = 1e-4) -> None:  # type: ignore[no-untyped-def]
    """Check each parameter of an effect, and each group of the others, to 1e-5 of its largest derivative.

    Parameters of effects are shifted by `step` times their values.
    """
    maps = plain_maps()
    slider = Slider(BLOCK, RADIUS, effects=effects)
    at = np.concatenate([maps.mass[0], maps.mu[0], maps.mu_finger, push.start_pose, push.start_twist, values])
    steps = np.empty(len(at))
    groups = dict(GROUPS)
    for group, place in GROUPS.items():
        steps[place] = STEPS[group]
    parameters = [(effect, parameter) for effect in effects for parameter in effect.parameters]
    for k, (effect, parameter) in enumerate(parameters):
        column = slice(2 * N + 7 + k, 2 * N + 8 + k)
        groups[f"{effect.name}.{parameter.name}"] = column
        steps[column] = step * max(abs(values[k]), 0.01 * parameter.scale)

    def run(rows: np.ndarray):  # type: ignore[no-untyped-def]
        return slider.rollout(
            Maps(rows[:, :N], rows[:, N : 2 * N], rows[:, 2 * N], rows[:, 2 * N + 7 :]),
            [push],
            start_poses=rows[:, None, 2 * N + 1 : 2 * N + 4],
            start_twists=rows[:, None, 2 * N + 4 : 2 * N + 7],
        )

    shifts = np.diag(steps)
    numeric = run(np.vstack([at + k * shifts for k in (-2, -1, 1, 2)]))
    here = with_values(maps, values)
    out = slider.rollout(here, [push], sensitivities=True)
    for what, reduced, samples in (
        ("poses", out.d_poses, numeric.poses),
        ("forces", out.d_forces, numeric.forces),
    ):
        if samples.size == 0:
            continue
        far_below, below, above, far_above = samples.reshape(4, len(at), *samples.shape[1:])
        quotient = np.moveaxis((8 * (above - below) - (far_above - far_below)) / 12, 0, -1) / steps
        analytic = slider.map_columns(here, reduced)[0]
        for group, place in groups.items():
            size = np.abs(quotient[..., place]).max()
            error = np.abs(analytic - quotient)[..., place].max()
            rounding = 1e-12 + 2e-15 / steps[place].min()
            assert error <= 1e-5 * size + rounding, f"{what} by {group}: {error / max(size, 1e-300):.1e}"
    for effect in effects:
        own = [place for group, place in groups.items() if group.startswith(f"{effect.name}.")]
        first = out.d_poses.shape[-1] - len(values) - 2 * N - 7
        changed = out.d_forces if effect.only_force else out.d_poses
        seen = max(np.abs(changed[..., first + place.start]).max(initial=0.0)
                   for place in own)  # fmt: skip
        # A finger or its sensor does not affect an object that is not touched, nor does its apparent place.
        of_finger = effect.only_force or effect.name in ("finger_compliance", "tracker_shift")
        assert seen > 0 or (of_finger and np.isnan(push.tip).all())


def test_effects_of_the_force_sensor_are_those_that_move_nothing() -> None:
    """Only these are left out where no force was measured; a pyramid of friction, for example, is not."""
    of_force = {effect.name for effect in LIBRARY if effect.only_force}
    assert of_force == {"force_frame", "force_bias", "force_gains", "force_latency"}
