"""Effects by name, and effects that users bring: good ones are used, faulty ones told with file and line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pushed_with_effects import BLOCK, RADIUS, plain_maps, sliding_push, with_values

from models.effects import LIBRARY, EffectError, EffectSlider
from models.effects.registry import effects_named, known_effects, load_effects
from models.physics.rollout import Slider

GOOD = """\
import sympy as sp

from models.effects import Effect, Parameter


class Magnet(Effect):
    name = "magnet"
    sentence = "A magnet under the table pulls."
    parameters = (Parameter("strength", "N", "of the pull", -50.0, 50.0, 0.1, 0.0),)

    def force(self, body, p):
        distance = sp.sqrt((body.x - 0.1) ** 2 + body.y**2 + 0.03**2)
        pull = p.strength * 0.03**2 / distance**3
        return pull * (0.1 - body.x), -pull * body.y, 0
"""


@pytest.fixture
def file(tmp_path: Path):  # type: ignore[no-untyped-def]
    def write(text: str, name: str = "magnet.py") -> Path:
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


def test_an_effect_from_a_file_acts(file) -> None:  # type: ignore[no-untyped-def]
    (magnet,) = load_effects(file(GOOD))
    push, maps = sliding_push(0.3), plain_maps()
    slider = EffectSlider(BLOCK, RADIUS, [magnet])
    plain = Slider(BLOCK, RADIUS).rollout(maps, [push]).poses
    pulled = [slider.rollout(with_values(maps, [size]), [push]).poses for size in (0.0, 0.5)]
    assert np.abs(pulled[0] - plain).max() < 1e-12
    assert np.abs(pulled[1] - plain).max() > 1e-4


def test_known_effects_are_the_library_and_the_files(file) -> None:  # type: ignore[no-untyped-def]
    known = known_effects([file(GOOD)])
    assert known[:-1] == LIBRARY
    assert effects_named(["magnet", "table_tilt"], known) == (known[-1], LIBRARY[4])


def test_names_are_checked() -> None:
    with pytest.raises(EffectError, match=r"unknown effect 'table_tlit'; did you mean table_tilt\?"):
        effects_named(["table_tlit"])
    with pytest.raises(EffectError, match="there are viscous_friction, stribeck"):
        effects_named(["zzz"])
    with pytest.raises(EffectError, match="skate is given twice"):
        effects_named(["skate", "tether", "skate"])


def test_a_name_of_the_library_is_taken(file) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(EffectError, match=r"magnet\.py: there is already an effect skate; rename yours"):
        known_effects([file(GOOD.replace('"magnet"', '"skate"'))])
    with pytest.raises(EffectError, match=r"again\.py: there is already an effect magnet"):
        known_effects([file(GOOD), file(GOOD, "again.py")])


FAULTS = {
    "unit": ('"N", "of', '"pounds", "of', r"line 6: parameter strength: unit 'pounds' is not SI"),
    "bounds": ("-50.0, 50.0", "50.0, -50.0", r"line 6: parameter strength: low 50.0 must be below"),
    "null": ("0.1, 0.0),", "0.1),", r"line 6: no parameter has a null"),
    "null outside": ("0.1, 0.0),", "0.1, 99.0),", r"line 6: .*null or start 99.0 must lie within"),
    "scale": ("0.1, 0.0),", "0.0, 0.0),", r"line 6: .*scale must be positive"),
    "infinite bound": ("50.0, 0.1", 'float("inf"), 0.1', r"line 6: .*must be finite"),
    "name": ('"magnet"', '"My Magnet"', r"line 6: name 'My Magnet' must be lower case"),
    "no sentence": ('    sentence = "A magnet under the table pulls."\n', "",
                    r"line 6: class Magnet has no sentence"),
    "not at null": ("p.strength *", "(p.strength + 1) *",
                    r"line 6: the effect does not vanish .*strength = 0"),
    "not finite": ("p.strength *", "p.strength / (p.strength - p.strength) *", r"line 6: the formula"),
    "no value where it pulls to": (" + 0.03**2)", ")",
                                   r"line 6: the formula has no value at .*q_x = 0\.1, q_y = 0, v_x = 0"),
    "no value at rest": ("p.strength *", "p.strength * body.vx / sp.sqrt(body.vx**2 + body.vy**2) *",
                         r"line 6: the formula has no value at .*v_x = 0, v_y = 0"),
    "root of a negative": ("+ 0.03**2)", "+ 0.03**2) * sp.sqrt(-1 - p.strength**2)", r"line 6: the formula"),
    "exception": ("        distance", "        raise RuntimeError('oh')\n        distance",
                  r"line 6: .*magnet: force\(\) failed in magnet\.py, line 12: RuntimeError: oh"),
    "unknown symbol": ("body.x - 0.1", "body.height - 0.1",
                       r"failed in magnet\.py, line 12: AttributeError: .*body has no 'height'; it has"),
    "stranger": ("body.y**2", 'sp.Symbol("height")', r"symbols that are neither.*height"),
    "wrong number": (", -pull * body.y, 0", ", -pull * body.y",
                     r"force\(\) must return 3 expressions, got 2"),
    "not an expression": ("return pull * (0.1 - body.x)", 'return "pull"', r"must return SymPy expressions"),
    "syntax": ("def force(self, body, p):", "def force(self, body, p)", r"magnet\.py, line 11: expected ':'"),
    "import": ("import sympy as sp", "import simpy_of_nowhere as sp",
               r"magnet\.py, line 1: ModuleNotFoundError"),
    "no class": ("class Magnet(Effect):", "class Magnet:", r"magnet\.py.*Effect"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_file_is_told(fault: str, file) -> None:  # type: ignore[no-untyped-def]
    before, after, message = FAULTS[fault]
    assert GOOD.count(before) == 1 or fault in ("name",)
    with pytest.raises(EffectError, match=message) as caught:
        load_effects(file(GOOD.replace(before, after)))
    assert "magnet.py" in str(caught.value)


def test_a_file_that_is_missing_or_is_no_python(tmp_path: Path) -> None:
    with pytest.raises(EffectError, match="there is no such file"):
        load_effects(tmp_path / "none.py")
    other = tmp_path / "effect.txt"
    other.write_text(GOOD)
    with pytest.raises(EffectError, match=r"must end with \.py"):
        load_effects(other)


def test_a_changed_file_is_compiled_anew(file) -> None:  # type: ignore[no-untyped-def]
    push, maps = sliding_push(0.3), plain_maps()

    def poses(text: str) -> np.ndarray:
        slider = EffectSlider(BLOCK, RADIUS, load_effects(file(text)))
        return slider.rollout(with_values(maps, [0.5]), [push]).poses

    first = poses(GOOD)
    stronger = poses(GOOD.replace("p.strength *", "2 * p.strength *"))
    assert np.abs(first - stronger).max() > 1e-4
