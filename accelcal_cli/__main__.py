"""The command's first lines; `python -m accelcal_cli` is the same."""

import signal
from typing import NoReturn


def main() -> NoReturn:
    """Run the command. Until it can say so, Ctrl-C ends it without a word."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from accelcal_cli.cli.main import main as run

    run()


if __name__ == "__main__":
    main()
