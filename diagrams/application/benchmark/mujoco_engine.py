"""The same push in MuJoCo: one free body of one box a cell, a finger on a rail with a velocity actuator."""

from __future__ import annotations

import time
from importlib.metadata import version

import numpy as np

from slipmap.diagrams.application.benchmark.scene import (
    DEPTH,
    FINGER_RADIUS,
    GRAVITY,
    MU_FINGER,
    SPEED,
    WIDTH,
    Outcome,
    Scene,
    median_of_runs,
)

SUBSTEPS = 5
"""Steps of the engine in one of ours: its step is 1 ms; with 5 ms its contacts are not stable."""

_HALF_HEIGHT = 2e-3  # flat, so that the push shifts no load between cells

# MuJoCo's contact lifts what slides and takes each of a box's four corners for a support of its own. A low
# impedance (solimp) lets the 4n corners share the weight; friction is damped so little that it hardly lifts.
_TABLE = 'condim="3" solref="-40 -12" solreffriction="-40 -2" solimp="0.01 0.01 1"'
_FINGER = 'condim="3" solref="-1e4 -200"'


def run(scene: Scene, repeats: int) -> Outcome:
    """Simulate the push with the first of the maps.

    Raises:
        ModuleNotFoundError: MuJoCo is not installed.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_string(_description(scene))
    steps = SUBSTEPS * (len(scene.push.tip) - 1)

    def simulate() -> tuple[float, np.ndarray]:
        data = mujoco.MjData(model)
        data.ctrl[0] = data.joint("rail").qvel[0] = SPEED
        start = time.process_time()
        for _ in range(steps):
            mujoco.mj_step(model, data)
        seconds = time.process_time() - start
        x, y, _, cos, _, _, sin = data.joint("free").qpos
        return seconds, np.array([x, y, 2 * np.arctan2(sin, cos)])

    seconds, pose = median_of_runs(simulate, repeats)
    return Outcome(seconds, pose, f"MuJoCo {version('mujoco')}: one body, a box a cell, step 1 ms")


def _description(scene: Scene) -> str:
    """The scene in MuJoCo's own format.

    A cell's box has the side w/√3: in its corners it resists a spin as the square of side w does. A box of
    the object's outline, without mass, meets the finger alone.
    """
    half = scene.slider.grid.width / np.sqrt(12)
    cells, pairs = [], []
    rows = zip(scene.slider.grid.centers, scene.maps.mass[0], scene.maps.mu[0], strict=True)
    for i, ((x, y), mass, mu) in enumerate(rows):
        cells.append(
            f'<geom name="{i}" type="box" pos="{x} {y} 0" size="{half} {half} {_HALF_HEIGHT}" mass="{mass}"/>'
        )
        pairs.append(f'<pair geom1="table" geom2="{i}" friction="{mu} {mu} 0 0 0" {_TABLE}/>')
    x, y = scene.push.tip[0]
    return f"""
    <mujoco>
      <option timestep="{scene.push.h / SUBSTEPS}" cone="elliptic" impratio="1000" gravity="0 0 {-GRAVITY}"
        integrator="implicitfast"/>
      <default><geom contype="0" conaffinity="0"/></default>
      <worldbody>
        <geom name="table" type="plane" size="1 1 1"/>
        <body pos="0 0 {_HALF_HEIGHT}">
          <freejoint name="free"/>
          {"".join(cells)}
          <geom name="outline" type="box" size="{WIDTH / 2} {DEPTH / 2} {_HALF_HEIGHT}" mass="0"/>
        </body>
        <body pos="{x} {y} {_HALF_HEIGHT}">
          <joint name="rail" type="slide" axis="0 1 0"/>
          <geom name="finger" type="cylinder" size="{FINGER_RADIUS} 0.02" mass="1"/>
        </body>
      </worldbody>
      <contact>
        {"".join(pairs)}
        <pair geom1="finger" geom2="outline" friction="{MU_FINGER} {MU_FINGER} 0 0 0" {_FINGER}/>
      </contact>
      <actuator><velocity joint="rail" kv="1e6"/></actuator>
    </mujoco>"""
