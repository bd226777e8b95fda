"""The engines that slipmap brings an audit for do what is asked of them."""

from __future__ import annotations

import subprocess
import sys
from typing import get_args

import numpy as np
import pytest

from slipmap.diagrams.application.audit import probes
from slipmap.diagrams.application.audit.engines import BUILT_IN, GRAVITY, MU, find_engine, plain_scene
from slipmap.diagrams.application.audit.probes import Key, measures


@pytest.mark.parametrize("spec", ["mujoco:elliptic", "bullet", "drake:lagged"])
def test_an_engine_slides_and_is_pushed(spec: str) -> None:
    name = spec.partition(":")[0]
    pytest.importorskip({"bullet": "pybullet", "drake": "pydrake"}.get(name, name))
    subject, scene = find_engine(spec), plain_scene()
    laid = subject.lay(scene)
    for angle in (0.0, 2.0):
        way = np.array([np.cos(angle), np.sin(angle)])
        path = laid.slide(np.array([*(0.4 * way), 0.0]), 0.4)
        # It stops after v²/2μg; steps, and contacts that hop, make some millimetres.
        assert path[-1, :2] - path[0, :2] == pytest.approx(0.4**2 / 2 / MU / GRAVITY * way, abs=3e-3)
        assert path[-1, 2] == pytest.approx(0.0, abs=0.03)
    # The finger presses from below, left of the centre of mass: it turns the object clockwise.
    steps = round(0.6 / subject.dt)
    start = np.array([-0.05, -0.063 - scene.finger_radius - 1e-3])
    tip = start + np.outer(np.linspace(0.0, 0.04, steps + 1), [0.0, 1.0])
    poses = laid.push(tip, np.zeros(3))
    assert -0.9 < poses[-1, 2] < -0.2
    assert poses[-1, 1] > 0.01


def test_bullet_is_imported_without_a_word() -> None:
    pytest.importorskip("pybullet")
    script = "from slipmap.diagrams.application.bullet_bodies import import_bullet; import_bullet().DIRECT"
    said = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert (said.stdout, said.stderr) == ("", "")


def test_mujocos_defects_are_named() -> None:
    pytest.importorskip("mujoco", reason="MuJoCo comes with the extra `bench`")
    subject = find_engine("mujoco")
    answers = probes.ask(subject, lambda done: None)
    found = {m.key: m.value for m in measures(answers, answers) if m.named}
    assert set(found) == {"diamond", "creep", "load_follows_slip"}
    assert found["diamond"] == pytest.approx(0.95, abs=0.06)
    assert found["creep"] > 0.03 and found["load_follows_slip"] > 0.1


def test_every_remedy_is_for_a_measure_that_there_is() -> None:
    for engine in BUILT_IN.values():
        assert set(engine.remedies) <= set(get_args(Key))
