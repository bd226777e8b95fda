"""Odd cells, and how exploring them ends: `python -m tests.diagrams.odd_scenarios FOLDER [NAME...]`.

Each is explored with one push and small pictures, in a process of its own. It must end in a result, for which
the finger touched the object, or in one sentence that names the cause. Those of REFUSED can be known before
anything is simulated, and are tests as well (`tests/diagrams/station/test_odd_cells.py`).
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
import yaml
from numpy.typing import NDArray
from shapely.geometry import Polygon

from slipmap.models.measurements import read_dataset
from slipmap.models.objects.meshes import lofted

BLOCK = {"mesh": "block.stl", "mass": 0.6, "mu": 0.3}
SMALL: dict[str, Any] = {
    "camera": {"width": 480, "height_pixels": 360, "rate": 5.0},
    "simulation": {"time_step": 0.005},
}
LONGEST = 400.0
"""s after which a scenario counts as one that hangs."""


def block(**other: Any) -> dict[str, Any]:
    """A scenario whose object is the block with other values."""
    return {"object": BLOCK | other}


def shape(name: str, **other: Any) -> dict[str, Any]:
    """A scenario whose object is another mesh."""
    return block(mesh=f"{name}.stl", **other)


def _lobes(corners: int) -> NDArray[np.float64]:
    """(corners, 2) outline of a knob of 0.1 m with nine lobes and 0.1 mm of a scanner's noise, m."""
    turn = np.linspace(0.0, 2 * np.pi, corners, endpoint=False)
    radius = 0.05 + 0.004 * np.sin(9 * turn) + np.random.default_rng(0).normal(0.0, 1e-4, corners)
    return radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])


TRIED: dict[str, dict[str, Any]] = {
    "heavy": block(mass=8.0),
    "light": block(mass=0.005),
    "slippery": block(mu=0.02),
    "rough": block(mu=1.1),
    "moon": {"gravity": 1.62},
    "Jupiter": {"gravity": 24.8},
    "far": block(pose=[0.25, 0.2, 30.0]),
    "turned": block(pose=[0.0, 0.0, 200.0]),
    "narrow table": {"object": BLOCK, "table": {"shape": "rectangle", "size": [0.3, 0.25]}},
    "camera upside down": {"camera": {"yaw": np.pi}},
    "camera low": {"object": BLOCK, "camera": {"height": 0.45}},
    "camera aside": {"object": BLOCK, "camera": {"position": [0.35, 0.1]}},
    "0.5 Hz": {"object": BLOCK, "camera": {"rate": 0.5}},
    "no noise": {
        "depth_noise": {"axial_floor": 0.0, "axial_growth": 0.0, "lateral_jitter": 0.0, "quantum": 0.0}
    },
    "half of the pixels missing": {"object": BLOCK, "depth_noise": {"missing_anywhere": 0.5}},
    "depth in steps of 50 mm": {"object": BLOCK, "depth_noise": {"quantum": 0.05}},
    "finger of 2 mm": {"execution": {"finger_radius": 0.002}},
    "finger of 20 mm": {"execution": {"finger_radius": 0.02}},
    "smooth finger": block(mu_finger=0.0),
    "finger just below the top": {"object": BLOCK, "execution": {"tip_height": 0.035}},
    "steep table": {"object": BLOCK, "hidden": {"table_tilt": {"down_x": 0.2}}},
    "stiff tether": {"object": BLOCK, "hidden": {"tether": {"stiffness": 400.0, "slack": 0.3}}},
    "in honey": {"object": BLOCK, "hidden": {"viscous_friction": {"drag_per_area": 3000.0}}},
    "coarse steps": {"object": BLOCK, "simulation": {"time_step": 0.01}},
    "long rod": shape("rod"),
    "ring": shape("ring"),
    "rough scan": shape("scan"),
    "can": shape("can"),
    "thin": shape("sheet"),
    "small": shape("die"),
    "four cells": block(cells=4),
    "creeping arm": {"object": BLOCK, "execution": {"transit_speed": 0.05}},
    "pokes of 5 mm": {"object": BLOCK, "pokes": {"shortest": 0.005, "longest": 0.005}},
}  # fmt: skip
"""Scenarios that only a run decides, by name."""

REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "out of reach": (
        {
            "object": BLOCK | {"pose": [0.9, 0.2, 0.0]},
            "table": {"radius": 1.5},
            "camera": {"height": 1.3, "fov_y": 1.8},
        },
        "the arm cannot push block at x = 0.9 m, y = 0.2 m",
    ),
    "far from its origin": (shape("far"), "its middle is at x = 10 m, y = 20 m, as object.pose places"),
    "off the table": (block(pose=[0.6, 0.0, 0.0]), "does not lie on the table"),
    "rougher than the table": (block(mu=1.3), "on the table: a friction coefficient of 1.3"),
    "sticky finger": (block(mu_finger=3.0), "at the finger: a friction coefficient of 3"),
    "camera too low": (
        {"object": BLOCK, "camera": {"height": 0.3, "fov_y": 0.3}},
        "not wholly in the picture",
    ),
    "yaw in degrees": ({"camera": {"yaw": 90.0}}, "camera.yaw must lie between -6.2832 and"),
    "camera far aside": ({"camera": {"position": [1.5, 0.0]}}, "not wholly in the picture"),
    "finger over the object": ({"execution": {"tip_height": 0.05}}, "would pass over it"),
    "too high": (shape("tower"), "the finger passes over objects of at most"),
    "too thin": (shape("foil"), "mm high"),
    "too small": (shape("grain"), "cm²"),
    "slides off": (block(mu=0.1) | {"hidden": {"table_tilt": {"down_x": 0.2}}}, "slides off by itself"),
    "pulled away": (
        {"object": BLOCK, "hidden": {"tether": {"stiffness": 400.0}}},
        "the tether pulls with 120 N, but friction only holds up to",
    ),
    "in millimetres": (shape("block_mm"), "0.001"),
    "too heavy to be moved": (block(mass=150.0, mu=0.6), "takes 883 N to slide"),
    "under the arm": (block(pose=[-0.4, 0.0, 0.0]), "beside the arm at home"),
    "small table": ({"object": BLOCK, "table": {"radius": 0.12}}, "of the picture; 2 % are needed"),
    "camera far": ({"object": BLOCK, "camera": {"height": 3.5}}, "depth scatters by 12.7 mm"),
    "camera far, without noise": (
        {
            "object": BLOCK,
            "camera": {"height": 3.8},
            "depth_noise": {"axial_growth": 0.0},
            "table": {"radius": 0.2},
        },
        "of the picture; 2 % are needed",
    ),
    "0.1 Hz": ({"object": BLOCK, "camera": {"rate": 0.1}}, "take 150 s"),
    "20 mm of noise": ({"object": BLOCK, "depth_noise": {"axial_floor": 0.02}}, "depth scatters by 21.2 mm"),
    "5 mm of noise": ({"object": BLOCK, "depth_noise": {"axial_floor": 0.005}}, "depth scatters by 6.2 mm"),
    "blurred": ({"object": BLOCK, "depth_noise": {"lateral_jitter": 6.0}}, "edges scatter by 6 pixels"),
    "no pixel": ({"object": BLOCK, "depth_noise": {"missing_anywhere": 1.0}}, "fill 0.0 % of the picture"),
    "64 by 48 pixels": ({"object": BLOCK, "camera": {"width": 64, "height_pixels": 48}}, "covers 30 pixels"),
    "two tables": ({"table": {"radius": 0.5}}, "table is given in line"),
    "no mass": ({"object": {"mesh": "block.stl", "mu": 0.3}}, "needs mass"),
    "mass of nothing": (block(mass=0.0), "mass must be positive"),
    "no gravity": ({"gravity": 0.0}, "gravity must lie between"),
}
"""Scenarios that are refused at once, by name, and what is said."""

