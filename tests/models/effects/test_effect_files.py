"""Effects by name and from users' files: good ones act, faulty ones are refused with file and line."""

from __future__ import annotations

import gc
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from pushed_with_effects import BLOCK, RADIUS, plain_maps, sliding_push, with_values

from slipmap.models.effects import LIBRARY, EffectError, Scene, program
from slipmap.models.effects.effect_checks import check_declaration, check_starts
from slipmap.models.effects.program import program_of
from slipmap.models.effects.registry import effects_named, known_effects, load_effects
from slipmap.models.physics.rollout import Slider

GOOD = """\
import sympy as sp

from slipmap.models.effects import Effect, Parameter


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


def test_a_file_that_changed_within_a_second_is_read_anew(file, monkeypatch):  # type: ignore[no-untyped-def]
    """Python keeps bytecode by a file's size and the second of its change."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    path = file(GOOD)
    load_effects(path)
    then = path.stat().st_mtime
    path.write_text(GOOD.replace("50.0, 0.1", "60.0, 0.1"))
    os.utime(path, (then, then))
    (magnet,) = load_effects(path)
    assert magnet.parameters[0].high == 60.0
    assert not (path.parent / "__pycache__").exists()


def test_an_effect_from_a_file_acts(file) -> None:  # type: ignore[no-untyped-def]
    (magnet,) = load_effects(file(GOOD))
    push, maps = sliding_push(0.3), plain_maps()
    slider = Slider(BLOCK, RADIUS, effects=[magnet])
    plain = Slider(BLOCK, RADIUS).rollout(maps, [push]).poses
    pulled = [slider.rollout(with_values(maps, [size]), [push]).poses for size in (0.0, 0.5)]
    assert np.abs(pulled[0] - plain).max() < 1e-12
    assert np.abs(pulled[1] - plain).max() > 1e-4


def test_an_effect_that_needs_the_slope_of_another_is_refused(file) -> None:  # type: ignore[no-untyped-def]
    """By itself it would do nothing."""
    factor = "    def friction(self, cell, p):\n        return 1 + p.strength * cell.downhill_x\n"
    with pytest.raises(EffectError, match="only through downhill_x"):
        load_effects(file(GOOD[: GOOD.index("    def force")] + factor))


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


TWINS = """\
from slipmap.models.effects import Effect, Parameter


def wind(label, along_x):
    class Wind(Effect):
        name = f"wind_{label}"
        sentence = "Wind."
        parameters = (Parameter("thrust", "N", "force", -5.0, 5.0, 0.2, null=0.0),)

        def force(self, body, p):
            return (p.thrust, 0, 0) if along_x else (0, p.thrust, 0)

    return Wind


WindX, WindY = wind("x", True), wind("y", False)
"""


def test_classes_of_one_function_are_different_effects(file) -> None:  # type: ignore[no-untyped-def]
    ends = []
    for effect in load_effects(file(TWINS, "twins.py")):
        out = Slider(BLOCK, RADIUS, effects=[effect]).rollout(
            with_values(plain_maps(), [2.0]), [sliding_push()]
        )
        ends.append(out.end[0, 0])
    assert abs(ends[0][1] - ends[1][1]) > 1e-3


def test_a_file_that_is_read_twice_leaves_the_first_as_it_was(file) -> None:  # type: ignore[no-untyped-def]
    """Machine code is freed with the module that holds it; reading the file again makes another module."""
    path, maps, push = file(GOOD), with_values(plain_maps(), [2.0]), sliding_push()
    first = Slider(BLOCK, RADIUS, effects=list(load_effects(path)))
    before = first.rollout(maps, [push]).end
    for _ in range(3):
        Slider(BLOCK, RADIUS, effects=list(load_effects(path)))
        gc.collect()
    assert np.array_equal(first.rollout(maps, [push]).end, before)
    assert first.program.module.body.address == first.program.addresses[0]


