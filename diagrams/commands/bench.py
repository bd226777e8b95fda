"""`slipmap bench`: how fast the model runs on this machine, and against other simulators."""

from __future__ import annotations

from pathlib import Path

import click

from diagrams.commands import options
from diagrams.console import Progress, prepare_kernels
from diagrams.outputs import write_json


@click.command()
@options.json_option
def bench(json_file: Path | None) -> None:
    """Measure how fast pushes are simulated here.

    Other engines stand beside it where they are installed.
    """
    with Progress() as progress:
        prepare_kernels()
        from diagrams import benchmark

        result = benchmark.run_benchmark(progress=progress)
    if json_file is not None:
        write_json(json_file, result)
    click.echo(benchmark.format_table(result))
