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

What slipmap knows of beyond its plain model (an object of cells with mass and dry friction, pushed by a
stiff finger on a level table, seen by perfect sensors up to noise). `slipmap effects` lists them,
`slipmap effects tether` explains one, and `slipmap effects tether --picture tether.png` draws what it
does to a push.

This page is made from the code: `python tests/diagrams/application/effects_page.py` writes it anew. The
formulas are those that run. Constants that only round off corners are left out, [v]₊ is the larger of v
and 0, σ(v) goes smoothly from 0 to 1 about v = 0. A ⁺ marks what holds after the step. An effect is
nothing at the value under *nothing at*; parameters with a dash there only shape it.
"""

_OWN = """\
## An effect of your own

Write a file with a class: what it is called, a sentence, its parameters, and a formula in SymPy. This is
a magnet under the table ([examples/magnet.py](examples/magnet.py)):

```python
{code}```

Then let it compete with the library, and learn with it:

    slipmap effects magnet --effect-file magnet.py --picture magnet.png
    slipmap diagnose DATASET --effect-file magnet.py
    slipmap fit DATASET --effect magnet --effect-file magnet.py

- Derivatives and machine code are made from the formula, once; nothing is differentiated by hand.
- A parameter has a name, a unit in SI (`1` for none), a meaning, its lowest and highest value, the size
  it is expected to have (`0.1` above), and `null`, the value at which the effect vanishes. At least one
  needs a null. With `weight_power=1.0` the expected size is meant per newton of the object's weight, so
  that light and heavy objects are treated alike. Parameters without a null only shape the effect;
  `starts` says where to begin looking for them, `far_starts` where else than at the nulls.
- A faulty file is refused with file and line: wrong units, an effect that does not vanish at its null,
  formulas that are not finite or have no derivative where the object lies still (write
  `sqrt(vx**2 + vy**2 + 1e-4**2)`, not `sqrt(vx**2 + vy**2)`), names that do not exist, misspelt methods.
  A helper method of your own begins with an underscore.

A class overrides what it changes and leaves the rest:

| method | returns |
| --- | --- |
{methods}

`body` knows {body}.

`cell` knows all that and {cell}; its `x` and `y` are those of the cell.
`models/effects/symbols.py` says what each is. `pose` has `x`, `y` and `theta`, `force` has `x` and `y`.
`positive_part` and `smooth_step` there are a maximum and a step that can be differentiated. To carry
numbers from step to step, name them in `memory` and renew them in `remember`.

Where several datasets are diagnosed together, `belongs_to` says what has the effect: `"object"`, as it is
unless you say otherwise, gives each dataset parameters of its own; `"table"`, `"tracker"`, `"finger"` and
`"force sensor"` one set for all.
"""

_METHODS = {
    "friction": "cell, p", "drag": "cell, p", "stretch": "cell, p", "force": "body, p", "blade": "body, p",
    "pyramid": "body, p", "inertia": "body, p", "compliance": "body, p", "measured": "pose, p", "delay": "p",
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
    lines += ["| parameter | unit | range | nothing at | meaning |", "| --- | --- | --- | --- | --- |"]
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
