"""Entry point of `greygate` and of `python -m greygate`. Ctrl-C while it starts is no traceback either."""

import sys


def run() -> None:
    try:
        from greygate.cli import run as commands
    except KeyboardInterrupt:
        print("greygate: interrupted", file=sys.stderr)
        sys.exit(130)  # greygate.cli.INTERRUPTED
    commands()


if __name__ == "__main__":
    run()
