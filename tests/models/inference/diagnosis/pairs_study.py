"""Two effects hidden at once by the blind tests' simulator: docs/lab/two-effects.md and shared-effects.md.

    python -m tests.models.inference.diagnosis.pairs_study --seed 1 --count 12 [--shared] [--page PAGE.md]

Both effects are clear, of the library, and change different things: two that change friction, the tracker's
report or the force sensor's are not drawn together. With `--shared`, two objects share both effects, or only
the first of them.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

import slipmap
from slipmap.diagrams.application.studies.blind.generator import generate
from slipmap.diagrams.application.studies.blind.objects import random_object
from slipmap.diagrams.application.studies.blind.secret_effects import LIBRARY, Chance, Effect, Kind
from slipmap.models.inference.diagnosis.results import JointDiagnosis
from slipmap.models.inference.diagnosis.several import diagnose_together
from slipmap.models.inference.diagnosis.verdict_rules import typical_misfit

_PLAIN = Effect()


class SameThingError(Exception):
    """Two effects change the same thing."""


class Both(Effect):
    """What either of two effects changes."""

    @property
    def changes_motion(self) -> bool:
        """True; which of the two does is not asked."""
        return True


def _changed(effect: Effect) -> dict[str, Any]:
    """Parts of the plain world that an effect changes, by name, without its parameters."""
    parts = {part.name: getattr(effect, part.name) for part in fields(Effect) if part.name != "parameters"}
    return {name: part for name, part in parts.items() if not np.array_equal(part, getattr(_PLAIN, name))}


def both(one: Effect, other: Effect) -> Effect:
    """Two effects as one.

    Raises:
        SameThingError: both change the same thing.
    """
    first, second = _changed(one), _changed(other)
    if first.keys() & second.keys() - {"begin"}:
        raise SameThingError

    def begin(push: int, pushes: int, points: int) -> None:
        one.begin(push, pushes, points)
        other.begin(push, pushes, points)

    parameters = {"one": one.parameters, "other": other.parameters}
    return Both(**{**first, **second, "begin": begin, "parameters": parameters})


def together(one: Kind, other: Kind) -> Kind:
    """Two kinds of effects as one kind, whose parameters are drawn one after the other."""
    return Kind(
        f"{one.name}+{other.name}",
        lambda one_has, other_has: both(one.make(**one_has), other.make(**other_has)),
        lambda chance: {"one_has": one.draw(chance), "other_has": other.draw(chance)},
    )


def fixed(kind: Kind, chance: Chance) -> Kind:
    """A kind whose parameters are drawn now, once for all objects."""
    arguments = kind.draw(chance)
    return kind._replace(draw=lambda _: arguments)


def shared_by_two(seed: int, folder: Path, *, alone: bool) -> tuple[set[str], list[slipmap.PushDataset]]:
    """Names of clear effects of table, tracker, finger or force sensor, and two datasets of twelve pushes
    that share them: two effects, or the first of these alone."""
    rng = np.random.default_rng(seed)
    owners = {name: slipmap.effects_named([name])[0].belongs_to for name in {kind.name for kind in LIBRARY}}
    kinds = [kind for kind in LIBRARY if owners[kind.name] != "object"]
    chance = Chance(rng, "clear", random_object(rng))
    while True:
        chosen = [kinds[i] for i in rng.choice(len(kinds), 2, replace=False)]
        one, other = (fixed(kind, chance) for kind in chosen)
        try:
            both(one.make(**one.draw(chance)), other.make(**other.draw(chance)))
        except SameThingError:
            continue
        break
    hidden = one if alone else together(one, other)
    folders = [folder / f"{name}-{seed}" for name in ("first", "second")]
    for k, own in enumerate(folders):
        generate(2 * seed + k, own, effect=hidden, strength="clear", pushes=12)
    return {one.name} if alone else {one.name, other.name}, [slipmap.read_dataset(own) for own in folders]


def shared_row(seed: int, folder: Path, *, alone: bool) -> tuple[str, list[str]]:
    """What was said of two datasets with shared effects, and a row that tells it."""
    hidden, datasets = shared_by_two(seed, folder, alone=alone)
    found = diagnose_together(datasets, seed=seed)
    misfits = []
    for errors in ([one.before for one in found.datasets], [one.after for one in found.datasets]):
        judged = [own.misfit for own in errors if own is not None]
        misfits.append(f"{typical_misfit(np.concatenate(judged)):.1f}" if judged else "")
    return _told(seed, hidden, found, misfits)


def row(seed: int, folder: Path) -> tuple[str, list[str]]:
    """What was said of a dataset with two hidden effects, and a row that tells it."""
    rng = np.random.default_rng(seed)
    while True:
        one, other = (LIBRARY[i] for i in rng.choice(len(LIBRARY), 2, replace=False))
        try:
            generate(seed, folder, effect=together(one, other), strength="clear")
        except SameThingError:
            continue
        break
    hidden = {one.name, other.name}
    found = slipmap.diagnose(slipmap.read_dataset(folder), seed=seed)
    misfits = [
        "" if errors is None else f"{errors.total_misfit:.1f}" for errors in (found.before, found.after)
    ]
    return _told(seed, hidden, found, misfits)


def _told(
    seed: int, hidden: set[str], found: slipmap.Diagnosis | JointDiagnosis, misfits: list[str]
) -> tuple[str, list[str]]:
    """A word for what was said of hidden effects, and a row that tells it."""
    named_all = found.verdict == "effect" and set(found.effects) == hidden
    if named_all:
        said = "all"
    elif found.verdict == "effect" and set(found.effects) < hidden:
        said = "one of two"
    elif found.verdict == "effect":
        said = "one too many" if hidden < set(found.effects) else "another"
    else:
        said = "in the set" if hidden & set(found.effects) else found.verdict
    named = (" and " if found.together else ", ").join(found.effects) or found.verdict
    return said, [str(seed), " and ".join(sorted(hidden)), named, *misfits]


def page(seed: int, count: int) -> str:
    """The study as a page."""
    lines, said = [], []
    with tempfile.TemporaryDirectory() as folder:
        for own in range(seed, seed + count):
            what, cells = row(own, Path(folder) / f"pair-{own}")
            said.append(what)
            lines.append("| " + " | ".join(cells) + " |")
            print(lines[-1], flush=True)
    return "\n".join(
        [
            "# Two effects at once",
            "",
            f"`python -m tests.models.inference.diagnosis.pairs_study --seed {seed} --count {count}"
            " --page PAGE.md`.",
            "",
            "Two clear effects of the library, hidden together by the simulator of",
            "[`slipmap blind-test`](../blind-test.md), 24 pushes each. Misfits are those of the locked",
            "pushes, without and with what was named, in units of the sensors' noise.",
            "",
            *_table(said, lines),
        ]
    )


def shared_page(seed: int, count: int) -> str:
    """The study of shared effects as a page."""
    tables = []
    with tempfile.TemporaryDirectory() as folder:
        for alone in (False, True):
            lines, said = [], []
            for own in range(seed, seed + count):
                what, cells = shared_row(own, Path(folder) / f"alone-{alone}", alone=alone)
                said.append(what)
                lines.append("| " + " | ".join(cells) + " |")
                print(lines[-1], flush=True)
            tables.append(_table(said, lines))
    return "\n".join(
        [
            "# Effects that two datasets share",
            "",
            f"`python -m tests.models.inference.diagnosis.pairs_study --seed {seed} --count {count} --shared"
            " --page PAGE.md`.",
            "",
            "Clear effects of table, tracker, finger or force sensor, hidden by the simulator of",
            "[`slipmap blind-test`](../blind-test.md) from two objects, 12 pushes each, and diagnosed",
            "together. Misfits are those of the typical locked push (geometric mean), without and with what",
            "was named, in units of the sensors' noise.",
            "",
            "## Two effects",
            "",
            *tables[0],
            "## The first of them alone",
            "",
            *tables[1],
        ]
    )


def _table(said: list[str], lines: list[str]) -> list[str]:
    counts = ", ".join(f"{what} {said.count(what)}" for what in dict.fromkeys(sorted(said)))
    return [
        f"Named: {counts}; of {len(said)}.",
        "",
        "| seed | hidden | named | misfit without | with |",
        "| ---: | --- | --- | ---: | ---: |",
        *lines,
        "",
    ]


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--shared", action="store_true", help="two objects that share the effects")
    parser.add_argument("--page", type=Path)
    given = parser.parse_args()
    text = (shared_page if given.shared else page)(given.seed, given.count)
    if given.page is not None:
        given.page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
