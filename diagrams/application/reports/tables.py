"""Tables on the terminal of what an identification, a prediction or a comparison found."""

from collections.abc import Mapping, Sequence

import click
import numpy as np

from slipmap.diagrams.application.reports import comparison_words as phrases
from slipmap.diagrams.application.terminal import paragraph, table
from slipmap.models.effects.effect import Effect
from slipmap.models.inference.comparison import Comparison, JointComparison
from slipmap.models.inference.end_region import beyond_in_millimetres
from slipmap.models.inference.error_model import sensor_noise
from slipmap.models.inference.friction_laws import PLAIN, TOGETHER
from slipmap.models.inference.prediction import Prediction
from slipmap.models.inference.push_errors import Errors, NoiseFloor, pose_floor
from slipmap.models.inference.results import Quantity
from slipmap.models.measurements import PushDataset

_SENSITIVE = 10.0
"""Displacement of the end per displacement of the start, from which a push is called sensitive."""

HARDLY_BETTER = 0.8

_MOST_ROWS = 30
_FEW_PATTERNS = 5
_MEASURES = ("final_add", "uniform_add", "no_motion_add")
_SHOWN_UNITS = {"m": ("mm", 1e3), "-": ("", 1.0)}
_LAW_WORDS = {
    PLAIN: "plain (each cell carries its own weight)",
    "load_transfer": "load_transfer (pushing shifts load between cells)",
    "impulse_friction": "impulse_friction (friction along x and y solved as impulses, as in simulators)",
}
"""Laws of `slipmap.models.inference.friction_laws` with at most one effect, in words."""


def show_errors(
    pushes: Sequence[Prediction], dataset: PushDataset, where: str | None, effects: Sequence[Effect] = ()
) -> None:
    """Print errors of predicted ends by role beside two baselines, then push by push, with doubts.

    Args:
        where: the dataset as a command takes it; None where the caller prints surprising pushes itself.
        effects: of the belief, which the uniform object has, too.
    """
    # Otherwise its error seems to be that of a plain model.
    same = f"; the uniform object has {', '.join(effect.name for effect in effects)}, too" if effects else ""
    rows = []
    for role, name in phrases.ROLES.items():
        group = [push for push in pushes if push.role == role]
        for label, average in (("mean", np.mean), ("median", np.median)):
            if group:
                numbers = [average([getattr(push, of) for push in group]) for of in _MEASURES]
                rows.append([f"{len(group)} {name}", label, *map(_millimetres, numbers)])
    table(
        f"Error at the end of a push, mm (ADD: mean distance of the cells{same})",
        ["pushes", "", "this belief", "uniform object", "object does not move"],
        rows,
        numbers=(2, 3, 4),
    )
    _show_pushes(pushes)
    for doubt in doubts(pushes, dataset):
        paragraph(doubt)
    if where is not None:
        _show_too_few_judges(pushes, where)
        show_surprises(pushes, where)


def _show_too_few_judges(pushes: Sequence[Prediction], where: str) -> None:
    """Say what one or two held-out pushes hint at, on which `doubts` says nothing."""
    held = [push for push in pushes if push.role == "heldout"]
    error, uniform = (sum(getattr(push, of) for push in held) for of in _MEASURES[:2])
    surprising = phrases.surprises(held).beyond_chance
    if len(held) < phrases.FEWEST_JUDGES and error > HARDLY_BETTER * uniform and not surprising:
        ends, few = "The held-out push ends", "one is"
        if len(held) > 1:
            ends, few = "Held-out pushes end", "they are"
        paragraph(
            f"{ends} {1e3 * error / len(held):.1f} mm off (a uniform object:"
            f" {1e3 * uniform / len(held):.1f} mm); {few} too few to tell whether the model fails."
            f" `slipmap diagnose {where}` weighs all pushes."
        )


def show_surprises(pushes: Sequence[Prediction], where: str, whose: str = "its") -> bool:
    """Print which held-out pushes (all where none is held out) ended outside their intervals.

    Args:
        whose: prediction it is, as in `surprises`.

    Returns:
        Whether they are more, or farther out, than chance explains.
    """
    held = [push for push in pushes if push.role == "heldout"]
    found = phrases.surprises(held or pushes, whose)
    if found.text:
        paragraph(f"{found.text} {phrases.advice(where)}" if found.beyond_chance else found.text)
    return found.beyond_chance


