"""Maps and effects learnt together, against the truth beside a dataset."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from models.effects.registry import effects_named
from models.inference.diagnosis.effect_fit import fit_effects
from models.measurements import read_dataset


def test_intervals_hold_the_truth(shared_data: Path) -> None:
    folder = shared_data / "effects" / "public-latency"
    truth = yaml.safe_load(folder.with_name("public-latency.truth.yaml").read_text())["object"]
    dataset = read_dataset(folder)
    few = replace(dataset, trials=dataset.trials[:8])
    fitted = fit_effects(few, effects_named(["sensor_latency"]), hypotheses=10)
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
