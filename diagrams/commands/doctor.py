"""`slipmap doctor`: has this machine all that slipmap needs?"""

from __future__ import annotations

from pathlib import Path

import click

from diagrams.commands import options
from diagrams.console import BadInput
from diagrams.outputs import write_json


@click.command()
@options.json_option
def doctor(json_file: Path | None) -> None:
    """Say whether this machine has all that slipmap needs.

    Looks for packages in the right versions, renders a test picture, compiles, writes to the cache, and
    sends a message through LCM. What is missing is told with the command that gets it. The exit code is 0
    if everything is there that slipmap does not do without; a browser and LCM are no part of that.
    """
    from diagrams.health import examine

    found = []
    for finding in examine():
        found.append(finding)
        state = "ok" if finding.ok else "missing" if finding.needed else "without"
        click.echo(f"{state:<8} {finding.name}: {finding.found}")
        if not finding.ok:
            click.echo(f"{'':<8} -> {finding.remedy}")
    lacking = [finding.name for finding in found if finding.needed and not finding.ok]
    if json_file is not None:
        write_json(json_file, {"ready": not lacking, "checks": [finding.to_json() for finding in found]})
    if lacking:
        raise BadInput(f"this machine lacks {', '.join(lacking)}; the lines above say how to get it")
    click.echo("All that slipmap needs is there.")
