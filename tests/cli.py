"""`wrod` as the tests call it."""

import json

from click.testing import CliRunner

from wrod.commands import main


def run(*words):
    """What the command with these words ends in."""
    return CliRunner().invoke(main, list(map(str, words)))


def done(*words):
    """`run` of what has to work."""
    result = run(*words)
    assert result.exit_code == 0, result.output
    return result


def told(*words):
    """The JSON that a command prints which has to work."""
    return json.loads(done(*words).stdout)


def refused(says, *words):
    """`run` of what has to end with exit code 2 and a sentence that says this."""
    result = run(*words)
    assert result.exit_code == 2 and says in result.stderr, result.output
    return result
