"""Small files that the recorded commands read, whole ones and faulty ones."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np

EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "examples" / "magnet.py"

DATASET = "format: push-dataset/1\nobject: [1\nb: }"
SCENARIO = "table:\n  wide: 2.0\n"
EFFECT = "import sympy\n\nraise ValueError('oh')\n"


def write_inputs(folder: Path) -> None:
    """Write all of them to an empty folder."""
    shutil.copy(EXAMPLE, folder / "magnet.py")
    (folder / "broken").mkdir()
    (folder / "broken" / "dataset.yaml").write_text(DATASET, encoding="utf-8")
    (folder / "formless").mkdir()
    (folder / "formless" / "dataset.yaml").write_text("name: thing\n", encoding="utf-8")
    (folder / "taken" / "pushes").mkdir(parents=True)
    (folder / "taken" / "pushes" / "thesis.txt").write_text("years of work", encoding="utf-8")
    (folder / "push.csv").write_text("t,object_x\n", encoding="utf-8")
    (folder / "block.csv").write_text(_pushed_block(), encoding="utf-8")
    (folder / "bad.npz").write_bytes(b"no belief")
    (folder / "bad.lcmlog").write_bytes(b"no log")
    (folder / "cell.yaml").write_text(SCENARIO, encoding="utf-8")
    (folder / "bad_effect.py").write_text(EFFECT, encoding="utf-8")
    (folder / "block.stl").write_text(_box(120, 60, 20), encoding="utf-8")
    cv2.imwrite(str(folder / "photo.png"), _photo())


def _pushed_block() -> str:
    """A block's push straight on: 20 mm of way to it, then 40 mm with it."""
    rows = ["t,object_x,object_y,object_theta,tip_x,tip_y"]
    for step in range(61):
        tip = -0.026 + 0.001 * step
        rows.append(f"{0.02 * step:.2f},{max(0.0, tip + 0.006):.6f},0,0,{tip:.6f},0.03")
    return "\n".join(rows) + "\n"


def _box(length: float, width: float, height: float) -> str:
    """A box from the origin on, as a text STL."""
    corners = np.array([[x, y, z] for x in (0, length) for y in (0, width) for z in (0, height)])
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    lines = ["solid box"]
    for a, b, c, d in sides:
        for triangle in ((a, b, c), (a, c, d)):
            lines += ["facet normal 0 0 0", "outer loop"]
            lines += ["vertex {:g} {:g} {:g}".format(*corners[corner]) for corner in triangle]
            lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid box", ""])


def _photo() -> np.ndarray:
    """A bracket of two labels, from above."""
    labels = np.zeros((60, 100), np.uint8)
    labels[10:40, 20:80] = 1
    labels[10:20, 20:40] = 2
    return labels
