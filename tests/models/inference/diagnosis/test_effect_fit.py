"""Maps and effects learned together, against the truth beside a dataset."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.diagnosis.procedure import diagnose
from slipmap.models.inference.identification import identify
from slipmap.models.measurements import read_dataset


def test_intervals_hold_the_truth(shared_data: Path) -> None:
    folder = shared_data / "effects" / "public-latency"
    truth = yaml.safe_load(folder.with_name("public-latency.truth.yaml").read_text())["object"]
    dataset = read_dataset(folder)
    few = replace(dataset, trials=dataset.trials[:8])
    fitted = identify(few, ["sensor_latency"], hypotheses=10)
    told = {quantity.name: quantity for quantity in fitted.quantities}
    values = {
        "sensor_latency: latency": 0.06,
        "total mass": truth["total_mass"],
        "total friction": 9.81 * float(np.dot(truth["mass"], truth["mu"])),
        "centre of mass, x": truth["com"][0],
        "centre of mass, y": truth["com"][1],
    }
    for quantity, value in values.items():
        assert told[quantity].low < value < told[quantity].high, quantity


def test_sizes_hold_the_truth_where_the_strict_fit_is_too_sure(shared_data: Path) -> None:
    """A tilt is in proportion to the mass, of which forces tell more than they know."""
    dataset = read_dataset(shared_data / "effects" / "public-tilt")
    few = replace(dataset, trials=dataset.trials[:16])
    found = diagnose(few, effects=effects_named(["table_tilt"]), quick=True)
    tilt, direction = 0.05235988, 1.178213
    truth = {"down_x": tilt * np.cos(direction), "down_y": tilt * np.sin(direction)}
    assert found.verdict == "effect"
    sizes = {size.name: size for size in found.candidates[0].parameters}
    for name, value in truth.items():
        assert sizes[name].low < value < sizes[name].high
        assert sizes[name].high - sizes[name].low < 0.85 * tilt