def is_doubted(pushes: Sequence[Prediction], dataset: PushDataset) -> bool:
    """Whether held-out pushes end much farther off than the belief allows, see `doubts`."""
    held = [push for push in pushes if push.role == "heldout"]
    return len(held) >= phrases.FEWEST_JUDGES and bool(phrases.beyond_spread(held, _floor(dataset)))


def _floor(dataset: PushDataset) -> NoiseFloor | None:
    return pose_floor(sensor_noise(dataset), dataset.grid)


def show_friction_laws(shares: Mapping[str, float]) -> None:
    """Print the probabilities of the laws of friction, unless the plain law is the only one."""
    if not set(shares) - {PLAIN}:
        return
    words = [f"{100 * share:.0f} % {_law_in_words(name)}" for name, share in shares.items()]
    paragraph(
        f"Probabilities of the laws of friction after these pushes: {'; '.join(words)}. `slipmap effects"
        " NAME` explains an effect."
    )
    click.echo()


def _law_in_words(name: str) -> str:
    effects = name.split(TOGETHER)
    return _LAW_WORDS[name] if len(effects) == 1 else f"{' and '.join(effects)} together"


def doubts(pushes: Sequence[Prediction], dataset: PushDataset) -> list[str]:
    """Doubts that held-out pushes cast on a belief: errors far beyond its spread and the sensors' noise, or
    hardly smaller than those of a uniform object."""
    held = [push for push in pushes if push.role == "heldout"]
    if len(held) < phrases.FEWEST_JUDGES:
        return []
    errors = np.array([push.final_add for push in held])
    beyond = phrases.beyond_spread(held, _floor(dataset))
    found = [beyond] if beyond else []
    uniform = float(np.mean([push.uniform_add for push in held]))
    if errors.mean() > HARDLY_BETTER * uniform:
        numbers = f"({1e3 * uniform:.1f} mm; the belief {1e3 * errors.mean():.1f} mm)"
        fitted = [push for push in pushes if push.role == "fit"]
        better_fitted = sum(p.final_add for p in fitted) < HARDLY_BETTER * sum(p.uniform_add for p in fitted)
        if errors.mean() > uniform and better_fitted:
            found.append(
                f"A uniform object predicts held-out pushes better {numbers}, though not the fitted ones: the"
                " maps explain what they were fitted to and little else. `slipmap compare` shows where the"
                " model fails."
            )
        else:
            found.append(
                "Held-out pushes hardly test the maps: a uniform object predicts them about as well"
                f" {numbers}."
            )
    return found


def _show_pushes(pushes: Sequence[Prediction]) -> None:
    shown = list(pushes)
    if len(shown) > _MOST_ROWS:
        shown = sorted(pushes, key=lambda push: -push.final_add)[:_MOST_ROWS]
    rows = [
        [
            phrases.short_name(push.trial),
            phrases.ROLES[push.role],
            _ended_and_allowed(push)[0],
            *map(_millimetres, (push.spread, push.uniform_add, push.no_motion_add)),
            remark(push),
        ]
        for push in shown
    ]
    worst = f"The {len(shown)} worst of {len(pushes)} pushes (--json writes all)"
    title = worst if len(shown) < len(pushes) else "Push by push"
    table(
        f"{title}, mm (spread: of the hypotheses)",
        ["push", "role", "error", "spread", "uniform", "no motion", "remark"],
        rows,
        numbers=(2, 3, 4, 5),
    )


def _ended_and_allowed(push: Prediction) -> tuple[str, str]:
    """Error at the end and largest that would not surprise, mm; more digits where tenths hide a surprise."""
    error, allowed = _millimetres(push.final_add), _millimetres(push.allowed_add)
    if push.surprising and float(error) <= float(allowed):
        return beyond_in_millimetres(push.final_add, push.allowed_add)
    return error, allowed


def remark(push: Prediction) -> str:
    """Remark on a push that ended outside its interval or is sensitive to its start; empty for others."""
    said = []
    if push.surprising:
        said.append(f"SURPRISING: at most {_ended_and_allowed(push)[1]} mm expected")
    if push.start_sensitivity >= _SENSITIVE:
        said.append(f"sensitive: 0.5 mm at the start moves the end by {0.5 * push.start_sensitivity:.0f} mm")
    return "; ".join(said)


