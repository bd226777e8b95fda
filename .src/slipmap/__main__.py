"""Entry point of the console script; Ctrl-C during import ends it quietly."""

import os
import sys


def main() -> None:
    """Run `slipmap` with the arguments of this process, and exit."""
    try:
        from slipmap.diagrams.application.command_line import main as run_command

        run_command()
    except KeyboardInterrupt:
        sys.stderr.write("slipmap: stopped; nothing half-written is left behind\n")
        sys.stderr.flush()
        os._exit(130)  # after a Ctrl-C while a module makes a dataclass, sys.exit() would end by SIGINT


if __name__ == "__main__":
    main()
