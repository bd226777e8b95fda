"""The pushes that `slipmap example` writes, made from slipmap's own simulation.

`python tests/diagrams/application/make_tilted_block.py` writes diagrams/application/tilted_block anew.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import slipmap

FOLDER = Path(__file__).resolve().parents[3] / "diagrams" / "application" / "tilted_block"
SEED = 3
TILT = (0.05, -0.03)
"""Slopes of the table along x and y, rad: 3.34°, downhill towards -31.0°."""

FINGER_RADIUS = 0.006
OUTLINE = 1e-3 * np.array([[-60, -40], [60, -40], [60, 0], [0, 0], [0, 40], [-60, 40]])
DIGITS = {"object_pose": [5, 5, 4], "tip_pose": [5, 5], "ft_wrench": [3, 3, 5]}
"""Decimals that are kept of each column, SI; the sensors' noise is ten times as large and more."""


def simulated() -> slipmap.PushDataset:
    """An L of 18 cells, its short leg twice as heavy, pushed twelve times on a table that is not level."""
    grid = slipmap.cells_from_polygon(OUTLINE, width=0.02)
    mass = np.where(grid.centers[:, 0] > 0, 0.06, 0.03)
    truth = slipmap.Maps(mass[None], np.full((1, len(grid)), 0.3), np.array([0.25]), np.array([TILT]))
    slider = slipmap.Slider(grid, FINGER_RADIUS, effects=slipmap.effects_named(["table_tilt"]))
    rng = np.random.default_rng(SEED)
    candidates = slipmap.candidate_pushes(
        grid, FINGER_RADIUS, rng, 12, length=(0.05, 0.1), speed=(0.03, 0.08), approach=0.02
    )
    pushes = [
        candidate.push([*rng.uniform(-0.35, 0.35, 2), rng.uniform(-np.pi, np.pi)], h=2e-3, rest=0.3)
        for candidate in candidates
    ]
    made = slipmap.record_pushes(
        slider, truth, pushes, rng, heldout=4, rate=30.0, mass=float(mass.sum()),
        name="tilted block", description="Simulated: a block, pushed twelve times. Something is hidden.",
    )  # fmt: skip
    return replace(made, trials=tuple(_as_shipped(trial) for trial in made.trials))


def _as_shipped(trial: slipmap.Trial) -> slipmap.Trial:
    """Numbers with the digits that a sensor would have, in files without a folder of their own."""
    rounded = {
        name: replace(
            channel,
            time=channel.time.round(4),
            values=np.column_stack(
                [column.round(digits) for column, digits in zip(channel.values.T, DIGITS[name], strict=True)]
            ),
        )
        for name, channel in trial.channels.items()
    }
    return replace(trial, name=Path(trial.name).name, **rounded)


if __name__ == "__main__":
    slipmap.write_dataset(simulated(), FOLDER, overwrite=True)
