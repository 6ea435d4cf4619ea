"""`python -m wrod` is the command `wrod`."""

from wrod.commands import main

if __name__ == "__main__":
    main()