def test_parameters_of_names_that_join_alike_are_two(file) -> None:  # type: ignore[no-untyped-def]
    first = TWINS.replace("thrust", "b_c").replace('f"wind_{label}"', '"a"').replace('"x", True', '"x", True')
    second = TWINS.replace("thrust", "c").replace('f"wind_{label}"', '"a_b"')
    a, b = load_effects(file(first, "first.py"))[0], load_effects(file(second, "second.py"))[1]
    push = sliding_push()
    both = Slider(BLOCK, RADIUS, effects=[a, b]).rollout(with_values(plain_maps(), [2.0, 0.0]), [push])
    one = Slider(BLOCK, RADIUS, effects=[a]).rollout(with_values(plain_maps(), [2.0]), [push])
    assert both.end == pytest.approx(one.end, abs=1e-12)
    none = Slider(BLOCK, RADIUS, effects=[a]).rollout(with_values(plain_maps(), [0.0]), [push])
    assert np.abs(one.end - none.end).max() > 1e-3


@pytest.mark.parametrize(
    "formula", ["sp.sqrt(body.time)", "sp.log(1 + body.order)", "sp.sqrt(body.spread_xx)", "sp.sign(body.x)"]
)
def test_formulas_of_what_cannot_be_negative_are_accepted(file, formula) -> None:  # type: ignore[no-untyped-def]
    text = GOOD.replace("return pull * (0.1 - body.x)", f"return pull * {formula}")
    (effect,) = load_effects(file(text))
    Slider(BLOCK, RADIUS, effects=[effect]).rollout(with_values(plain_maps(), [0.5]), [sliding_push()])


