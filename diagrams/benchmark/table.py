"""The benchmark's result as text."""

from __future__ import annotations

from typing import Any


def format_table(result: dict[str, Any]) -> str:
    """Plain text, at most 80 columns wide, of a result of `run_benchmark`."""
    return "\n".join([*_engines(result), "", *_kernel(result), "", *_growth(result)])


def _engines(result: dict[str, Any]) -> list[str]:
    scene = result["scene"]
    lines = [
        "One finger push: {cells} cells, {steps} steps of {ms:g} ms; medians of {repeats}".format(
            ms=1e3 * scene["step"], **scene
        ),
        "",
        f"{'':24}{'ms a rollout':>13}{'ratio':>9}   final x, y (mm), angle (deg)",
    ]
    for engine in result["engines"]:
        x, y, angle = engine["final_pose"]
        lines.append(
            f"{engine['name']:24}{1e3 * engine['seconds']:13.4g}{engine['ratio']:9.3g}"
            f"   {1e3 * x:8.2f}{1e3 * y:8.2f}{57.29577951308232 * angle:9.2f}"
        )
        lines.append(f"  {engine['remark']}")
    lines += [f"{name}: {note}" for name, note in result["missing"].items()]
    lines.append("Processor time of one core, except where wall time is said.")
    return lines


def _kernel(result: dict[str, Any]) -> list[str]:
    kernel = result["kernel"]
    return [
        "Per cell and energy evaluation    {ns_per_cell_evaluation:.3g} ns".format(**kernel),
        "Evaluations a step                {evaluations_per_step:.3g}".format(**kernel),
        "All poses by {columns} parameters      {jacobian_rollouts:.3g} rollouts".format(**kernel),
        f"Largest difference from numpy     {result['numpy_difference']:.1e} (m, rad)",
    ]


def _growth(result: dict[str, Any]) -> list[str]:
    lines = [
        "Growth, on one core",
        f"{'cells':>8}{'steps':>8}{'models':>8}{'ms a rollout':>15}{'ns/cell/eval.':>15}{'peak MiB':>10}",
    ]
    for row in result["growth"]:
        lines.append(
            f"{row['cells']:8}{row['steps']:8}{row['models']:8}{1e3 * row['seconds']:15.4g}"
            f"{row['ns_per_cell_evaluation']:15.3g}{row['peak_mib']:10.0f}"
        )
    return lines
