"""A bar that a finger pushes along x, as tables of whatever form a test wants."""

from __future__ import annotations

import numpy as np

SETUP = """
object: {outline: [[-0.03, -0.02], [0.03, -0.02], [0.03, 0.02], [-0.03, 0.02]]}
finger: {radius: 0.005}
"""
TIME = 0.01 * np.arange(150)
WAY = 0.06 * np.clip(TIME - 0.3, 0.0, 0.9)  # of the finger, m
POSE = np.column_stack([np.maximum(WAY - 0.01, 0.0), 0.0 * TIME, 0.0 * TIME])
TIP = np.column_stack([WAY - 0.045, 0.0 * TIME])


def written(path, names, columns, sign=",", form="{:.6f}"):
    rows = np.column_stack(columns)
    lines = [sign.join(names), *(sign.join(form.format(cell) for cell in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path
