"""`python -m wrod` is the command `wrod`."""

from wrod.commands import main

main()
