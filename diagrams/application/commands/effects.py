"""`slipmap effects`: the physical effects that slipmap knows, and their formulas."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.outputs import write_figures
from slipmap.diagrams.application.terminal import note, paragraph, prepare_kernels, table, wrapped
from slipmap.models.files import BadInput, all_or_nothing, write_json

if TYPE_CHECKING:
    from slipmap.models.effects import Effect, Parameter
    from slipmap.models.effects.written import Written


@click.command()
@click.argument("name", required=False)
@options.effect_file_option
@options.picture_option("--picture", about="Draw what the effect does to one push (.png, .pdf or .svg).")
@options.json_option
def effects(
    name: str | None, effect_files: tuple[Path, ...], picture: Path | None, json_file: Path | None
) -> None:
    """List the physical effects, or explain one of them.

    Without NAME: all effects, with a sentence each. With NAME: its formula, derived from the code that
    computes it, and its parameters; --picture shows one object pushed off-centre, with and without the
    effect.
    """
    from slipmap.models.effects.registry import effects_named, known_effects

    known = known_effects(effect_files)
    if name is None:
        if picture is not None:
            raise BadInput(
                "--picture draws one effect; name it, as in `slipmap effects tether --picture tether.png`"
            )
        write_json(json_file, {"effects": [{"name": e.name, "sentence": e.sentence} for e in known]})
        table("Effects that slipmap knows", ("name", "what happens"), [(e.name, e.sentence) for e in known])
        paragraph(
            "`slipmap effects NAME` explains one; docs/effects.md in the source tree says how to write your"
            " own."
        )
        return
    from slipmap.models.effects.written import written

    (effect,) = effects_named([name], known)
    text = written(effect)
    with all_or_nothing():
        if picture is not None:
            prepare_kernels()
            from slipmap.diagrams.application.figures import effect_figure

            write_figures(picture, [effect_figure(effect)])
        write_json(json_file, _document(effect, text))
    if picture is not None:
        note(f"picture: {picture}")
    _explain(effect, text)


def _explain(effect: Effect, text: Written) -> None:
    """Print sentence, formula and parameters of an effect."""
    click.echo(wrapped(f"{effect.name}: {effect.sentence}", "") + "\n")
    for formula in text.formulas:
        if formula.meaning:
            click.echo(wrapped(f"  {formula.meaning}:", "  "))
        click.echo(wrapped(f"    {formula.text}", "        "))
    if text.letters:
        click.echo("\nwhere")
        for letters, meaning in grouped((plain, meaning) for plain, _, meaning in text.letters):
            click.echo(wrapped(f"  {letters}: {meaning}", "      "))
    if effect.memory:
        click.echo("  a prime marks the value after the step")
    click.echo()
    names = {own: own if own == here else f"{own} ({here} above)" for own, here in text.symbols.items()}
    rows = [
        (names[q.name], q.unit, f"{q.low:g} to {q.high:g}", null_of(q), q.meaning) for q in effect.parameters
    ]
    table("Parameters", ("name", "unit", "range", "vanishes at", "meaning"), rows, numbers=(0, 2, 3))


def null_of(parameter: Parameter) -> str:
    """Value at which the effect vanishes, a dash for a parameter that only shapes it."""
    return "-" if parameter.null is None else f"{parameter.null:g}"


def grouped(letters: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """(letters, meaning) with letters of the same meaning joined."""
    groups: dict[str, list[str]] = {}
    for letter, meaning in letters:
        groups.setdefault(meaning, []).append(letter)
    return [(", ".join(those), meaning) for meaning, those in groups.items()]


def _document(effect: Effect, text: Written) -> dict[str, Any]:
    """An effect as JSON."""
    return {
        "name": effect.name,
        "sentence": effect.sentence,
        "formulas": [vars(formula) for formula in text.formulas],
        "letters": {plain: meaning for plain, _, meaning in text.letters},
        "parameters": [
            {
                "written": text.symbols[q.name],
                **{key: getattr(q, key) for key in ("name", "unit", "low", "high", "null", "meaning")},
            }
            for q in effect.parameters
        ],
    }
