"""The benchmark's engines simulate one and the same push."""

from __future__ import annotations

import builtins
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from schemas import assert_as_described

from slipmap.diagrams.application.benchmark import (
    format_table,
    other_engines,
    run_benchmark,
    scene,
)
from slipmap.diagrams.application.benchmark.other_engines import plain_rollout
from slipmap.diagrams.application.benchmark.scene import make_scene
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Maps, Push, Slider

TRIANGLE = np.array([[-0.05, -0.04], [0.06, -0.03], [-0.01, 0.06]])


@pytest.mark.parametrize("mu_finger", [0.05, 0.3, 1.0])
@pytest.mark.parametrize(
    ("start", "velocity"),
    [
        pytest.param((0.02, -0.05), (0.0, 0.08), id="from below"),
        pytest.param((-0.05, 0.02), (0.2, 0.03), id="fast, from the left"),
        pytest.param((-0.01, 0.069), (0.02, -0.06), id="onto a corner"),
    ],
)
def test_plain_numpy_and_the_kernel_agree(
    mu_finger: float, start: tuple[float, float], velocity: tuple[float, float]
) -> None:
    rng = np.random.default_rng(3)
    grid = cells_from_polygon(TRIANGLE, count=30)
    n = len(grid)
    maps = Maps(rng.uniform(0.01, 0.05, n), rng.uniform(0.1, 0.7, n), np.array([mu_finger]))
    h, moving, steps = 0.004, 80, 110
    # The finger stops, so that the object goes through touch, sliding or sticking, and coming to rest.
    time = h * np.minimum(np.arange(steps + 1), moving)
    push = Push(h, np.array(start) + np.outer(time, velocity), np.zeros(3), np.array([0.01, 0.0, 0.3]))
    slider = Slider(grid, 0.008)
    ours = slider.rollout(maps, [push]).poses[0]
    theirs = plain_rollout(slider, maps, push)
    assert np.abs(ours[-1]).max() > 0.01
    assert theirs[0] == pytest.approx(push.start_pose)
    assert theirs[1:] == pytest.approx(ours, abs=1e-6)


def test_plain_numpy_refuses_a_finger_inside_the_object() -> None:
    scene = make_scene(cells=6, models=1, steps=5, seed=0)
    inside = Push(scene.push.h, np.zeros((3, 2)), np.zeros(3))
    with pytest.raises(ValueError, match="inside the object"):
        plain_rollout(scene.slider, scene.maps, inside)


@pytest.mark.parametrize(
    ("package", "engine", "distance", "angle"),
    [
        pytest.param("mujoco", other_engines.run_mujoco, 1.5e-3, np.deg2rad(1), id="mujoco"),
        pytest.param("pybullet", other_engines.run_bullet, 5e-4, np.deg2rad(0.6), id="bullet"),
    ],
)
def test_another_engine_ends_near_ours(package: str, engine: Any, distance: float, angle: float) -> None:
    pytest.importorskip(package, reason="comes with pip install slipmap[bench]")
    scene = make_scene(cells=24, models=1, steps=150, seed=1)
    pose = scene.slider.rollout(scene.maps, [scene.push]).poses[0, -1]
    outcome = engine(scene, 1)
    assert abs(pose[2]) > np.deg2rad(10)
    assert np.linalg.norm(outcome.final_pose[:2] - pose[:2]) < distance
    assert outcome.final_pose[2] == pytest.approx(pose[2], abs=angle)


@pytest.fixture
def small_growth(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene, "CELLS", (6, 20))
    monkeypatch.setattr(scene, "STEPS", (4,))
    monkeypatch.setattr(scene, "MODELS", (1, 3))


@pytest.fixture
def without_engines(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the packages of the other engines were not installed."""
    real = builtins.__import__

    def refuse(name: str, *args: Any, **kwargs: Any) -> Any:
        if name in ("mujoco", "pybullet"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)


@pytest.mark.usefixtures("small_growth", "without_engines")
def test_a_tiny_benchmark_says_what_is_missing(
    slipmap: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reported: list[tuple[str, int, int]] = []

    def tiny(*, progress: Callable[[str, int, int], None]) -> dict[str, Any]:
        def report(stage: str, done: int, total: int) -> None:
            progress(stage, done, total)
            reported.append((stage, done, total))

        return run_benchmark(cells=6, models=3, steps=4, repeats=1, progress=report)

    monkeypatch.setattr("slipmap.diagrams.application.benchmark.run_benchmark", tiny)
    said = slipmap("bench", "--json", tmp_path / "bench.json")
    assert said.code == 0
    result = json.loads((tmp_path / "bench.json").read_text())
    assert reported[0] == ("slipmap", 0, 1)
    assert reported[-1] == ("growth", 4, 4)
    names = [engine["name"] for engine in result["engines"]]
    assert names[0] == "slipmap, one core"
    assert "plain numpy" in names
    assert not {"MuJoCo", "Bullet"} & set(names)
    assert result["engines"][0]["ratio"] == 1.0
    assert result["numpy_difference"] < 1e-6
    assert [(row["cells"], row["steps"], row["models"]) for row in result["growth"]] == [
        (6, 4, 1),
        (20, 4, 1),
        (6, 4, 3),
        (20, 4, 3),
    ]
    assert all(row["peak_mib"] > 1 for row in result["growth"])
    text = said.out.rstrip("\n")
    assert sorted(text.splitlines()) == sorted(format_table(result).splitlines())  # the file sorts its keys
    assert max(map(len, text.splitlines())) <= 80
    assert text.count("pip install 'slipmap[bench]'") == 2


@pytest.mark.usefixtures("small_growth")
def test_a_tiny_benchmark_with_all_engines(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco", reason="comes with pip install slipmap[bench]")
    pytest.importorskip("pybullet", reason="comes with pip install slipmap[bench]")
    # Each measurement of growth is a process of its own.
    monkeypatch.setattr(scene, "CELLS", (6,))
    monkeypatch.setattr(scene, "MODELS", (1,))
    result = run_benchmark(cells=6, models=2, steps=4, repeats=2)
    assert result["missing"] == {}
    assert_as_described("bench", result)
    text = format_table(result)
    assert max(map(len, text.splitlines())) <= 80
    for engine in result["engines"]:
        assert engine["seconds"] > 0
        assert engine["name"] in text


@pytest.mark.usefixtures("small_growth")
def test_a_failed_measurement_of_growth_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene, "CELLS", (0,))
    with pytest.raises(RuntimeError, match=r"(?s)'cells': 0.*count"):
        scene.measure_growth(cells=6, steps=4, repeats=1, seed=0, progress=lambda stage, done, total: None)
