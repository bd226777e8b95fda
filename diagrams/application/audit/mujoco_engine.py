"""MuJoCo under audit: a rigid body with one foot per cell."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np

from slipmap.diagrams.application.audit.engines import AWAY, EngineScene
from slipmap.models.physics.cell_grid import FloatArray

_FOOT = 2e-3  # m, radius
_HALF_HEIGHT = 2e-3  # m, of the object's centre of mass and of the finger's centre above the table
_IMPEDANCE = 0.9  # MuJoCo's default at first touch
_SETTLING = 1.0  # s
_FINGER_MASS = 1e3  # kg; nothing in the scene moves it
_FINGER_CONTACT = 'condim="3" solref="-1e4 -200"'  # stiff; the default yields by a millimetre


class MujocoEngine:
    """MuJoCo with its defaults for friction pyramid, impratio, solver and contact softness.

    The contact impedances are chosen so that at rest each foot carries the weight of its cell.
    """

    dt: ClassVar[float] = 2e-3  # MuJoCo's default
    cone: ClassVar[str] = "pyramidal"
    impratio: ClassVar[float] = 1.0
    timeconst: ClassVar[float] = 0.02  # s, of the feet's contacts; MuJoCo's default

    def __init__(self, scene: EngineScene, gravity: FloatArray) -> None:
        self._model = mujoco.MjModel.from_xml_string(self._description(scene))
        self._data = mujoco.MjData(self._model)
        self._height = _HALF_HEIGHT
        self.reset(np.zeros(3), np.zeros(3), AWAY)
        for _ in range(round(_SETTLING / self.dt)):
            mujoco.mj_step(self._model, self._data)
        self._height = float(self._data.joint("free").qpos[2])
        self._model.opt.gravity[:] = gravity

    def reset(self, pose: FloatArray, velocity: FloatArray, tip: FloatArray) -> None:
        """See `Engine`."""
        mujoco.mj_resetData(self._model, self._data)
        free = self._data.joint("free")
        free.qpos = [*pose[:2], self._height, np.cos(pose[2] / 2), 0, 0, np.sin(pose[2] / 2)]
        free.qvel = [*velocity[:2], 0, 0, 0, velocity[2]]
        self._data.qpos[:2] = tip

    def step(
        self, tip: FloatArray, tip_velocity: FloatArray, next_tip: FloatArray, next_velocity: FloatArray
    ) -> FloatArray:
        """See `Engine`."""
        data, speed = self._data, (next_tip - tip) / self.dt
        data.qpos[:2], data.qvel[:2] = tip, speed
        mujoco.mj_step(self._model, data)
        return np.asarray(_FINGER_MASS / self.dt * (speed - data.qvel[:2]))

    def pose(self) -> FloatArray:
        """See `Engine`."""
        x, y, _, cos, _, _, sin = self._data.joint("free").qpos
        return np.array([x, y, 2 * np.arctan2(sin, cos)])

    def _description(self, scene: EngineScene) -> str:
        """The scene in MuJoCo's own format; the finger's two joints come first."""
        softness = (1 / _IMPEDANCE - 1) * scene.mass.mean() / scene.mass
        cells, pairs, meshes, sides = [], [], [], []
        for i, ((x, y), mass, mu) in enumerate(zip(scene.grid.centers, scene.mass, scene.mu, strict=True)):
            half = scene.grid.width / 2
            cells.append(
                f'<geom type="box" pos="{x} {y} 0" size="{half} {half} {_HALF_HEIGHT}" mass="{mass}"/>'
                f'<geom name="foot {i}" type="sphere" pos="{x} {y} {_FOOT - _HALF_HEIGHT}" size="{_FOOT}"'
                ' mass="0"/>'
            )
            impedance = 1 / (1 + softness[i])
            pairs.append(
                f'<pair geom1="table" geom2="foot {i}" condim="3" friction="{mu} {mu} 0 0 0"'
                f' solimp="{impedance} {impedance} 0.001" solref="{self.timeconst} 1"/>'
            )
        for i, piece in enumerate(scene.pieces):
            corners = " ".join(f"{x} {y} {z}" for z in (-0.02, 0.02) for x, y in piece)
            # A mesh's frame is its centre of mass; these are upright prisms about z = 0.
            meshes.append(f'<mesh name="{i}" vertex="{corners}" inertia="exact"/>')
            sides.append(f'<geom name="side {i}" type="mesh" mesh="{i}" mass="0"/>')
            pairs.append(
                f'<pair geom1="finger" geom2="side {i}" friction="{scene.mu_finger} {scene.mu_finger} 0 0 0"'
                f" {_FINGER_CONTACT}/>"
            )
        return f"""
        <mujoco>
          <option timestep="{self.dt}" cone="{self.cone}" impratio="{self.impratio}"/>
          <default><geom contype="0" conaffinity="0"/></default>
          <asset>{"".join(meshes)}</asset>
          <worldbody>
            <geom name="table" type="plane" size="20 20 1"/>
            <body pos="0 0 {_HALF_HEIGHT}">
              <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
              <geom name="finger" type="sphere" size="{scene.finger_radius}" mass="{_FINGER_MASS}"/>
            </body>
            <body pos="0 0 {_HALF_HEIGHT}"><freejoint name="free"/>{"".join(cells + sides)}</body>
          </worldbody>
          <contact>{"".join(pairs)}</contact>
        </mujoco>"""
