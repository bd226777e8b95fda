"""Formulas of an effect for readers: LaTeX and one line of text, made from the effect's own code.

Smoothing that only serves the computation is left out: constants below 1e-5 in sums, and the soft corners of
`positive_part`. Long formulas are split into shorter ones, with repeated parts named k₁, k₂ ….
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp
from sympy.printing.latex import LatexPrinter
from sympy.printing.str import StrPrinter

from slipmap.models.effects.effect import Effect, EffectError, call_formula
from slipmap.models.effects.symbols import Names, latex_name, real, writing, written_names

_ROUNDING = 1e-5  # smaller constants in a sum only smooth the formula
_LONG = 14  # formulas with more operations get names for repeated parts
_WIDE = 120  # characters of a formula from which short parts used twice get names too
_SIMPLIFIED = 100  # operations up to which squares of sines and cosines are combined

QUANTITIES = {
    "friction": ((r"s",), "factor on the friction of a cell"),
    "drag": ((r"D",), "drag of a cell: the force on it is -D u"),
    "stretch": (
        ("q_{xx}", "q_{xy}", "q_{yy}"), "friction of a cell of load N is -μ N Q u / √(uᵀ Q u), object frame",
    ),
    "force": ((r"F_{x}", r"F_{y}", r"\tau"), "force on the object, and torque about its origin"),
    "downhill": (("a_{x}", "a_{y}"), "acceleration by which gravity pulls along the table"),
    "blade": (
        ("F", "n_{x}", "n_{y}", "r_{x}", "r_{y}"), "F resists motion of the object's point r along n",
    ),
    "pyramid": (
        ("c", "d", r"\alpha"),
        "the friction norm is c |u| + d (|u·e| + |u·n|), with e at angle α in the world and n normal to e",
    ),
    "inertia": ((r"\kappa",), "factor on the inertial mass"),
    "compliance": (("C",), "true tip = recorded tip - b, with C × force on the object = b + 10 ms × db/dt"),
    "measured": ((r"\hat{x}", r"\hat{y}", r"\hat{\theta}"), "pose that the tracker reports"),
    "delay": ((r"\Delta t",), "the tracker reports the pose from Δt ago"),
    "felt": ((r"\hat{F}_{x}", r"\hat{F}_{y}"), "force that the sensor reports"),
    "force_delay": ((r"\Delta t_{F}",), "the sensor reports the force from Δt_F ago"),
}  # fmt: skip
"""Method of an effect: letters of its results, and their meaning."""

LETTERS = {
    "x": "position of the object frame, m", "y": "position of the object frame, m",
    r"\theta": "angle of the object",
    r"\dot{x}": "velocity of the object frame's origin", r"\dot{y}": "velocity of the object frame's origin",
    r"\omega": "angular velocity", r"\bar{r}_{x}": "centre of mass relative to the origin, world axes",
    r"\bar{r}_{y}": "centre of mass relative to the origin, world axes",
    r"\bar{v}_{x}": "velocity of the centre of mass",
    r"\bar{v}_{y}": "velocity of the centre of mass", "m": "mass", "J": "moment of inertia about the origin",
    "g": "gravity", "t": "time since the push began", "h": "time step",
    "k": "index of the push in the experiment",
    "w": "width of a cell", "c_{x}": "centroid of the cells", "c_{y}": "centroid of the cells",
    "G_{xx}": "inverse of the cells' second moments", "G_{xy}": "inverse of the cells' second moments",
    "G_{yy}": "inverse of the cells' second moments", "F_{x}": "latest force of the finger",
    "F_{y}": "latest force of the finger", "a_{x}": "acceleration by which gravity pulls along the table",
    "a_{y}": "acceleration by which gravity pulls along the table",
    "X": "position of the cell, m", "Y": "position of the cell, m",
    "r_{x}": "position of the cell in the object frame", "r_{y}": "position of the cell in the object frame",
    "u_{x}": "velocity of the cell", "u_{y}": "velocity of the cell",
    "u^{O}_{x}": "velocity of the cell, object frame", "u^{O}_{y}": "velocity of the cell, object frame",
    "u": "speed of the cell", "a": "area of a cell",
}  # fmt: skip
"""Meanings of the letters of `written_names`."""

_PLAIN = {
    r"\theta": "θ", r"\omega": "ω", r"\tau": "τ", r"\kappa": "κ", r"\alpha": "α", r"\Delta t": "Δt",
    r"\Delta t_{F}": "Δt_F", r"\hat{F}_{x}": "F_x_seen", r"\hat{F}_{y}": "F_y_seen", r"\hat{x}": "x_seen",
    r"\hat{y}": "y_seen", r"\hat{\theta}": "θ_seen", r"\dot{x}": "vx", r"\dot{y}": "vy",
}  # fmt: skip


@dataclass(frozen=True)
class Formula:
    """One equation of an effect."""

    meaning: str  # of the left side; empty for a part that another equation uses
    latex: str  # the equation in LaTeX that matplotlib's mathtext can render too
    text: str  # the equation as one line


@dataclass(frozen=True)
class Written:
    """An effect for readers."""

    formulas: tuple[Formula, ...]  # its equations; helper equations follow those that use them
    # (text, LaTeX, meaning) of each letter in them that is not a parameter
    letters: tuple[tuple[str, str, str], ...]
    symbols: dict[str, str]  # how each parameter is written in `text`, by its name


def written(effect: Effect) -> Written:
    """The effect's formulas, with parameters written as their names.

    Raises:
        EffectError: a formula fails.
    """
    taken = {"theta", *"xymgthkwuasDFCJXYcd"}
    latex_of = {q.name: latex_name(f"{q.name}_p" if q.name in taken else q.name) for q in effect.parameters}
    p = Names(f"effect {effect.name}: p", {name: real(text) for name, text in latex_of.items()})
    with writing():
        asked = list(_equations(effect, p))
    formulas: list[Formula] = []
    used: set[str] = set()
    for method, names, values in asked:
        expressions = [_read(sp.sympify(value)) for value in values]
        if method == "force" and expressions[2] == _torque(expressions):
            names, expressions = names[:2], expressions[:2]
            meaning = "force on the object at its centre of mass, which gives its torque about the origin"
        elif method == "force" and expressions[2] == 0:
            names, expressions = names[:2], expressions[:2]
            meaning = "force on the object at its frame's origin, with no torque about it"
        else:
            meaning = QUANTITIES[method][1] if method in QUANTITIES else "memory carried from step to step"
        helpers, reduced = _split(expressions, len(formulas))
        for place, (name, expression) in enumerate(zip(names, reduced, strict=True)):
            formulas.append(_formula(meaning if place == 0 else "", real(name), expression))
        formulas += [_formula("", name, expression) for name, expression in helpers]
        used |= {str(symbol) for expression in expressions for symbol in expression.free_symbols}
    parameters = set(latex_of.values())
    letters = tuple(
        (plain_text(letter), letter, LETTERS[letter]) for letter in LETTERS if letter in used - parameters
    )
    return Written(tuple(formulas), letters, {name: plain_text(text) for name, text in latex_of.items()})


def _equations(effect: Effect, p: Any) -> Iterator[tuple[str, tuple[str, ...], Sequence[Any]]]:
    """(method, letters, expressions) of each method that the effect overrides."""
    memory = effect.memory
    body = Names(f"effect {effect.name}: body", written_names("body", memory))
    cell = Names(f"effect {effect.name}: cell", written_names("cell", memory))
    after = Names(f"effect {effect.name}: after", written_names("after"))
    pose, push = Names("pose", written_names("pose")), Names("force", written_names("push"))
    arguments: dict[str, tuple[Any, ...]] = {
        "friction": (cell, p), "drag": (cell, p), "stretch": (cell, p), "measured": (pose, p), "delay": (p,),
        "felt": (push, p), "force_delay": (p,),
    }  # fmt: skip
    for method, (names, _) in QUANTITIES.items():
        value = call_formula(effect, method, *arguments.get(method, (body, p)))
        if value is not None:
            values = list(value) if isinstance(value, (tuple, list)) else [value]
            if len(values) != len(names):
                raise EffectError(
                    f"effect {effect.name}: {method}() must return {len(names)} expressions,"
                    f" got {len(values)}"
                )
            yield method, names, values
    if memory:
        renewed = call_formula(effect, "remember", body, after, p)
        yield "remember", tuple(latex_name(name) + "^{+}" for name in memory), list(renewed)


def _torque(force: Sequence[Any]) -> Any:
    """Torque about the origin of a force at the centre of mass."""
    names = written_names("body")
    return _read(names["com_x"] * force[1] - names["com_y"] * force[0])


def _read(expression: Any) -> Any:
    """The expression for readers: without smoothing, with short numbers and combined angles."""
    expression = expression.replace(
        lambda e: e.is_Add and any(_tiny(term) for term in e.args),
        lambda e: sp.Add(*(term for term in e.args if not _tiny(term))),
    )
    expression = expression.replace(lambda e: e.is_Float, _short)
    # Takes minutes on long expressions, and helps only with squares.
    short = sp.count_ops(expression) <= _SIMPLIFIED
    if short and any(power.base.func in (sp.cos, sp.sin) for power in expression.atoms(sp.Pow)):
        expression = sp.trigsimp(expression)
    return sp.factor_terms(expression)


def _tiny(term: Any) -> bool:
    return bool(term.is_number and abs(term) <= _ROUNDING)


def _short(number: Any) -> Any:
    value = float(number)
    return sp.Integer(round(value)) if value == round(value) else sp.Float(f"{value:.4g}", 4)


def _split(expressions: Sequence[Any], begin: int, few: int = 3) -> tuple[list[tuple[Any, Any]], list[Any]]:
    """Named parts, and the expressions in terms of them. Short formulas get no named parts, and short sums
    only if they are used more than a few times."""
    if max(sp.count_ops(expression) for expression in expressions) <= _LONG:
        return [], list(expressions)
    names = (real(f"k_{{{number}}}") for number in range(begin + 1, begin + 100))
    helpers, reduced = sp.cse(expressions, symbols=names, order="none")
    # A part that is short or used once reads better inline.
    for index in range(len(helpers) - 1, -1, -1):
        name, value = helpers[index]
        later = [e for _, e in helpers[index + 1 :]] + list(reduced)
        uses = sum(part == name for e in later for part in sp.preorder_traversal(e))
        if uses < 2 or (sp.count_ops(value) <= 1 and (uses <= few or not value.is_Add)):
            del helpers[index]
            helpers[index:] = [(n, e.subs(name, value)) for n, e in helpers[index:]]
            reduced = [e.subs(name, value) for e in reduced]
    if few > 1 and max(len(str(expression)) for expression in reduced) > _WIDE:
        return _split(expressions, begin, few=1)
    order = {name: real(f"k_{{{begin + place}}}") for place, (name, _) in enumerate(helpers, start=1)}
    # In two steps, since a new name may be the old one of another part.
    apart = {name: sp.Dummy() for name in order}
    final = {apart[name]: new for name, new in order.items()}

    def renamed(e: Any) -> Any:
        return e.xreplace(apart).xreplace(final)

    return [(order[name], renamed(e)) for name, e in helpers], [renamed(e) for e in reduced]


class _PositiveFirst:
    """Printer mixin: sums begin with a positive term."""

    def _as_ordered_terms(self, expr: Any, order: Any = None) -> list[Any]:
        terms = super()._as_ordered_terms(expr, order)  # type: ignore[misc]
        return sorted(terms, key=lambda term: term.could_extract_minus_sign())


class _Text(_PositiveFirst, StrPrinter):
    """Prints one line of text, with symbols as in `plain_text`."""

    def _print_Symbol(self, expr: Any) -> str:
        return plain_text(str(expr.name))


class _Latex(_PositiveFirst, LatexPrinter):
    """Prints LaTeX that mathtext can render too, with symbols verbatim."""

    def _print_ExpBase(self, expr: Any, exp: Any = None) -> str:
        if sp.count_ops(expr.exp) <= 4:
            return str(super()._print_ExpBase(expr, exp))
        return rf"\exp\left({self.doprint(expr.exp)}\right)" + (f"^{{{exp}}}" if exp else "")

    def _print_Symbol(self, expr: Any, style: str = "plain") -> str:
        return str(expr.name)


def _formula(meaning: str, name: Any, expression: Any) -> Formula:
    text = _Text().doprint(expression).replace("**", "^").replace("*", " ")
    latex = _Latex({"mul_symbol": r" \, "}).doprint(expression)
    return Formula(meaning, f"{name.name} = {latex}", f"{plain_text(name.name)} = {text}")


def plain_text(latex: str) -> str:
    """A symbol's LaTeX as text: x_{p} becomes x_p, words are joined by underscores."""
    for begin, end in (("^{+}", "'"), ("^{O}", "")):
        if begin in latex:
            rest = plain_text(latex.replace(begin, ""))
            return rest + end if begin == "^{+}" else rest.replace("u_", "along_")
    if latex in _PLAIN:
        return _PLAIN[latex]
    text = re.sub(r"\\mathrm\{([^}]*)\}", lambda m: m.group(1).replace(r"\ ", "_"), latex)
    text = re.sub(r"\\bar\{([a-z])\}_\{([a-z])\}", lambda m: f"com_{'v' if m[1] == 'v' else ''}{m[2]}", text)
    return re.sub(r"_\{([^}]*)\}", r"_\1", text)
