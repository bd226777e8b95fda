"""How well `identify` predicts on recorded and simulated pushes: the table of docs/lab/accuracy.md.

    python tests/models/inference/accuracy_study.py DATA NUMBERS.json [--before OTHER.json] [--page PAGE.md]

DATA is a folder with the datasets named below; those that it lacks are left out. With --page the numbers are
written as a page, beside those of another version where --before has them.
"""

from __future__ import annotations

import argparse
import csv
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

import slipmap

FIVE_PUSHES = ("bullet/book_p9", "bullet/box_p0", "bullet/hammer_p0")
WHOLE = ("real/cpush_square", "real/mcube_steel", "real/mit_abs_rect1", "effects/public-none")
SEED = 0

_LAWS = ("quartic", "quadratic")


def measured(folder: Path, pushes: int | None = None) -> dict[str, Any]:
    """Errors of held-out ends of a dataset, mm and deg, whether intervals hold them, and the time it took."""
    dataset = slipmap.read_dataset(folder)
    if pushes is not None:
        dataset = dataset.with_fit_pushes(pushes)
    started = time.perf_counter()
    result = slipmap.identify(dataset, seed=SEED)
    seconds = time.perf_counter() - started
    held = [push for push in result.pushes if push.role == "heldout"]
    off = np.array([push.predicted[-1] - push.measured[-1] for push in held])
    numbers = {
        "add": 1e3 * float(result.errors("heldout").mean()),
        "median": 1e3 * float(np.median(result.errors("heldout"))),
        "displacement": 1e3 * float(np.hypot(off[:, 0], off[:, 1]).mean()),
        "yaw": float(np.degrees(np.abs(off[:, 2])).mean()),
        "seconds": seconds,
    }
    if hasattr(held[0], "end_interval"):
        ends = np.array([push.measured[-1] for push in held])
        low, high = np.array([push.end_interval for push in held]).transpose(1, 0, 2)
        numbers["held"] = float(((low < ends) & (ends < high)).mean())
    published = folder / "zhou.csv"
    if published.is_file():
        rows = [row for row in csv.DictReader(published.open()) if row["role"] == "heldout"]
        for law in _LAWS:
            for unit in ("mm", "deg"):
                errors = [float(row[f"{law}_error_{unit}"]) for row in rows if row[f"{law}_error_{unit}"]]
                numbers[f"{law}_{unit}"] = float(np.mean(errors))
    return numbers


def study(data: Path) -> dict[str, dict[str, Any]]:
    """Numbers by dataset."""
    pushes = {name: 5 for name in FIVE_PUSHES} | dict.fromkeys(WHOLE)
    pushes |= {f"real_mit/{path.parent.name}": None for path in sorted(data.glob("real_mit/*/zhou.csv"))}
    found = {}
    for name, count in pushes.items():
        if (data / name).is_dir():
            found[name] = measured(data / name, count)
            print(f"{name}: {found[name]['add']:.2f} mm, {found[name]['seconds']:.1f} s", flush=True)
    return found


def page(now: dict[str, Any], before: dict[str, Any]) -> str:
    """The study as a page."""
    kinds = {"simulated and recorded": [n for n in now if not n.startswith("real_mit")]}
    lines = [
        "# Accuracy of `identify` on held-out pushes",
        "",
        "Made by `python tests/models/inference/accuracy_study.py DATA NUMBERS.json --page PAGE.md`:",
        "seed 0, default settings, Bullet's sets from their first five fit pushes. `held` is the share of",
        "held-out ends (x, y, θ separately) inside their 90 % intervals. Brackets, if any, give the previous",
        "version. Times are from a busy machine.",
        "",
        "| dataset | mean ADD, mm | median, mm | held | seconds |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name in kinds["simulated and recorded"]:
        one, old = now[name], before.get(name, {})
        numbers = [_beside(one, old, key, 2) for key in ("add", "median")]
        lines.append(
            f"| {name} | {numbers[0]} | {numbers[1]} | {100 * one['held']:.0f} % |"
            f" {_beside(one, old, 'seconds', 1)} |"
        )
    mit = [name for name in now if name.startswith("real_mit")]
    if mit:
        lines += [
            "",
            "Single pushes of the MIT dataset: displacement of the object frame's origin and yaw at the end,",
            "compared with the published quartic and quadratic force-motion models on the same pushes.",
            "",
            "| dataset | displacement, mm | yaw, deg | quartic | quadratic | held | seconds |",
            "| --- | --- | --- | --- | --- | --- | --- |",
        ]
        keys = [key for key in now[mit[0]] if key != "median"]
        mean = {key: float(np.mean([now[name][key] for name in mit])) for key in keys}
        old_mean = {
            key: float(np.mean([before[name][key] for name in mit]))
            for key in keys
            if all(key in before.get(name, {}) for name in mit)
        }
        rows = [(name, now[name], before.get(name, {})) for name in mit]
        for name, one, old in [*rows, (f"mean of {len(mit)}", mean, old_mean)]:
            quartic, quadratic = (f"{one[law + '_mm']:.2f}, {one[law + '_deg']:.2f}" for law in _LAWS)
            lines.append(
                f"| {name.removeprefix('real_mit/')} | {_beside(one, old, 'displacement', 2)} |"
                f" {_beside(one, old, 'yaw', 2)} | {quartic} | {quadratic} |"
                f" {100 * one['held']:.0f} % | {_beside(one, old, 'seconds', 1)} |"
            )
    return "\n".join([*lines, ""])


def _beside(now: dict[str, Any], before: dict[str, Any], key: str, digits: int) -> str:
    old = f" ({before[key]:.{digits}f})" if key in before else ""
    return f"{now[key]:.{digits}f}{old}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("numbers", type=Path)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--page", type=Path)
    given = parser.parse_args()
    if not given.numbers.is_file():
        given.numbers.write_text(json.dumps(study(given.data), indent=1))
    if given.page is not None:
        told = json.loads(given.before.read_text()) if given.before else {}
        given.page.write_text(page(json.loads(given.numbers.read_text()), told))
