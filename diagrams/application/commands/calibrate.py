"""`slipmap calibrate`: are the intervals right? Beliefs about simulated objects against the truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.outputs import write_figures
from slipmap.diagrams.application.terminal import Progress, note, prepare_kernels, table
from slipmap.models.files import write_json

if TYPE_CHECKING:
    from slipmap.planners.calibration import CalibrationResult

_LEVEL = 0.9
_TELLS_NOTHING = 0.3
"""Width of the 95 % range of a share that does not tell right intervals from wrong ones."""


@click.command()
@options.count_option(
    "--objects", most=10_000, default=40, about="Objects to simulate; the more, the sharper the answer."
)
@options.seed_option
@options.picture_option("-o", "--output", about="Picture of the reliability curves (.png, .pdf or .svg).")
@options.json_option
def calibrate(objects: int, seed: int, output: Path | None, json_file: Path | None) -> None:
    """Check that 90 % intervals hold the truth 90 % of the time.

    Draws objects at random, pushes them in simulation, identifies each, and counts how often the truth
    lies inside the belief's 90 % interval. The range behind each count (95 %, Clopper and Pearson) is what
    the true share may be, as so many objects tell it. Takes several seconds an object.
    """
    with Progress() as progress:
        prepare_kernels()
        from slipmap.planners import calibration

        result = calibration.calibrate(objects=objects, seed=seed, progress=progress)
        if output is not None:
            from slipmap.diagrams.application.figures import calibration_figure

            write_figures(output, [calibration_figure(result)])
    rows = coverage_rows(result)
    numbers = {name: getattr(result, name) for name in ("objects", "seed", "seconds", "ranks")}
    write_json(json_file, {**numbers, "level": _LEVEL, "coverage": rows})
    table(
        f"Truths inside the {_LEVEL:.0%} interval, {result.objects} objects in {result.seconds:.0f} s",
        ["quantity", "inside", "of", "share", "95 % range", "verdict"],
        [
            [row["name"], str(row["inside"]), str(row["of"]), f"{row['share']:.0%}",
             f"{row['low']:.0%} to {row['high']:.0%}", row["verdict"]]
            for row in rows
        ],
        numbers=(1, 2, 3, 4),
    )  # fmt: skip
    if output is not None:
        note(f"picture: {output}")


def coverage_rows(result: CalibrationResult) -> list[dict[str, Any]]:
    """Truths inside, with the 95 % range of their share and what it says of the intervals."""
    from scipy.stats import beta

    rows = []
    for name, share in result.coverage.items():
        count = len(result.ranks[name])
        inside = round(share * count)
        # Several pushes of one object are one story: count no more independent draws than objects.
        draws = min(count, result.objects)
        hits = share * draws
        low = float(beta.ppf(0.025, hits, draws - hits + 1)) if inside else 0.0
        high = float(beta.ppf(0.975, hits + 1, draws - hits)) if inside < count else 1.0
        verdict = "too narrow" if high < _LEVEL else "too wide" if low > _LEVEL else "as it should be"
        if verdict == "as it should be" and high - low > _TELLS_NOTHING:
            verdict = "too few objects to tell"
        rows.append(
            {"name": name, "inside": inside, "of": count, "share": share, "low": low, "high": high,
             "verdict": verdict}
        )  # fmt: skip
    return rows
