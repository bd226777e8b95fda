"""`slipmap fit`: a belief about the object and about effects that are added to its model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.commands.identify import keep, show, tell_files
from slipmap.diagrams.application.outputs import make_folder
from slipmap.diagrams.application.terminal import Progress, paragraph, prepare_kernels
from slipmap.models.files import write_json

if TYPE_CHECKING:
    from slipmap.models.inference.results import Identification


@click.command()
@options.dataset_argument
@options.effect_option(required=True, purpose="Effect to add to the model")
@options.effect_file_option
@options.belief_output_option
@options.hypotheses_option
@options.seed_option
@options.object_option
@options.pictures_option
@options.json_option
def fit(
    dataset: Path,
    effect_names: tuple[str, ...],
    effect_files: tuple[Path, ...],
    output: Path,
    hypotheses: int,
    seed: int,
    object_name: str | None,
    pictures: Path | None,
    json_file: Path | None,
) -> None:
    """Learn maps of mass and friction together with effects.

    Adds the effects that you name, of the library or of your own files, to the model and learns their
    parameters and the maps at the same time from the pushes of DATASET with the role `fit`; `heldout`
    pushes only judge. `slipmap diagnose` says which effects are worth adding.

    Writes a belief that `predict` and `compare` take, and the same pictures as `identify`; prints how well it
    predicts beside a model without the effects that was learnt alike.
    """
    from slipmap.models.effects.registry import effects_named

    effects = effects_named(effect_names, options.find_effects(effect_files))
    with Progress() as progress:
        measured = options.load_dataset(dataset, object_name, progress)
        if pictures is not None:
            make_folder(pictures)
        prepare_kernels()
        from slipmap.models.inference.diagnosis.effect_fit import fit_effects

        result = fit_effects(measured, effects, hypotheses=hypotheses, seed=seed, progress=progress)
        plain = fit_effects(
            measured, (), hypotheses=hypotheses, seed=seed, progress=progress.about("without effects")
        )
        drawn = keep(result, measured, output, pictures, progress)
    if json_file is not None:
        more = {"effects": effect_estimates(result), "without_effects": _errors(plain)}
        write_json(json_file, {**result.to_json(), **more})
    show(result, measured)
    show_effects(result)
    _show_gain(result, plain)
    tell_files(output, drawn)


def effect_estimates(result: Identification) -> dict[str, dict[str, Any]]:
    """By effect of the model and parameter: value (median), 90 % interval, unit, whether pushes show it."""
    facts = {quantity.name: quantity for quantity in result.quantities}
    return {
        effect.name: {
            p.name: {
                key: getattr(facts[f"{effect.name}: {p.name}"], key)
                for key in ("value", "low", "high", "unit", "shown")
            }
            for p in effect.parameters
        }
        for effect in result.belief.effects
    }


def _errors(result: Identification) -> dict[str, float | None]:
    """Mean errors at the end of the pushes of each role, m; None where there are none."""
    errors = {role: result.errors(role) for role in ("fit", "heldout")}
    return {f"{role}_error_mean": float(of.mean()) if len(of) else None for role, of in errors.items()}


def _show_gain(result: Identification, plain: Identification) -> None:
    from slipmap.diagrams.application.reports.comparison_words import millimetres
    from slipmap.diagrams.application.reports.tables import HARDLY_BETTER

    role, pushes = ("heldout", "Held-out pushes")
    if not len(result.errors(role)):
        role, pushes = ("fit", "The pushes that it learned from")
    now, before = (float(learnt.errors(role).mean()) for learnt in (result, plain))
    effects = " and ".join(effect.name for effect in result.belief.effects)
    doubt = f" SO THEY DO NOT SPEAK FOR {effects}: its size holds only if it is there at all."
    paragraph(
        f"{pushes} end {millimetres(now)} mm from where they were predicted; without effects, learnt alike,"
        f" {millimetres(before)} mm.{doubt if now > HARDLY_BETTER * before else ''}"
    )


def show_effects(result: Identification) -> None:
    """Print how large the effects of the model are, each in a sentence."""
    from slipmap.diagrams.application.reports.effect_words import effect_in_words
    from slipmap.models.inference.diagnosis.results import ParameterEstimate

    told = effect_estimates(result)
    for effect in result.belief.effects:
        estimates = [
            ParameterEstimate(effect.name, name, v["unit"], v["value"], v["low"], v["high"])
            for name, v in told[effect.name].items()
        ]
        paragraph(f"{effect.name}: {effect_in_words(effect.name, estimates, result.belief.grid)}.")
