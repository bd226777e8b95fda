"""`slipmap completion`: lets a shell complete commands and options with the Tab key."""

from __future__ import annotations

import click

SHELLS = ("bash", "zsh", "fish")


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
@click.pass_context
def completion(ctx: click.Context, shell: str) -> None:
    """Let a shell complete commands with the Tab key.

    Prints what lets SHELL complete commands and options.

    Put `eval "$(slipmap completion bash)"` into ~/.bashrc, the same with zsh into ~/.zshrc, or
    `slipmap completion fish | source` into ~/.config/fish/config.fish.
    """
    from click.shell_completion import get_completion_class

    complete = get_completion_class(shell)
    assert complete is not None  # of all SHELLS
    click.echo(complete(ctx.find_root().command, {}, "slipmap", "_SLIPMAP_COMPLETE").source())
