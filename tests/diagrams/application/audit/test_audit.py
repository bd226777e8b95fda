"""Engines that are the model itself, or the model with one law changed, and engines that are broken."""

from __future__ import annotations

import dataclasses
import json
import re
from hashlib import sha256
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar, cast

import numpy as np
import pytest
from schemas import assert_as_described

from slipmap.diagrams.application.audit import engines, probes
from slipmap.diagrams.application.audit.engines import GRAVITY, LEVEL, MU, Subject, plain_scene
from slipmap.diagrams.application.audit.probes import Measure, measures
from slipmap.diagrams.application.audit.procedure import explain, push_all, standard_pushes
from slipmap.diagrams.application.command_line import run
from slipmap.diagrams.application.reports import audit_words
from slipmap.models.effects import LIBRARY
from slipmap.models.files import BadInput
from slipmap.models.geometry import rotated
from slipmap.models.physics.cell_grid import FloatArray
from tests.diagrams.application.audit.coulomb_engine import CoulombEngine

EFFECTS = {effect.name: effect for effect in LIBRARY}


def hiding(name: str, *values: float) -> Subject:
    """The model with an effect that the audit does not know of."""
    kind = type("Hiding", (CoulombEngine,), {"effects": (EFFECTS[name],), "parameters": values})
    return Subject(name, kind)


def ignore(done: int) -> None:
    pass


def named(subject: Subject) -> dict[str, Measure]:
    """What is named, from the probes at the full step alone."""
    count: list[int] = []
    answers = probes.ask(subject, count.append)
    assert count == list(range(1, probes.COUNT + 1))
    return {m.key: m for m in measures(answers, answers) if m.named}


def sizes(subject: Subject) -> dict[str, float]:
    return {key: measure.value for key, measure in named(subject).items()}


PLATE = plain_scene()
ARMS = np.linalg.norm(PLATE.grid.centers - PLATE.center_of_mass, axis=1)
FRICTION, AREA = MU * GRAVITY * PLATE.mass.sum(), len(PLATE.grid) * PLATE.grid.width**2
_DRAG = 400 * AREA / FRICTION  # s/m


@pytest.mark.parametrize(
    ("name", "values", "key", "size"),
    [
        ("friction_square", [0.7], "square", 0.7),
        ("viscous_friction", [400.0], "speed", (1 + 0.3 * _DRAG) / (1 + 0.02 * _DRAG) - 1),
        (
            "stribeck_friction", [0.4, 0.05, 1.0], "speed",
            (1 + 0.4 * np.exp(-6)) / (1 + 0.4 * np.exp(-0.4)) - 1,
        ),
        ("anisotropic_table", [0.0, 0.15], "grain", 0.15),
        ("anisotropic_object", [0.1, 0.12], "grain", np.hypot(0.1, 0.12)),
        ("table_tilt", [0.01, 0.014], "force", np.hypot(0.01, 0.014) / MU),
        ("table_friction_field", [2.0, 1.0, 0.0, 0.0, 0.0, 0.01], "place", 0.1 * np.hypot(2.0, 1.0)),
        ("torsional_friction", [2e-3], "torsion", 2e-3 / (MU * ARMS.mean())),
        (
            "slip_load", [0.4], "load_follows_slip",
            0.4 * ((ARMS**3).mean() / (ARMS**2).mean() / ARMS.mean() - 1),
        ),
    ],
)  # fmt: skip
def test_one_hidden_law_is_named_with_its_size(name: str, values: list[float], key: str, size: float) -> None:
    found = named(hiding(name, *values))
    measure = found.pop(key)
    assert measure.effect == name
    assert measure.value == pytest.approx(size, rel=0.1 if key in ("load_follows_slip", "torsion") else 0.03)
    # The effects' own pyramids are round enough to creep.
    assert set(found) <= ({"creep"} if key == "square" else set())


def test_a_strong_grain_is_no_pyramid() -> None:
    """An ellipse, too, varies four times around the circle."""
    assert set(named(hiding("anisotropic_table", 0.35, 0.0))) == {"grain"}


class Leaning(CoulombEngine):
    """Friction that leans clockwise of the line of motion."""

    angle: ClassVar[float] = -5.0  # degrees

    def step(self, *path: FloatArray) -> FloatArray:
        level, before = self._gravity, self.pose()
        twist = self._state[0, 3:6]
        x, y = self._scene.center_of_mass
        center = rotated(twist[:2] + twist[2] * np.array([-y, x]), before[2])
        if np.linalg.norm(center) > 1e-3:
            across = MU * GRAVITY * np.tan(np.radians(self.angle)) / np.linalg.norm(center)
            self._gravity = level + across * np.array([center[1], -center[0], 0.0])
        force = super().step(*path)
        self._gravity = level
        return force


