"""Draw how the prediction error falls with each push that is learned from.

slipmap demo
python docs/examples/falling_error.py simulated-demo/pushes falling-error.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from slipmap import identify, read_dataset, save
from slipmap.diagrams.systems.look import BELIEF, FAINT, styled


@styled
def falling_error_figure(name: str, errors: dict[int, np.ndarray], resting: float, uniform: float) -> Figure:
    """Plot errors (mm) of the held-out pushes by the number of pushes learned from, beside two baselines."""
    counts = list(errors)
    figure = Figure(figsize=(6.4, 3.0), layout="constrained")
    axes = figure.subplots()
    axes.set_title(
        f"{name}: how far off {len(errors[counts[0]])} further pushes are predicted to end", loc="left"
    )
    for level, label, beside, side in (
        (resting, "it stays where it is", 1.06, "bottom"),
        (uniform, "a uniform object", 0.9, "top"),
    ):
        axes.axhline(level, color=FAINT, linewidth=1.0, linestyle="--")
        axes.text(counts[-1] + 0.35, level * beside, label, ha="right", va=side, fontsize=8)
    for count, each in errors.items():
        axes.plot(
            np.full(len(each), count), each, "o", color=BELIEF, alpha=0.35, markersize=5, markeredgewidth=0
        )
    axes.plot(
        counts, [each.mean() for each in errors.values()], "-o", color=BELIEF, linewidth=1.8, markersize=6
    )
    axes.set(yscale="log", xticks=counts, xlim=(counts[0] - 0.4, counts[-1] + 0.4))
    axes.set_yticks([1, 3, 10, 30, 100], ["1", "3", "10", "30", "100"])
    axes.minorticks_off()
    axes.set(xlabel="pushes learned from", ylabel="error at the end, mm")
    return figure


def main(folder: str, picture: str) -> None:
    dataset = read_dataset(folder)
    found = {
        count: identify(dataset.with_fit_pushes(count), seed=0, friction_laws=False)
        for count in range(1, len(dataset.fit_trials) + 1)
    }
    errors = {count: 1e3 * result.errors("heldout") for count, result in found.items()}
    last = found[max(found)]
    resting, uniform = (
        1e3 * last.errors("heldout", name).mean() for name in ("no_motion_add", "uniform_add")
    )
    save(falling_error_figure(dataset.name, errors, resting, uniform), Path(picture))


if __name__ == "__main__":
    main(*sys.argv[1:])
