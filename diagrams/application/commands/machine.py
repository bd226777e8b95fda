"""`slipmap bench`: how fast the model runs on this machine, beside other simulators.

Also `slipmap completion`, which lets a shell complete commands with the Tab key, and `slipmap doctor`, which
checks that this machine has everything slipmap needs.
"""

from pathlib import Path

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.terminal import Progress, prepare_kernels
from slipmap.models.files import BadInput, write_json


@click.command()
@options.json_option
def bench(json_file: Path | None) -> None:
    """Measure how fast this machine simulates pushes.

    Times other physics engines too, where they are installed.
    """
    with Progress() as progress:
        prepare_kernels()
        from slipmap.diagrams.application import benchmark

        result = benchmark.run_benchmark(progress=progress)
    write_json(json_file, result)
    click.echo(benchmark.format_table(result))


SHELLS = ("bash", "zsh", "fish")


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
@click.pass_context
def completion(ctx: click.Context, shell: str) -> None:
    """Let a shell complete commands with the Tab key.

    Prints the script with which SHELL completes commands and options.

    Put `eval "$(slipmap completion bash)"` into ~/.bashrc, the same with zsh into ~/.zshrc, or
    `slipmap completion fish | source` into ~/.config/fish/config.fish.
    """
    from click.shell_completion import get_completion_class

    complete = get_completion_class(shell)
    assert complete is not None  # of all SHELLS
    click.echo(complete(ctx.find_root().command, {}, "slipmap", "_SLIPMAP_COMPLETE").source())


@click.command()
@options.json_option
def doctor(json_file: Path | None) -> None:
    """Check that this machine has everything slipmap needs.

    Checks the versions of packages, renders a test picture, compiles, writes to the cache, and sends a
    message through LCM. For anything missing, it names the command that installs it. Exit code 0 means that
    slipmap will run; a browser and LCM are optional.
    """
    from slipmap.diagrams.application.health import examine

    found = []
    for finding in examine():
        found.append(finding)
        state = "ok" if finding.ok else "missing" if finding.needed else "without"
        click.echo(f"{state:<8} {finding.name}: {finding.found}")
        if not finding.ok:
            click.echo(f"{'':<8} -> {finding.remedy}")
    lacking = [finding.name for finding in found if finding.needed and not finding.ok]
    write_json(json_file, {"ready": not lacking, "checks": [vars(finding) for finding in found]})
    if lacking:
        raise BadInput(f"this machine lacks {', '.join(lacking)}; the lines above say how to install it")
    click.echo("Everything slipmap needs is there.")
