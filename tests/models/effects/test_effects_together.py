"""Several effects at once, and formulas that are compiled only once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numba import types
from pushed_with_effects import (
    BLOCK,
    EFFECTS,
    RADIUS,
    SHOWN,
    block,
    coast_of,
    coasting,
    plain_maps,
    slide,
    sliding_push,
    with_values,
)

from slipmap.models.effects import Effect, Parameter, program as programs
from slipmap.models.physics.kernel import rollout_one
from slipmap.models.physics.rollout import Slider

PAIRS = [
    ("table_tilt", "viscous_friction"),
    ("anisotropic_table", "anisotropic_object"),
    ("friction_drift", "table_friction_field"),
    ("skate", "tether"),
    ("tracker_offset", "tracker_scale"),
    ("sensor_latency", "stribeck_friction"),
]


@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_small_effects_add_up(one: str, other: str) -> None:
    """The deviation from the sum falls with the square of their size; without a finger there are no kinks."""
    push, maps = coasting(), plain_maps()
    plain = Slider(BLOCK, RADIUS).rollout(maps, [push]).poses

    def change(names: tuple[str, ...], share: float) -> np.ndarray:
        values = []
        for name in names:
            effect = EFFECTS[name]
            shown = np.array(SHOWN[name])
            values.append(np.where(effect.amplitudes, effect.nulls + share * (shown - effect.nulls), shown))
        slider = Slider(BLOCK, RADIUS, effects=[EFFECTS[name] for name in names])
        return slider.rollout(with_values(maps, np.concatenate(values)), [push]).poses - plain

    def left_over(share: float) -> float:
        return float(
            np.abs(change((one, other), share) - change((one,), share) - change((other,), share)).max()
        )

    size = np.abs(change((one, other), 0.01)).max()
    assert left_over(0.01) < 0.05 * size
    assert left_over(0.01) < 0.02 * left_over(0.1) + 1e-12


def test_the_order_of_effects_does_not_matter() -> None:
    push, maps = sliding_push(0.3), plain_maps()
    names = ["stribeck_friction", "table_tilt", "finger_compliance"]
    results = []
    for order in (names, names[::-1]):
        slider = Slider(BLOCK, RADIUS, effects=[EFFECTS[name] for name in order])
        values = np.concatenate([SHOWN[name] for name in order])
        results.append(slider.rollout(with_values(maps, values), [push]).poses)
    assert results[0] == pytest.approx(results[1], abs=1e-12)


class SteadyPull(Effect):
    name = "steady_pull"
    sentence = "A constant force along x."
    parameters = (Parameter("size", "N", "of the force", -10.0, 10.0, 1.0, 0.0),)

    def force(self, body, p):  # type: ignore[no-untyped-def]
        return p.size, 0, body.com_x * 0 - body.com_y * p.size


def test_wrenches_add_exactly() -> None:
    grid = block(4, 4, 0.01)
    push = coast_of((0.5, 0.2, 3.0), 0.2, 1e-3)
    tilt, pull = EFFECTS["table_tilt"], SteadyPull()
    down = 0.08
    both = slide([tilt, pull], [down, 0.0, 0.3], push, grid=grid, mass=0.5)
    as_one = slide([tilt], [down + 0.3 / (0.5 * 9.81), 0.0], push, grid=grid, mass=0.5)
    assert both.poses == pytest.approx(as_one.poses, abs=1e-12)


def test_formulas_are_compiled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    effects = (EFFECTS["table_tilt"], EFFECTS["skate"])
    first = programs.program_of(effects)
    assert programs.program_of(effects) is first
    # From disk too: a new process need not even write the formulas out.
    programs._program_of.cache_clear()
    monkeypatch.setattr(programs, "_source", lambda effects: pytest.fail("formulas were written anew"))
    again = programs.program_of(effects)
    assert again is not first
    assert (again.sizes == first.sizes).all()


@pytest.mark.parametrize("keep", [0, 200])
def test_torn_formulas_are_written_anew(keep: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programs, "CACHE_FOLDER", tmp_path)
    effects = (EFFECTS["table_tilt"],)
    for _ in range(2):
        programs._program_of.cache_clear()
        assert programs.program_of(effects).parameters == 2
        (path,) = tmp_path.glob("effects-*/program.py")
        whole = path.read_bytes()
        path.write_bytes(whole[:keep])
    programs._program_of.cache_clear()
    programs.program_of(effects)
    assert path.read_bytes() == whole


def test_formulas_run_where_nothing_can_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setattr(programs, "CACHE_FOLDER", tmp_path / "file" / "kernels")
    programs._program_of.cache_clear()
    found = programs.program_of((EFFECTS["table_tilt"],))
    assert found.parameters == 2 and found.addresses[0] != 0


def test_the_kernels_of_the_plain_model_do_not_change_with_effects() -> None:
    push, maps = sliding_push(0.3), plain_maps()
    slider = Slider(BLOCK, RADIUS)
    before = slider.rollout(maps, [push])
    Slider(BLOCK, RADIUS, effects=[EFFECTS["skate"]]).rollout(with_values(maps, SHOWN["skate"]), [push])
    after = slider.rollout(maps, [push])
    assert np.array_equal(before.poses, after.poses)
    # The plain one is compiled without formulas, whatever came before it.
    kinds = {signature[4] for signature in rollout_one.signatures}
    assert types.none in kinds and len(kinds) == 2


def test_values_of_other_effects_are_refused() -> None:
    slider = Slider(BLOCK, RADIUS, effects=[EFFECTS["table_tilt"]])
    with pytest.raises(ValueError, match=r"3 effect parameters.*table_tilt have 2"):
        slider.rollout(with_values(plain_maps(), [0.1, 0.2, 0.3]), [sliding_push(0.1)])
