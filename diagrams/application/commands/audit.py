"""`slipmap audit`: where physics engines leave Coulomb's law of friction, and by how many millimetres."""

from __future__ import annotations

from pathlib import Path

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.terminal import Progress, note, prepare_kernels
from slipmap.models.files import together, write_json, write_text


@click.command()
@click.argument("engines", metavar="ENGINE...", nargs=-1, required=True)
@options.report_option("audit.html")
@options.json_option
def audit(engines: tuple[str, ...], output: Path, json_file: Path | None) -> None:
    """Say how far a physics engine is from Coulomb's law.

    ENGINE is mujoco, bullet or drake, with settings after a colon, as mujoco:elliptic,impratio=100,
    bullet:pyramid, drake:sap or drake:hydroelastic; or a class in a file of your own, as
    my_engine.py:Engine (docs/audit.md says what it needs). Probes name what is wrong, each with a size and
    an uncertainty; 24 pushes of an object with known maps say what it costs, in millimetres.
    """
    from slipmap.diagrams.application.audit import engines as known

    subjects = [known.find_engine(spec) for spec in engines]
    with Progress() as progress:
        prepare_kernels()
        from slipmap.diagrams.application.audit.procedure import (
            audit as audited,
            prices_beside,
            standard_pushes,
        )

        standard = standard_pushes()
        audits = [audited(subject, standard, progress) for subject in subjects]
        beside = prices_beside(engines, standard, progress) if len(audits) == 1 else {}
        from slipmap.diagrams.application.reports.audit_words import audit_report, show_audits

        document = {
            "engines": [one.to_json() for one in audits],
            "beside_mm": {k: 1e3 * v for k, v in beside.items()},
        }
        with progress.step("drawing"), together():
            write_text(output, audit_report(audits, beside))
            write_json(json_file, document)
    show_audits(audits, beside)
    note(f"report: {output}")
