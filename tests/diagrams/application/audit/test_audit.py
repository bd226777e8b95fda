"""Engines that are the model itself, or the model with one law changed, and engines that are broken."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from schemas import assert_as_described

from slipmap.diagrams.application.audit import engines, probes, standard_pushes
from slipmap.diagrams.application.audit.engines import GRAVITY, LEVEL, MU, CoulombEngine, Subject, plain_scene
from slipmap.diagrams.application.audit.probes import measures
from slipmap.diagrams.application.audit.procedure import explain, push_all
from slipmap.diagrams.application.command_line import run
from slipmap.models.effects import LIBRARY
from slipmap.models.files import BadInput
from slipmap.models.physics.cell_grid import FloatArray

EFFECTS = {effect.name: effect for effect in LIBRARY}


def hiding(name: str, *values: float) -> Subject:
    """The model with an effect that the audit does not know of."""
    kind = type("Hiding", (CoulombEngine,), {"effects": (EFFECTS[name],), "parameters": values})
    return Subject(name, kind)


def ignore(done: int) -> None:
    pass


def sizes(subject: Subject) -> dict[str, float]:
    """What is named, from the probes at the full step alone."""
    answers = probes.ask(subject, ignore)
    return {m.key: m.value for m in measures(answers, answers, subject.dt) if m.named}


PLATE = plain_scene()
ARMS = np.linalg.norm(PLATE.grid.centers - PLATE.center_of_mass, axis=1)
FRICTION, AREA = MU * GRAVITY * PLATE.mass.sum(), len(PLATE.grid) * PLATE.grid.width**2


@pytest.mark.parametrize(
    ("name", "values", "key", "size"),
    [
        ("friction_square", [0.7], "square", 0.7),
        ("viscous_friction", [80.0], "speed", 80 * AREA * (0.3 - 0.02) / FRICTION),
        ("anisotropic_table", [0.05, 0.0], "grain", 0.05),
        ("torsional_friction", [2e-3], "torsion", 2e-3 / (MU * ARMS.mean())),
        (
            "slip_load", [0.4], "load_follows_slip",
            0.4 * ((ARMS**3).mean() / (ARMS**2).mean() / ARMS.mean() - 1),
        ),
    ],
)  # fmt: skip
def test_one_hidden_law_is_named_with_its_size(name: str, values: list[float], key: str, size: float) -> None:
    found = sizes(hiding(name, *values))
    assert found.pop(key) == pytest.approx(size, rel=0.1)
    # The effects' own pyramids are round enough to creep.
    assert set(found) <= {"creep"}


class Slower(CoulombEngine):
    """Friction 10 % too small, and a creep of 0.1 mm/s."""

    def __init__(self, scene: Any, gravity: FloatArray) -> None:
        scene = type(scene)(
            scene.grid, scene.mass, 0.9 * scene.mu, scene.mu_finger, scene.finger_radius
        )  # fmt: skip
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
from slipmap.diagrams.application.audit.engines import CoulombEngine

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
        return {"nan": pose * np.nan, "two numbers": pose[:2], "elsewhere": pose + 0.5}.get(self.fault, pose)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("raises", r"step\(\) failed in test_audit.py, line \d+: RuntimeError: the solver ran away"),
        ("no force", r"step\(\) must return 2 finite numbers, got None"),
        ("nan", r"pose\(\) must return 3 finite numbers"),
        ("two numbers", r"pose\(\) must return 3 finite numbers"),
        ("elsewhere", r"after reset\(\) at x, y, θ = \[0.0, 0.0, 0.0\], pose\(\) returns \[0.5, 0.5, 0.5\]"),
        ("own step", r"__init__ sets dt = 0.001"),
        ("level", r"moves 0.0 mm in 0.25 s.*must use the gravity that it is given"),
    ],
)
def test_a_broken_engine_is_refused_with_what_is_wrong(fault: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        probes.ask(Subject("broken", type("Broken", (Broken,), {"fault": fault})), ignore)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("class Other: pass", "there is no class Engine in it; it has Other"),
        ("class Engine: dt = 1e-3", r"it has no reset and no step and no pose\(\)"),
        (ENGINE.replace("4e-3", "'fast'"), "`dt` must lie between 1e-05 and 0.02 s, got 'fast'"),
        (ENGINE.replace("4e-3", "1e-11"), "`dt` must lie between 1e-05 and 0.02 s, got 1e-11"),
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
        ("bullet:iterations=nan", "iterations must be a positive number, got 'nan'"),
        ("bullet:iterations=-3", "iterations must be a positive number, got '-3'"),
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
