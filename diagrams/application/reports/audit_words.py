"""An audit of physics engines in words: the printed summary and the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from slipmap.diagrams.application.audit.procedure import NOTHING, Audit
from slipmap.diagrams.application.figures.study_figures import ends_figure, friction_figure, prices_figure
from slipmap.diagrams.application.reports.html_page import Section, page, picture, table
from slipmap.diagrams.application.terminal import paragraph, table as print_table
from slipmap.models.inference.effect_words import unit_text

_COLUMNS = (
    "engine", "price, mm", "price at half the step, mm", "step, ms", "defects", "effect that explains most",
)  # fmt: skip
_PROBES = ("probe", "size", "±", "tolerance", "defect")


def headline(audit: Audit) -> str:
    """The price, in a sentence."""
    return f"Price of {audit.name}: pushes end {_mm(audit.pushed.price)} from Coulomb's law on average."


def named(audit: Audit) -> str:
    """The named defects, one sentence each."""
    if not audit.defects:
        said = "No defect was found: the probes follow Coulomb's law within their tolerances."
        if audit.pushed.price > NOTHING:
            said += (
                f" Yet pushes end {_mm(audit.pushed.price)} off, which no probe explains: none looks at the"
                " finger's contact, its radius and its friction."
            )
        return said
    return " ".join(f"{d.title[0].upper()}{d.title[1:]}: {d.sentence}" for d in audit.defects)


def pushed(audit: Audit) -> str:
    """The pushes behind the price, and the effect that explains most of it."""
    moved = 1e3 * audit.standard.moved
    said = (
        f"The price is the mean over {len(audit.pushed.errors)} pushes, which move the object by"
        f" {moved:.0f} mm; the worst ends {_mm(audit.pushed.errors.max())} off. At half the time step, the"
        f" price is {_mm(audit.pushed_half.price)}."
    )
    if audit.explained:
        best = audit.explained[0]
        said += f" Fitting the effect {best.effect.name} with the maps held fixed leaves {_mm(best.price)}."
    return said


def remedies(audit: Audit) -> str:
    """Settings against the defects."""
    return f"Settings: {'; '.join(audit.remedies)}." if audit.remedies else ""


def _sentences(audit: Audit) -> list[str]:
    return list(filter(None, (named(audit), pushed(audit), remedies(audit))))


def overview(audits: Sequence[Audit]) -> list[tuple[str, ...]]:
    """Rows of the table of engines, with columns `_COLUMNS`."""
    rows: list[tuple[str, ...]] = []
    for audit in audits:
        best = audit.explained[0] if audit.explained else None
        rows.append(
            (
                audit.name, f"{1e3 * audit.pushed.price:.2f}", f"{1e3 * audit.pushed_half.price:.2f}",
                f"{1e3 * audit.dt:g}", ", ".join(_short(audit)) or "none",
                "" if best is None else f"{best.effect.name}, {1e3 * best.price:.2f} mm left",
            )
        )  # fmt: skip
    return rows


def show_audits(audits: Sequence[Audit], beside: Mapping[str, float]) -> None:
    """Print the audits, with the prices of other engines `beside` them (m, by name)."""
    for audit in audits:
        for text in (headline(audit), *_sentences(audit)):
            paragraph(text)
        print_table(audit.name, _PROBES, _measure_rows(audit), numbers=(1, 2, 3))
    rows = [
        (audit.name, f"{1e3 * audit.pushed.price:.2f}", ", ".join(d.title for d in audit.defects) or "none")
        for audit in audits
    ]
    rows += [(name, f"{1e3 * price:.2f}", "(not probed)") for name, price in beside.items()]
    print_table("Engines", ("engine", "price, mm", "defects"), rows, numbers=(1,))


def audit_report(audits: Sequence[Audit], beside: Mapping[str, float]) -> str:
    """The report, a whole HTML document."""
    first = audits[0]
    one = len(audits) == 1
    title = f"Audit of {first.name}" if one else "Audit of physics engines"
    subtitle = ", ".join(dict.fromkeys(filter(None, (audit.version for audit in audits))))
    lead = _sentences(first) if one else [headline(audit) for audit in audits]
    prices = {audit.name: audit.pushed.price for audit in audits} | dict(beside)
    body = picture(
        prices_figure(prices),
        "Prices of engines: mean distances of pushes' ends from Coulomb's law.",
        wide=True,
    )
    body += table(_COLUMNS, overview(audits), numbers=(1, 2, 3))
    sections = [Section("engines", "Engines", body)]
    sections += [_section(audit, number) for number, audit in enumerate(audits)]
    sections.append(Section("how", "How it was measured", _HOW))
    return page(title, subtitle, lead, sections, headline=headline(first) if one else "")


_HOW = (
    "<p>The probes use a plate of uniform weight and friction: it is released in 24 directions at three"
    " speeds, and in some of them also at other places and turned; kept sliding at four speeds, both ways,"
    " by gravity tilted to balance friction; released with 16 spins; and left alone under a load that"
    " friction can hold. A size counts as a defect if it exceeds its tolerance and twice its uncertainty,"
    " which includes the change at half the time step. The 24 pushes are of an L of two materials with known"
    " maps; Coulomb's law is slipmap's own model with these maps.</p>"
)


def _section(audit: Audit, number: int) -> Section:
    body = "".join(f"<p>{escape(text)}</p>" for text in _sentences(audit))
    body += picture(friction_figure(audit), f"Friction of {audit.name} by direction, relative to Coulomb's.")
    body += table(
        _PROBES, _measure_rows(audit), numbers=(1, 2, 3),
        marked=[measure.named for measure in audit.measures],
        caption="Sizes are 0 under Coulomb's law.",
    )  # fmt: skip
    body += (
        picture(ends_figure(audit), "The four pushes that end farthest from Coulomb's law.", wide=True)
        + "<p>Grey: before the push. Black: end under Coulomb's law. Blue: end in the engine.</p>"
    )
    if audit.explained:
        rows = [
            (
                one.effect.name, f"{1e3 * one.price:.2f}",
                ", ".join(
                    f"{p.name} {value:.3g} {unit_text(p.unit)}".strip()
                    for p, value in zip(one.effect.parameters, one.values, strict=True)
                ),
            )
            for one in audit.explained
        ]  # fmt: skip
        body += table(
            ("effect", "left, mm", "fitted"), rows, numbers=(1,),
            caption="Effects that lower the price, fitted with the maps held fixed.",
        )  # fmt: skip
    return Section(f"engine-{number}", audit.name, body)


def _mm(length: float) -> str:
    """A length, given in m, with two digits, but to no more than 0.01 mm."""
    mm = 1e3 * length
    if mm < 0.01:
        return "less than 0.01 mm"
    return f"{mm:.2g} mm" if mm < 99.5 else f"{mm:.0f} mm"


def _measure_rows(audit: Audit) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for m in audit.measures:
        scale, unit = (100.0, "%") if m.unit == "1" else (1.0, m.unit)
        rows.append(
            (
                m.title, f"{round(scale * m.value, 2) + 0.0:.2f} {unit}",  # + 0 takes the sign off a zero
                f"{scale * m.uncertainty:.2f} {unit}",
                f"{scale * m.tolerance:g} {unit}", "yes" if m.named else "",
            )
        )  # fmt: skip
    return rows


def _short(audit: Audit) -> list[str]:
    result = []
    for d in audit.defects:
        size = f"{100 * d.value:.0f} %" if d.unit == "1" else f"{d.value:.2g} {d.unit}"
        result.append(f"{d.title} ({size})")
    return result
