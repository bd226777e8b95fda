"""`slipmap identify` and `slipmap fit`: from recorded pushes to a belief about mass and friction.

The second adds effects to the model and learns them together with the maps.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.outputs import check_output, make_folder, write_figures
from slipmap.diagrams.application.terminal import (
    Progress,
    counted,
    note,
    paragraph,
    prepare_kernels,
    printable,
)
from slipmap.models.files import BadInput, all_or_nothing, whole_file, write_json

if TYPE_CHECKING:
    from slipmap.models.effects.effect import Effect
    from slipmap.models.inference.prediction import Prediction
    from slipmap.models.inference.results import Identification
    from slipmap.models.measurements import PushDataset
    from slipmap.models.physics.rollout import Maps


_FEWEST_FOR_INTERVALS = 10
"""Hypotheses below which quantiles are hardly more than the two that lie farthest out."""


class _Learning(NamedTuple):
    """Options of `identify` and `fit`: how to learn, and where to write the results."""

    output: Path
    hypotheses: int
    seed: int
    object_name: str | None
    maps: Path | None
    pictures: Path | None
    json_file: Path | None

    def prepare(self) -> None:
        """Make the folder for pictures, and the kernels; warn of intervals from too few hypotheses."""
        if self.hypotheses < _FEWEST_FOR_INTERVALS:
            note(
                f"warning: {self.hypotheses} hypotheses are too few for the 90 % intervals, which may be far"
                f" too narrow or too wide; give --hypotheses {_FEWEST_FOR_INTERVALS} or more"
            )
        if self.pictures is not None:
            make_folder(self.pictures)
        prepare_kernels()


@click.command()
@options.dataset_argument
@options.belief_output_option
@click.option(
    "--method",
    type=click.Choice(["gauss-newton", "paper"]),
    default="gauss-newton",
    show_default=True,
    help="How to find the maps; `paper` is Algorithm 1 of Song and Boularias (2020) as printed.",
)
@click.option(
    "--plain", is_flag=True, help="Consider Coulomb's law of friction only, which takes a third of the time."
)
@options.hypotheses_option
@options.seed_option
@options.count_option("--fit-pushes", about="Learn from the first N fit pushes only.")
@options.object_option
@options.maps_option
@options.pictures_option
@options.json_option
@options.bundled("wanted", _Learning)
def identify(dataset: Path, method: str, plain: bool, fit_pushes: int | None, wanted: _Learning) -> None:
    """Learn maps of mass and friction from recorded pushes.

    DATASET is a folder with a dataset.yaml (push-dataset/1), files of the MIT push dataset (.json, .h5), or
    CSV files. The model learns from pushes with the role `fit`; `heldout` pushes only test it.

    Writes the belief, a picture of its maps (belief.maps.png) and one of the measured and predicted pushes
    (belief.pushes.png). Prints how well the belief predicts and which quantities the pushes determine.
    """

    def learn(measured: PushDataset, **common: Any) -> Identification:
        from slipmap.models.inference import identification

        return identification.identify(measured, method=method, friction_laws=not plain, **common)

    _, measured, drawn = _learned(dataset, wanted, learn, fit_pushes)
    _tell_findings(measured)
    tell_files(wanted.output, drawn)


def _learned(
    dataset: Path, wanted: _Learning, learn: Callable[..., Identification], fit_pushes: int | None = None
) -> tuple[Identification, PushDataset, list[Path]]:
    """Learn from a dataset, write and show the result; returns it with the dataset and its pictures."""
    with Progress() as progress:
        measured = options.load_dataset(dataset, wanted.object_name, progress, wanted.maps)
        if fit_pushes is not None:
            measured = _first_pushes(measured, fit_pushes)
        wanted.prepare()
        result = learn(measured, hypotheses=wanted.hypotheses, seed=wanted.seed, progress=progress)
        with all_or_nothing():
            drawn = keep(result, measured, wanted.output, wanted.pictures, progress)
            write_json(wanted.json_file, result.to_json())
    show(result, measured, options.datasets_typed())
    return result, measured, drawn


def _tell_findings(dataset: PushDataset) -> None:
    """Print the findings of `slipmap check` in two lines."""
    from slipmap.models.measurements.dataset_check import check_dataset

    found = check_dataset(dataset)
    more = f"; `slipmap check {options.datasets_typed()}` says more"
    sound = not any(finding.advice for finding in found.findings)
    note("check: recording is sound" if sound else f"check: {found.headline.rstrip('.')}{more}")
    note(f"check: worth adding: {found.advice[0]}{more}" if found.advice else "check: no pushes to add")


@click.command()
@options.datasets_argument
@options.effect_option(required=True, purpose="Effect to add to the model")
@options.effect_file_option
@options.apart_option
@options.belief_output_option
@options.hypotheses_option
@options.seed_option
@options.object_option
@options.maps_option
@options.pictures_option
@options.json_option
@options.bundled("wanted", _Learning)
def fit(
    datasets: tuple[Path, ...],
    effect_names: tuple[str, ...],
    effect_files: tuple[Path, ...],
    apart: tuple[str, ...],
    wanted: _Learning,
) -> None:
    """Learn maps of mass and friction together with effects.

    Adds the effects that you name, from the library or from your own files, to the model, and learns their
    parameters together with the maps from the pushes of DATASET with the role `fit`; `heldout` pushes only
    test the result. `slipmap diagnose` says which effects are worth adding.

    Writes a belief for `predict` and `compare`, and the same pictures as `identify`. Prints how well it
    predicts with and without the effects, and whether the pushes support them.

    Several datasets, each of one object, share the effects, except those of the object and of what --apart
    names; each object has its own maps. Pushes are locked away as `slipmap diagnose` does, and the belief of
    each object is written to its own file: -o tilt.npz gives tilt.NAME.npz for the dataset NAME.
    """
    from slipmap.models.effects.registry import effects_named

    effects = effects_named(effect_names, options.find_effects(effect_files))
    if len(datasets) > 1:
        _fit_together(datasets, effects, apart, wanted)
        return
    options.refuse_apart(apart)

    def learn(measured: PushDataset, **common: Any) -> Identification:
        from slipmap.models.inference import identification

        return identification.fit(measured, effects, **common)

    result, _, drawn = _learned(datasets[0], wanted, learn)
    show_effects(result)
    _show_gain(result, effects)
    tell_files(wanted.output, drawn)


def _fit_together(
    datasets: Sequence[Path], effects: Sequence[Effect], apart: Sequence[str], wanted: _Learning
) -> None:
    with Progress() as progress:
        measured = options.load_together(datasets, wanted.object_name, progress)
        beliefs = _named_after([dataset.name for dataset in measured], wanted.output)
        wanted.prepare()
        from slipmap.models.inference.diagnosis.several import fit_together

        result = fit_together(
            measured, effects, apart=apart, hypotheses=wanted.hypotheses, seed=wanted.seed, progress=progress
        )
        drawn = []
        with all_or_nothing():
            for learned, dataset, belief in zip(result.learned, measured, beliefs, strict=True):
                drawn.append(keep(learned, dataset, belief, wanted.pictures, progress))
            names = [str(belief) for belief in beliefs]
            write_json(wanted.json_file, {**result.to_json(), "beliefs": names})
    from slipmap.diagrams.application.reports.diagnosis_words import show_joint_fit

    show_joint_fit(result, measured)
    for belief, paths in zip(beliefs, drawn, strict=True):
        tell_files(belief, paths)


def _named_after(names: Sequence[str], output: Path) -> list[Path]:
    """A file beside `output` for each dataset, named after it.

    Raises:
        BadInput: two datasets would share a file, or one cannot be written.
    """
    plain = [re.sub(r"[^\w.-]+", "-", name) for name in names]
    if len(set(plain)) < len(plain):
        raise BadInput(f"the names of the datasets give the same files: {', '.join(names)}; rename one")
    paths = [output.with_name(f"{output.stem}.{name}{output.suffix}") for name in plain]
    for path in paths:
        check_output(path, ["npz"])
    return paths


def keep(
    result: Identification,
    dataset: PushDataset,
    output: Path,
    pictures: Path | None,
    progress: Progress,
    truth: Maps | None = None,
) -> list[Path]:
    """Write a belief, and its pictures to a folder or beside it; returns the paths of the pictures."""
    from slipmap.diagrams.application.figures import maps_figure, push_figures
    from slipmap.models.inference.belief import BeliefError

    with whole_file(output) as part:
        try:
            result.belief.save(part)
        except BeliefError as error:  # names the temporary file
            raise error.__cause__ or error from error
    folder = pictures or output.parent
    progress("drawing", 0, 2)
    paths = write_figures(folder / f"{output.stem}.maps.png", [maps_figure(result.belief, truth=truth)])
    progress("drawing", 1, 2)
    shown = _chosen(result.pushes)
    some = ""
    if len(shown) < len(result.pushes):
        some = f"{len(shown)} of {len(result.pushes)} pushes, from best to worst predicted"
    title = f"{dataset.name}: {some}" if some else ""
    paths += write_figures(folder / f"{output.stem}.pushes.png", push_figures(shown, dataset, title=title))
    progress("drawing", 2, 2)
    if some:
        note(f"the picture of pushes shows {some}; --json writes all")
    return paths


_MOST_DRAWN, _CHOSEN = 48, 12
"""Up to so many pushes are all drawn; of more, a dozen."""


def _chosen(pushes: Sequence[Prediction]) -> Sequence[Prediction]:
    """All pushes where they are few, else a dozen (held-out ones, if any) from best to worst predicted."""
    if len(pushes) <= _MOST_DRAWN:
        return pushes
    judges = [push for push in pushes if push.role == "heldout"] or list(pushes)
    ranked = sorted(judges, key=lambda push: push.final_add)
    count = min(_CHOSEN, len(ranked))
    return [ranked[round(k * (len(ranked) - 1) / max(count - 1, 1))] for k in range(count)]


def show(result: Identification, dataset: PushDataset, where: str | None) -> None:
    """Print an identification; `where` as in `show_errors`."""
    from slipmap.diagrams.application.reports.comparison_words import advice, unexplained
    from slipmap.diagrams.application.reports.tables import (
        is_doubted,
        show_errors,
        show_friction_laws,
        show_quantities,
    )
    from slipmap.models.inference.hypotheses import unexplained_share
    from slipmap.models.inference.identifiability import coarse_cells

    belief, fit = result.belief, len(dataset.fit_trials)
    some = belief.method != "paper" and belief.taught < fit
    drawn = f" ({belief.taught} of them, drawn at random, were learned from)" if some else ""
    click.echo(
        f"dataset {printable(dataset.name)}: {len(dataset.grid)} cells;"
        f" {counted(fit)} to fit{drawn}, {len(dataset.heldout_trials)} held out\n"
        f"{len(belief)} hypotheses found in {result.seconds:.0f} s\n"
    )
    show_errors(result.pushes, dataset, where, belief.effects)
    far_off = unexplained(unexplained_share(belief.settings))
    if far_off:
        paragraph(f"{far_off} {advice(where or 'DATASET')}")
    if coarse := coarse_cells(belief):
        paragraph(f"THE CELLS ARE TOO COARSE FOR THIS OBJECT: {coarse}.")
    show_friction_laws(result.friction_laws)
    if result.share_of_known is not None:
        paragraph(_THEY_FIT if result.share_of_known else _THEY_DO_NOT_FIT)
    show_quantities(result.quantities, doubted=bool(far_off) or is_doubted(result.pushes, dataset))


_THEY_FIT = "The pushes agree with the known maps: free maps do not explain them much better."
_THEY_DO_NOT_FIT = (
    "THE PUSHES CONTRADICT THE KNOWN MAPS: free maps explain them far better. Either the maps given as known"
    " are wrong, or an effect is missing that free maps can imitate; `slipmap diagnose` looks for it."
)


def tell_files(belief: Path, pictures: Sequence[Path]) -> None:
    """Say where a belief and its pictures are."""
    note(f"belief: {belief}")
    for path in pictures:
        note(f"picture: {path}")


def _first_pushes(dataset: PushDataset, count: int) -> PushDataset:
    available = len(dataset.fit_trials)
    if count > available:
        raise BadInput(
            f"--fit-pushes {count}: dataset {dataset.name} has {available} pushes with the role fit; ask for"
            f" 1 to {available}"
        )
    return dataset.with_fit_pushes(count)


_SAID = {
    "for": "The pushes support {effects}.",
    "against": "THE PUSHES SPEAK AGAINST {effects}.",
    "undecided": "{pushes} alone {do} not show whether {effects} is present, and its size holds"
    " only if it is; `slipmap diagnose` weighs all pushes.",
}
"""What the pushes say about effects, by `Identification.verdict`."""

_NOT_CLEAR = "The 90 % interval of {names} is consistent with no effect at all. "


def _show_gain(result: Identification, added: Sequence[Effect]) -> None:
    from slipmap.diagrams.application.reports.comparison_words import millimetres

    role = result.judges
    which, count = {"heldout": "held-out", "fit": "fit"}[role], len(result.errors(role))
    paired = result.with_and_without
    assert result.without_effects is not None and paired is not None
    now, before = (float(learned.errors(role).mean()) for learned in (result, result.without_effects))
    effects = " and ".join(effect.name for effect in added)
    ends = f"{which.capitalize()} pushes end {{}} mm from their predictions on average"
    these, whose, do = f"These {count} pushes", "Push by push, their", "do"
    if count == 1:
        ends = f"The {which} push ends {{}} mm from its prediction"
        these, whose, do = "This one push", "Its", "does"
    change = f"{whose} misfit is {paired.ratio:.2g} times that without {effects}"
    if math.isfinite(paired.high):
        low, high = _beside_one(paired.low), _beside_one(paired.high)
        if paired.verdict == "undecided":
            low, high = f"{paired.low:.2g}", f"{paired.high:.2g}"
        change += f" (90 % interval {low} to {high})"
    said = _SAID[result.verdict].format(effects=effects, pushes=these, do=do)
    if result.verdict != paired.verdict:
        said = _NOT_CLEAR.format(names=" and of ".join(result.without_clear_size)) + said
    paragraph(
        f"{ends.format(millimetres(now))}; without {effects}, {millimetres(before)} mm. {change}. {said}"
    )


def _beside_one(ratio: float) -> str:
    """A ratio with two figures, or as many more as show on which side of 1 it lies, up to five."""
    texts = [f"{ratio:.{figures}g}" for figures in range(2, 6)]
    return next((text for text in texts if float(text) != 1.0), texts[-1])


def show_effects(result: Identification) -> None:
    """Print the sizes of the model's effects, each in a sentence."""
    from slipmap.models.inference.diagnosis.results import estimates_by_effect
    from slipmap.models.inference.effect_words import effect_in_words

    every = estimates_by_effect(result)
    for name, estimates in every.items():
        paragraph(f"{name}: {effect_in_words(name, estimates, result.belief.grid)}.")
    if {"table_tilt", "load_transfer"} <= every.keys():
        paragraph(
            "On a slope, gravity pulls at the height of the centre of mass and shifts load downhill, and the"
            " finger shifts it at its own height: load_transfer is estimated together with the tilt."
        )