def test_friction_that_leans_everywhere_is_named_with_its_sign() -> None:
    assert sizes(Subject("leaning", Leaning)) == {"lean": pytest.approx(-5.0, abs=0.2)}


class Slower(CoulombEngine):
    """Friction 10 % too small, and a creep of 0.1 mm/s."""

    def __init__(self, scene: Any, gravity: FloatArray) -> None:
        scene = dataclasses.replace(scene, mu=0.9 * scene.mu)
        super().__init__(scene, gravity)
        self._crept = np.zeros(3)

    def reset(self, pose: FloatArray, velocity: FloatArray, tip: FloatArray) -> None:
        super().reset(pose, velocity, tip)
        self._crept = np.zeros(3)

    def step(self, *path: FloatArray) -> FloatArray:
        self._crept[:2] += 1e-4 * self.dt * np.sign(self._gravity[:2])
        return super().step(*path)

    def pose(self) -> FloatArray:
        return super().pose() + self._crept


def test_a_zero_has_no_sign() -> None:
    small = Measure("lean", "leaning friction", -1e-4, 2e-3, 1.0, "°", "It leans.", None)
    (row,) = audit_words._measure_rows(cast(Any, SimpleNamespace(measures=[small])))
    assert row[1] == "0.00 °"


def test_weak_friction_and_creep_are_named() -> None:
    found = sizes(Subject("slower", Slower))
    assert found["factor"] == pytest.approx(-0.1, abs=1e-3)
    assert found["creep"] == pytest.approx(0.11, abs=0.05)
    assert set(found) == {"factor", "creep"}


def test_the_effect_that_is_hidden_explains_the_pushes() -> None:
    standard = standard_pushes()
    pushed = push_all(hiding("friction_square", 0.7), standard, ignore)
    assert pushed.price > 2e-3
    found = explain(pushed, standard, EFFECTS["friction_square"])
    assert found.values == pytest.approx([0.7], abs=0.02)
    assert found.price < 0.1 * pushed.price
    assert explain(pushed, standard, EFFECTS["friction_diamond"]).price > 0.9 * pushed.price


ENGINE = """
from tests.diagrams.application.audit.coulomb_engine import CoulombEngine

class Engine(CoulombEngine):
    dt = 4e-3
"""


def test_of_the_model_itself_nothing_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engines, "installed", lambda: [])
    (tmp_path / "mine.py").write_text(ENGINE)
    page, results = tmp_path / "audit.html", tmp_path / "audit.json"
    assert run(["audit", f"{tmp_path / 'mine.py'}:Engine", "-o", str(page), "--json", str(results)]) == 0
    document = json.loads(results.read_text())
    assert_as_described("audit", document)
    (found,) = document["engines"]
    assert found["defects"] == found["explained"] == found["remedies"] == []
    assert found["price_mm"] < 0.1 and found["step"] == 4e-3
    said = capsys.readouterr().out
    assert "torsional friction" in said and not re.search(r"-0\.00 ", said)
    assert "No defect was found" in said and "mm from Coulomb's law" in said
    assert "<svg" not in page.read_text() and "data:image/svg+xml" in page.read_text()