MESHES: dict[str, Any] = {
    "block": lambda: trimesh.creation.box((0.15, 0.1, 0.04)),
    "block_mm": lambda: trimesh.creation.box((150, 100, 40)),
    "rod": lambda: trimesh.creation.box((0.6, 0.03, 0.03)),
    "ring": lambda: trimesh.creation.annulus(0.05, 0.07, 0.03),
    "far": lambda: trimesh.creation.box(bounds=[[9.95, 19.95, 0.0], [10.05, 20.05, 0.04]]),
    "scan": lambda: lofted(Polygon(_lobes(1000)), [(0.0, 0.0), (0.0, 0.03)]),
    "can": lambda: trimesh.creation.cylinder(0.04, 0.06),
    "sheet": lambda: trimesh.creation.box((0.2, 0.15, 0.006)),
    "foil": lambda: trimesh.creation.box((0.2, 0.15, 0.001)),
    "die": lambda: trimesh.creation.box((0.025, 0.025, 0.025)),
    "grain": lambda: trimesh.creation.box((0.01, 0.01, 0.01)),
    "tower": lambda: trimesh.creation.box((0.05, 0.05, 0.3)),
}


def written(folder: Path, name: str) -> Path:
    """The scenario's file, with the meshes beside it."""
    for mesh, make in MESHES.items():
        if not (folder / f"{mesh}.stl").exists():
            make().export(folder / f"{mesh}.stl")
    content = TRIED[name] if name in TRIED else REFUSED[name][0]
    whole = {
        key: {**SMALL.get(key, {}), **value} if isinstance(value, dict) else value
        for key, value in content.items()
    }
    path = folder / f"{name.replace(' ', '_')}.yaml"
    text = yaml.safe_dump(SMALL | whole, default_flow_style=None)
    path.write_text(text + ("table: {radius: 0.3}\n" if name == "two tables" else ""), encoding="utf-8")
    return path


def ended(folder: Path, name: str) -> str:
    """Explore a scenario, and say in a line how it ended."""
    out, result = folder / name.replace(" ", "_"), folder / f"{name.replace(' ', '_')}.json"
    command = [sys.executable, "-m", "slipmap", "explore", "--scenario", str(written(folder, name))]
    command += ["--pushes", "1", "--checks", "0", "--output", str(out), "--json", str(result)]
    begin = time.monotonic()
    try:
        run = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST)
    except subprocess.TimeoutExpired:
        return f"HANGS after {LONGEST:.0f} s"
    seconds = time.monotonic() - begin
    if run.returncode:
        last = run.stderr.strip().splitlines()[-1]
        crash = "CRASH " if "Traceback" in run.stderr or "internal" in run.stderr else ""
        return f"{seconds:.0f} s, exit {run.returncode}: {crash}{last}"
    return f"{seconds:.0f} s, {touched(out, result)}"


def touched(out: Path, result: Path) -> str:
    """What the push did, and how far off the belief is."""
    (trial,) = read_dataset(out / "pushes").trials
    way = np.hypot(*(trial.object_pose.values[-1] - trial.object_pose.values[0])[:2])
    force = 0.0 if trial.ft_wrench is None else np.nanmax(np.hypot(*trial.ft_wrench.values[:, :2].T))
    truth = json.loads(result.read_text(encoding="utf-8"))["truth"]
    off = "" if truth is None else f", centre of mass {1e3 * truth['center_of_mass_error']:.0f} mm off"
    return f"moved {1e3 * way:.0f} mm, at most {force:.1f} N{off}"


def main() -> None:
    """Explore the scenarios that are named, or all."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for name in sys.argv[2:] or [*TRIED, *REFUSED]:
        print(f"{name}: {ended(folder, name)}", flush=True)


if __name__ == "__main__":
    main()
