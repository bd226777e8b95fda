"""docs/effects.md, written from the effects' code.

`python tests/diagrams/application/effects_page.py` writes it anew.
"""

from __future__ import annotations

import textwrap
from pathlib import Path

from slipmap.diagrams.application.commands.effects import grouped, null_of
from slipmap.models.effects import LIBRARY, Effect
from slipmap.models.effects.symbols import body_names, cell_names, latex_name
from slipmap.models.effects.written import written

PAGE = Path(__file__).resolve().parents[3] / "docs" / "effects.md"
MAGNET = PAGE.parent / "examples" / "magnet.py"

_HEAD = """\
# Effects

Physics that slipmap can add to its plain model (an object made of cells with mass and dry friction, pushed by
a stiff finger on a level table, seen by sensors that are perfect but for noise). `slipmap effects` lists the
effects, `slipmap effects tether` explains one, and `slipmap effects tether --picture tether.png` draws what
it does to a push.

This page is generated from the code by `python tests/diagrams/application/effects_page.py`. The
formulas are those that run, without constants that only smooth corners. [v]₊ is the larger of v
and 0, and σ(v) rises smoothly from 0 to 1 around v = 0. A ⁺ marks values after the step. An effect
vanishes at the values under *vanishes at*; parameters with a dash there only shape it.
"""

_OWN = """\
## An effect of your own

Write a file with a class that has a name, a sentence, parameters and a formula in SymPy. This is
a magnet under the table ([examples/magnet.py](examples/magnet.py)):

```python
{code}```

Then let it compete with the library, and learn its parameters:

    slipmap effects magnet --effect-file magnet.py --picture magnet.png
    slipmap diagnose DATASET --effect-file magnet.py
    slipmap fit DATASET --effect magnet --effect-file magnet.py

- Derivatives and machine code are generated from the formula once; nothing is differentiated by hand.
- A parameter has a name, an SI unit (`1` for none), a meaning, its lowest and highest value, its
  expected size (`0.1` above), and `null`, the value at which the effect vanishes. At least one parameter
  needs a null. With `weight_power=1.0` the expected size is per newton of the object's weight, so
  light and heavy objects are treated alike. Parameters without a null only shape the effect;
  `starts` gives their starting values for the search, `far_starts` starting values away from the nulls.
- A faulty file is refused with file and line: wrong units, an effect that does not vanish at its null,
  formulas that are not finite or have no derivative where the object is at rest (write
  `sqrt(vx**2 + vy**2 + 1e-4**2)`, not `sqrt(vx**2 + vy**2)`), names that do not exist, misspelt methods.
  Start the name of a helper method of your own with an underscore.

A class overrides only the methods that it changes:

| method | returns |
| --- | --- |
{methods}

`body` knows {body}.

`cell` knows all that and {cell}; its `x` and `y` are those of the cell.
`models/effects/symbols.py` defines each. `pose` has `x`, `y` and `theta`, `force` has `x` and `y`.
That file also has `positive_part` and `smooth_step`, a differentiable maximum and step. To carry
numbers from step to step, name them in `memory` and update them in `remember`.

When several datasets are diagnosed together, `belongs_to` says what has the effect: `"object"`, the
default, gives each dataset its own parameters; `"table"`, `"tracker"`, `"finger"` and
`"force sensor"` give all datasets one set.
"""

_METHODS = {
    "friction": "cell, p", "drag": "cell, p", "stretch": "cell, p", "force": "body, p",
    "downhill": "body, p", "blade": "body, p", "pyramid": "body, p", "inertia": "body, p",
    "compliance": "body, p", "measured": "pose, p", "delay": "p",
    "felt": "force, p", "force_delay": "p",
}  # fmt: skip


def page() -> str:
    """The whole page in Markdown."""
    parts = [_HEAD, *(section(effect) for effect in LIBRARY), own()]
    return "\n".join(parts)


def section(effect: Effect) -> str:
    """One effect: sentence, formulas, letters, parameters."""
    text = written(effect)
    lines = [f"## {effect.name}", "", effect.sentence, ""]
    for formula in text.formulas:
        if formula.meaning:
            lines += [f"{formula.meaning[0].upper()}{formula.meaning[1:]}:", ""]
        lines += [f"$${formula.latex}$$", ""]
    if text.letters:
        groups = grouped((f"${latex}$", meaning) for _, latex, meaning in text.letters)
        told = "; ".join(f"{letters}: {meaning}" for letters, meaning in groups)
        lines += [*textwrap.wrap(f"Here {told}.", 150, break_long_words=False, break_on_hyphens=False), ""]
    lines += ["| parameter | unit | range | vanishes at | meaning |", "| --- | --- | --- | --- | --- |"]
    for q in effect.parameters:
        name = text.symbols[q.name]
        shown = f"`{q.name}`" if name == q.name else f"`{q.name}`, ${latex_name(name)}$ in the formula"
        lines.append(f"| {shown} | {q.unit} | {q.low:g} to {q.high:g} | {null_of(q)} | {q.meaning} |")
    return "\n".join([*lines, ""])


def own() -> str:
    """How to write one's own."""
    body = body_names({})
    cell = [name for name in cell_names(body) if name not in body]
    rows = []
    for name, arguments in _METHODS.items():
        told = " ".join((getattr(Effect, name).__doc__ or "").split())
        rows.append(f"| `{name}({arguments})` | {told.replace('|', '/')} |")
    return _OWN.format(
        code=MAGNET.read_text(encoding="utf-8"),
        methods="\n".join(rows),
        body=textwrap.fill(", ".join(f"`{name}`" for name in [*body, "force_x", "force_y"]), 140),
        cell=", ".join(f"`{name}`" for name in cell),
    )


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