class Broken(CoulombEngine):
    fault: ClassVar[str] = ""

    def __init__(self, scene: Any, gravity: FloatArray) -> None:
        super().__init__(scene, LEVEL if self.fault == "level" else gravity)
        if self.fault == "own step":
            self.dt = 1e-3  # type: ignore[misc]

    def step(self, *path: FloatArray) -> Any:
        force = super().step(*path)
        if self.fault == "raises":
            raise RuntimeError("the solver ran away")
        return None if self.fault == "no force" else force

    def pose(self) -> FloatArray:
        pose = super().pose()
        wrong = {
            "nan": pose * np.nan, "two numbers": pose[:2], "elsewhere": pose + 0.5,
            "degrees": pose * [1, 1, 180 / np.pi], "mirror": pose * [1, 1, -1],
        }  # fmt: skip
        return wrong.get(self.fault, pose)

    def reset(self, pose: FloatArray, velocity: FloatArray, tip: FloatArray) -> None:
        super().reset(pose, {"at rest": 0 * velocity}.get(self.fault, velocity), tip)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("raises", r"step\(\) failed in test_audit.py, line \d+: RuntimeError: the solver ran away"),
        ("no force", r"step\(\) must return 2 finite numbers, got None"),
        ("nan", r"pose\(\) must return 3 finite numbers"),
        ("two numbers", r"pose\(\) must return 3 finite numbers"),
        ("elsewhere", r"after reset\(\) at x, y, θ = \[0.0166, .*, pose\(\) returns \[0.5166, 0.5166, 0.5\]"),
        ("degrees", r"after reset\(\) at x, y, θ = .* 1.0\], pose\(\) returns .* 57.2958\]"),
        ("mirror", r"after reset\(\) at x, y, θ = .* 1.0\], pose\(\) returns .* -1.0\]"),
        ("at rest", r"released at \[0.18, -0.24, 5.0\].*must use the velocity"),
        ("own step", r"__init__ sets dt = 0.001"),
        ("level", r"moves 0.0 mm in 0.15 s.*must use the gravity that it is given"),
    ],
)
def test_a_broken_engine_is_refused_with_what_is_wrong(fault: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        probes.ask(Subject("broken", type("Broken", (Broken,), {"fault": fault})), ignore)


def test_strong_friction_is_no_reason_to_refuse_an_engine() -> None:
    class Sticky(CoulombEngine):
        def __init__(self, scene: Any, gravity: FloatArray) -> None:
            super().__init__(dataclasses.replace(scene, mu=2.5 * scene.mu), gravity)

    probes._check_gravity(Subject("sticky", Sticky))


class Unpushed(CoulombEngine):
    """The finger passes through."""

    def step(self, *path: FloatArray) -> FloatArray:
        return super().step(path[0] + 8, path[1], path[2] + 8, path[3])


def test_an_engine_whose_finger_moves_nothing_is_refused() -> None:
    with pytest.raises(BadInput, match=r"pushes move the object by 0.0 mm instead of 46 mm"):
        push_all(Subject("unpushed", Unpushed), standard_pushes(), ignore)


class Erratic(CoulombEngine):
    """Friction that differs from run to run."""

    runs: ClassVar[list[int]] = []

    def __init__(self, scene: Any, gravity: FloatArray) -> None:
        self.runs.append(0)
        mu = scene.mu * (1 + 5e-3 * np.sin(len(self.runs)))
        super().__init__(dataclasses.replace(scene, mu=mu), gravity)


def test_results_that_change_between_runs_are_named() -> None:
    assert set(sizes(Subject("erratic", Erratic))) == {"repeat"}


def test_a_price_without_a_defect_is_called_unexplained() -> None:
    pushed = SimpleNamespace(price=2.7e-3)
    assert "2.7 mm off, which no probe explains" in audit_words.named(
        cast(Any, SimpleNamespace(defects=[], pushed=pushed))
    )


def test_files_keep_their_module_and_their_names(tmp_path: Path) -> None:
    names = set()
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        file = tmp_path / folder / "engine.py"
        file.write_text(ENGINE)
        subject = engines.find_engine(f"{file}:Engine")
        names.add(subject.name)
        # numba's cache keeps the module's name, so it must not depend on the process
        digest = sha256(str(file).encode()).hexdigest()[:16]
        assert subject.kind.__module__ == f"slipmap_engine_file_{digest}"
    assert len(names) == 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("from pathlib import Path\nclass Other: pass", "there is no class Engine in it; it has Other"),
        ("class Engine: dt = 1e-3", r"it has no reset and no step and no pose\(\)"),
        (ENGINE.replace("4e-3", "'fast'"), "`dt` must be a number between 1e-05 and 0.02 s, got 'fast'"),
        (ENGINE.replace("4e-3", "1e-11"), "`dt` must be a number between 1e-05 and 0.02 s, got 1e-11"),
        ("import nowhere", r"cannot be run: engine.py, line 1: ModuleNotFoundError"),
    ],
)
def test_a_faulty_file_is_refused_with_what_is_wrong(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "engine.py"
    file.write_text(text)
    with pytest.raises(BadInput, match=said):
        engines.find_engine(f"{file}:Engine")


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("havok", "there is no engine 'havok'; name mujoco, bullet, drake"),
        ("missing.py:Engine", "engine file missing.py: there is no such file"),
        (
            "mujoco:round",
            "there is no setting 'round'; there are pyramidal, elliptic, dt=…, impratio=…, timeconst=…",
        ),
        ("mujoco:impratio=much", "impratio must be a number, got 'much'"),
        ("bullet:iterations=nan", "iterations must be a positive whole number, got 'nan'"),
        ("bullet:iterations=2.5", "iterations must be a positive whole number, got '2.5'"),
    ],
)
def test_an_unknown_engine_or_setting_is_refused(spec: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        engines.find_engine(spec)


def test_an_engine_that_is_not_installed_is_refused_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(BadInput, match=r"pybullet is not installed; use `pip install 'slipmap\[bench\]'`"):
        engines.find_engine("bullet:pyramid")
    assert engines.installed() == []