def show_comparison(results: Sequence[Comparison]) -> None:
    """Print mean errors by role beside the baselines, and what the residuals depend on."""
    first, rows = results[0], []
    for role, totals in first.totals.items():
        models = [(result.label, result.totals[role].model) for result in results]
        for name, errors in (*models, ("uniform", totals.uniform), ("no motion", totals.resting)):
            rows.append([f"{phrases.ROLES[role]}, {name}", *_errors(errors)])
    floor = ""
    if first.floor is not None:
        floor = f"; noise floor {phrases.millimetres(first.floor.add)} mm ({first.floor.source})"
    table(
        f"Mean errors, mm (end, average: ADD, mean distance of cells){floor}",
        ["pushes", "end", "average", "position", "angle, °", "fit, %", "force, %"],
        rows,
        numbers=range(1, 7),
    )
    for result in results:
        _show_patterns(result, f", {result.label}" if len(results) > 1 else "")


def joint_rows(found: JointComparison) -> tuple[list[str], list[list[str]]]:
    """Columns and rows of a table of several datasets: errors at the end, mm, on the pushes that judge."""
    labels = [one.label for one in found.datasets[0]]
    rows = []
    for models in found.datasets:
        role, totals = phrases.judged(models[0])
        errors = [phrases.judged(one)[1].model for one in models]
        rows.append(
            [
                models[0].dataset,
                f"{totals.pushes} {phrases.ROLES[role]}",
                *(phrases.millimetres(e.final_add) for e in (*errors, totals.uniform, totals.resting)),
                str(len(models[-1].significant)),
            ]
        )
    return ["dataset", "pushes", *labels, "uniform", "no motion", "patterns"], rows


def show_joint_comparison(found: JointComparison) -> None:
    """Print the mean errors of each dataset, and how many patterns its remaining error has."""
    columns, rows = joint_rows(found)
    table(
        "Mean error at the end of the pushes that judge, mm (ADD: mean distance of the cells), and number of"
        " significant patterns of the remaining error",
        columns,
        rows,
        numbers=range(2, len(columns)),
    )


def _show_patterns(result: Comparison, head: str) -> None:
    if not result.structure:
        return
    shown = [
        pattern for k, pattern in enumerate(result.structure) if k < _FEW_PATTERNS or pattern.significant
    ]
    tests = len(result.structure)
    table(
        f"What the remaining error depends on{head}: strongest of {tests} tests (* significant)",
        ["error in", "depends on", "size", "p, all tests"],
        [
            [
                phrases.QUANTITIES[pattern.quantity],
                f"{pattern.title}: {pattern.strongest}",
                phrases.size_text(pattern).split(" (")[0],
                phrases.p_text(pattern.p_corrected) + ("*" if pattern.significant else " "),
            ]
            for pattern in shown
        ],
        numbers=(2, 3),
    )


def _errors(errors: Errors) -> list[str]:
    numbers = [phrases.millimetres(errors.final_add), phrases.average(errors)]
    numbers += [phrases.millimetres(errors.position)]
    others = (float(np.degrees(errors.angle)), errors.fit, 100 * errors.force_share)
    return numbers + [f"{value:.1f}" if np.isfinite(value) else "–" for value in others]


def show_quantities(quantities: Sequence[Quantity], *, doubted: bool) -> None:
    """Print value, 90 % interval and reason: first what the pushes show, then what they leave open.

    Args:
        doubted: whether the predictions are too far off, see `is_doubted`.
    """
    criterion = "interval under half as wide as without them, or, of an effect, excluding its zero"
    condition = "IF THE MODEL WERE RIGHT, shown" if doubted else "Shown"
    for by_pushes, title in (
        (True, f"{condition} by these pushes ({criterion}), or given"),
        (False, "Left open by these pushes: the prior decides"),
    ):
        rows = [
            [named(quantity), *shown(quantity, quantity.value), quantity.reason]
            for quantity in quantities
            if bool(quantity.shown) is by_pushes
        ]
        if rows:
            table(title, ["quantity", "value", "90 % interval", "why"], rows, numbers=(1, 2))


def named(quantity: Quantity) -> str:
    """Name of a quantity, with the unit in which `shown` gives its numbers."""
    unit, _ = _SHOWN_UNITS.get(quantity.unit, (quantity.unit, 1.0))
    return f"{quantity.name}, {unit}" if unit else quantity.name


def shown(quantity: Quantity, *values: float) -> tuple[str, ...]:
    """Values of a quantity (SI) and its interval last, see `Quantity.numbers`."""
    _, factor = _SHOWN_UNITS.get(quantity.unit, (quantity.unit, 1.0))
    *numbers, low, high = quantity.numbers(*values, factor=factor)
    return (*numbers, f"{low} to {high}")


def _millimetres(metres: float) -> str:
    return f"{1e3 * metres:.1f}"
