"""Two effects hidden at once by the blind tests' simulator: the page docs/lab/two-effects.md.

    python -m tests.models.inference.diagnosis.pairs_study --seed 1 --count 12 [--page PAGE.md]

Both effects are clear, of the library, and change different things: two that change friction, the tracker's
report or the force sensor's are not drawn together.
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
from slipmap.diagrams.application.studies.blind.secret_effects import LIBRARY, Effect, Kind

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
    if found.together and set(found.effects) == hidden:
        said = "both"
    elif set(found.effects) <= hidden and found.verdict == "effect":
        said = "one"
    else:
        said = "in the set" if hidden & set(found.effects) else found.verdict
    misfits = [
        "" if errors is None else f"{errors.total_misfit:.1f}" for errors in (found.before, found.after)
    ]
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
    counts = ", ".join(f"{what} {said.count(what)}" for what in dict.fromkeys(sorted(said)))
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
            f"Named: {counts}; of {count}.",
            "",
            "| seed | hidden | named | misfit without | with |",
            "| ---: | --- | --- | ---: | ---: |",
            *lines,
            "",
        ]
    )


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--page", type=Path)
    given = parser.parse_args()
    text = page(given.seed, given.count)
    if given.page is not None:
        given.page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
