"""The `dermis` command: `python -m dermis ...` does the same as the program of that name."""

import signal
import sys


def main() -> int:
    """Runs the command with the arguments of this process, and returns its exit code."""
    from ._dermis import run_command

    # Commands that need to finish something handle the signal themselves; the others end at once.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    sys.stdout.flush()
    return run_command(["dermis", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
