"""`python -m wrod` is the command `wrod`; an interruption while it is loaded is said as later."""

import sys


def main() -> None:
    """Load the command line and run it."""
    try:
        from wrod.commands import main as run

        run()
    except KeyboardInterrupt:
        print("wrod: interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