FAULTS = {
    "unit": ('"N", "of', '"pounds", "of', r"line 6.*: parameter strength: unit 'pounds' is not SI"),
    "bounds": ("-50.0, 50.0", "50.0, -50.0", r"line 6.*: parameter strength: low 50.0 must be below"),
    "null": ("0.1, 0.0),", "0.1),", r"line 6.*: no parameter has a null"),
    "null outside": ("0.1, 0.0),", "0.1, 99.0),", r"line 6.*null or start 99.0 must lie between"),
    "scale": ("0.1, 0.0),", "0.0, 0.0),", r"line 6.*scale must be positive"),
    "infinite bound": ("50.0, 0.1", 'float("inf"), 0.1', r"line 6.*must be finite"),
    "name": ('"magnet"', '"My Magnet"', r"line 6.*: name 'My Magnet' must be lower-case"),
    "no sentence": ('    sentence = "A magnet under the table pulls."\n', "",
                    r"line 6.*: it has no sentence"),
    "not at null": ("p.strength *", "(p.strength + 1) *",
                    r"line 6.*: the effect does not vanish .*strength = 0"),
    "not finite": ("p.strength *", "p.strength / (p.strength - p.strength) *", r"line 6.*: the formula"),
    "no value where it pulls to": (" + 0.03**2)", ")",
                                   r"line 6.*: the formula has no value at .*q_x = 0\.1, q_y = 0, v_x = 0"),
    "no value at rest": ("p.strength *", "p.strength * body.vx / sp.sqrt(body.vx**2 + body.vy**2) *",
                         r"line 6.*: the formula has no value at .*v_x = 0, v_y = 0"),
    "no derivative at rest": ("return pull * (0.1 - body.x), -pull * body.y, 0",
                              "return -p.strength * sp.sqrt(body.vx**2 + body.vy**2) * body.vx, 0, 0",
                              r"line 6.*: the formula has no finite derivative at rest"),
    "memory that has a name already": ("    def force", '    memory = ("mass",)\n\n    def force',
                                       r"line 6.*: memory .*not be one that body or cell has"),
    "root of a negative": ("+ 0.03**2)", "+ 0.03**2) * sp.sqrt(-1 - p.strength**2)", r"Magnet: the formula"),
    "exception": ("        distance", "        raise RuntimeError('oh')\n        distance",
                  r"line 6.*magnet: force\(\) failed in magnet\.py, line 12: RuntimeError: oh"),
    "unknown symbol": ("body.x - 0.1", "body.height - 0.1",
                       r"failed in magnet\.py, line 12: AttributeError: .*body has no 'height'; it has"),
    "stranger": ("body.y**2", 'sp.Symbol("height")', r"symbols that are neither.*height"),
    "of another slot": ("body.y**2", 'sp.Symbol("after_0", real=True)', r"neither.*given to it: after_0"),
    "a cell's, for the body": ("body.y**2", 'sp.Symbol("r_x", real=True)', r"neither.*given to it: r_x"),
    "imaginary": ("pull = p", "pull = sp.I * p", r"contains the imaginary unit I; it must give real"),
    "integral": ("return pull * (0.1 - body.x)",
                 "z = sp.Symbol('z')\n        return pull * sp.Integral(sp.sin(z**2), (z, 0, body.x))",
                 r"line 6.*: the formula cannot be written as code: .*Integral"),
    "cases that leave some out": ("pull = p", "pull = sp.Piecewise((1, body.x > -50)) * p",
                                  r"the cases of Piecewise\(.* leave out some values: end it with one"),
    "wrong number": (", -pull * body.y, 0", ", -pull * body.y",
                     r"force\(\) must return 3 expressions, got 2"),
    "not an expression": ("return pull * (0.1 - body.x)", 'return "pull"', r"must return SymPy expressions"),
    "syntax": ("def force(self, body, p):", "def force(self, body, p)", r"magnet\.py, line 11: expected ':'"),
    "import": ("import sympy as sp", "import simpy_of_nowhere as sp",
               r"magnet\.py, line 1: ModuleNotFoundError"),
    "ends the program": ("\nclass", "import sys\nsys.exit(0)\n\nclass", r"py, line 6: SystemExit: 0"),
    "formula ends the program": ("        distance", "        raise SystemExit\n        distance",
                                 r"Magnet: effect magnet: force\(\) failed in magnet\.py, line 12: Sys"),
    "constructor ends": ("    def force", "    def __init__(self):\n        exit(3)\n\n    def force",
                         r"class Magnet: Magnet\(\) failed in magnet\.py, line 12: SystemExit: 3"),
    "misspelt": ("def force", "def forse", r"forse\(\) is not a method .*; did you mean force\(\)\?"),
    "misspelt beside": ("    def force", "    def stats(self, scene):\n        return [{}]\n\n    def force",
                        r"stats\(\) is not a method of an effect; did you mean starts\(\)\?"),
    "public helper": ("    def force", "    def zzz(self):\n        return 1\n\n    def force",
                      r"zzz\(\) is not a method of an effect; there are friction, drag, .*underscore"),
    "no formula": ("def force", "def _force", r"line 6.*: it has no formula; write one or more of"),
    "nothing returned": ("return pull", "pull", r"what force\(\) return does not depend on strength"),
    "no parameter in it": ("p.strength", "0", r"what force\(\) return does not depend on strength"),
    "unit is no text": ('"N", "of', '5, "of', r"class Magnet: parameter strength: unit must be text, got 5"),
    "null byte": ("\nclass", "\0\nclass", r"magnet\.py, line 5: it holds a null byte"),
    "start outside": ("0.1, 0.0),", "0.1, 0.0, start=99.0),", r"start 99\.0 must lie between -50\.0 and 50"),
    "no class": ("class Magnet(Effect):", "class Magnet:", r"magnet\.py.*Effect"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_file_is_told(fault: str, file) -> None:  # type: ignore[no-untyped-def]
    before, after, message = FAULTS[fault]
    assert GOOD.count(before) == 1 or fault in ("name",)
    with pytest.raises(EffectError, match=message) as caught:
        load_effects(file(GOOD.replace(before, after)))
    assert "magnet.py" in str(caught.value)


STARTS = {
    "raises": ("return [{'place': 1 / 0}]", r"starts\(\) failed in magnet\.py, line 17: ZeroDivisionError"),
    "ends the program": ("raise SystemExit(0)", r"starts\(\) failed in magnet\.py, line 17: SystemExit: 0"),
    "not a number": ("return [{'place': float('nan')}]", r"starts\(\) gives place = nan; .* finite"),
    "a text": ("return [{'place': 'here'}]", r"starts\(\) gives place = 'here'"),
    "unknown name": (
        "return [{'where': 0.1}]",
        r"starts\(\) names 'where'; its parameters are strength, place",
    ),
    "out of range": ("return [{'place': 0.1}, {'place': 5.0}]", r"place = 5; it must lie between -2 and 2"),
    "no list": ("return {'place': 0.1}", r"starts\(\) must return a list"),
    "no guess": ("return []", r"starts\(\) must return a list of one or more"),
}
PLACED = GOOD.replace("0.1, 0.0),", '0.1, 0.0), Parameter("place", "m", "its x", -2.0, 2.0, 0.1),')
PLACED = PLACED.replace("body.x - 0.1", "body.x - p.place") + "\n    def starts(self, scene):\n        "


@pytest.mark.parametrize("fault", STARTS)
def test_faulty_starts_are_told(fault: str, file) -> None:  # type: ignore[no-untyped-def]
    code, message = STARTS[fault]
    with pytest.raises(EffectError, match=r"magnet\.py, line 6.*" + message):
        load_effects(file(PLACED + code))


def test_starts_are_held_into_their_range_where_the_pushes_are_elsewhere(file) -> None:  # type: ignore[no-untyped-def]
    (magnet,) = load_effects(file(PLACED + "return [{'place': 10 * scene.center[0]}]"))
    near, far = (Scene((x, 0.0), 0.1, 0.05, 0.05, 5, 3.0) for x in (0.1, 0.9))
    assert magnet.start_values(near).tolist() == [[0.0, 1.0]]
    assert magnet.start_values(far).tolist() == [[0.0, 2.0]]


def test_starts_that_fail_with_the_recorded_pushes_are_told(file) -> None:  # type: ignore[no-untyped-def]
    (magnet,) = load_effects(file(PLACED + "return [{'place': 1 / (scene.pushes - 7)}]"))
    with pytest.raises(EffectError, match=r"magnet: starts\(\) failed in magnet\.py, line 17: ZeroDivision"):
        magnet.start_values(Scene((0.0, 0.0), 0.1, 0.05, 0.05, 7, 3.0))


def test_the_example_of_the_documentation_is_an_effect() -> None:
    (magnet,) = load_effects(Path(__file__).parents[3] / "docs/examples/magnet.py")
    assert magnet.name == "magnet"


def test_every_effect_of_the_library_passes_the_checks() -> None:
    for effect in LIBRARY:
        check_declaration(effect)
        check_starts(effect)


def test_a_folder_is_no_effect_file(tmp_path: Path) -> None:
    with pytest.raises(EffectError, match="is a folder; name a file in it"):
        load_effects(tmp_path)


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
        slider = Slider(BLOCK, RADIUS, effects=load_effects(file(text)))
        return slider.rollout(with_values(maps, [0.5]), [push]).poses

    first = poses(GOOD)
    stronger = poses(GOOD.replace("p.strength *", "2 * p.strength *"))
    assert np.abs(first - stronger).max() > 1e-4


def test_the_same_formulas_are_differentiated_once(file, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    """In a file of another name too, and after others have been compiled."""
    effects = effects_named(["table_tilt", "tether"])
    first = program_of([*effects, *load_effects(file(GOOD))])
    monkeypatch.setattr(program, "_source", lambda effects: pytest.fail("formulas were written anew"))
    again = program_of([*effects, *load_effects(file(GOOD, "same.py"))])
    assert again is not first and (again.sizes == first.sizes).all()
    with pytest.raises(pytest.fail.Exception):
        program_of(load_effects(file(GOOD.replace("0.03**2 / distance", "0.031**2 / distance"))))


def test_a_function_of_ones_own_may_change_its_code(file) -> None:  # type: ignore[no-untyped-def]
    """Its formula reads the same."""
    own = """\
class Scaled(sp.Function):
    def _pythoncode(self, printer):
        return f"(2 * {printer._print(self.args[0])})"

    def fdiff(self, argindex=1):
        return sp.Integer(2)


class Magnet"""
    text = GOOD.replace("class Magnet", own, 1).replace("return pull * (0.1 - body.x)", "return Scaled(pull)")
    push, maps = sliding_push(0.3), plain_maps()

    def poses(text: str) -> np.ndarray:
        slider = Slider(BLOCK, RADIUS, effects=load_effects(file(text)))
        return slider.rollout(with_values(maps, [0.5]), [push]).poses

    more = text.replace("(2 * {", "(3 * {").replace("Integer(2)", "Integer(3)")
    assert np.abs(poses(text) - poses(more)).max() > 1e-4
