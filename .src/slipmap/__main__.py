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
        # Nothing runs yet that must be ended. After a Ctrl-C within `exec`, as when a dataclass is made,
        # `python -m` would not keep the code of `sys.exit`.
        os._exit(130)


if __name__ == "__main__":
    main()
