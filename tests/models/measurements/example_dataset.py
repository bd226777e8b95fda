"""A small push dataset that tests may spoil before it is written and read."""

from __future__ import annotations

import copy
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml


def push_record(speed: float = 0.05, offset: float = 0.01, noise: float = 0.0) -> dict[str, Any]:
    """A finger of 5 mm comes along +x, meets the -x face of a 0.1 m square after 4 mm and takes it along."""
    time = 1000.0 + np.arange(100) * 0.01
    tip_time, force_time = time + 0.003, time[::2] + 0.001
    advance = np.maximum(0.0, speed * (time - time[0]) - 0.004)
    rng = np.random.default_rng(int(1e6 * (speed + offset)))
    pose = np.column_stack([advance, 0.0 * time, 0.2 * advance]) + noise * rng.normal(size=(100, 3))
    tip_x = -0.059 + speed * (tip_time - time[0])
    push = np.interp(force_time, time, (advance > 0).astype(float))
    return {
        "object_pose": np.column_stack([time, pose]).tolist(),
        "tip_pose": np.column_stack([tip_time, tip_x, offset + 0.0 * tip_time, 0.0 * tip_time]).tolist(),
        "ft_wrench": np.column_stack([force_time, 3.0 * push, 0.2 * push, 0.01 * push]).tolist(),
    }


@dataclass
class Example:
    """The document and the records of a dataset, and the folder they go to."""

    folder: Path
    document: dict[str, Any]
    records: dict[str, Any]

    def write(self) -> Path:
        (self.folder / "trials").mkdir(parents=True, exist_ok=True)
        (self.folder / "dataset.yaml").write_text(yaml.safe_dump(self.document), encoding="utf-8")
        for name, record in self.records.items():
            (self.folder / name).write_text(json.dumps(record), encoding="utf-8")
        return self.folder


def example_in(folder: Path) -> Example:
    ticks = [-0.04, -0.02, 0.0, 0.02, 0.04]
    records = {f"trials/{i:03d}.json": push_record(0.05 + 0.01 * i, 0.01 * i) for i in range(3)}
    document = {
        "format": "push-dataset/1",
        "name": "example",
        "description": "a square pushed along +x",
        "object": {
            "outline": [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]],
            "cells": {"width": 0.02, "centers": [[x, y] for x in ticks for y in ticks]},
            "height": 0.03,
            "mass": 1.2,
        },
        "finger": {"radius": 0.005},
        "table": {"shape": "round", "center": [0.0, 0.1], "radius": 0.5},
        "gravity": 9.8,
        "noise": {"position": 0.0002, "angle": 0.002, "tip": 0.0001, "force": 0.05, "outline": 0.0003},
        "trials": [
            {"file": name, "role": "heldout" if name.endswith("2.json") else "fit"} for name in records
        ],
    }
    return Example(folder, document, copy.deepcopy(records))
