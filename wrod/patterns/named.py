"""Built-in patterns by name."""

from wrod import arguments
from wrod.errors import PatternError
from wrod.patterns.pattern import Pattern
from wrod.patterns.shapes import SHAPES


def _is_name(value) -> str | None:
    return arguments.text(value) and (
        "must be the name of a built-in pattern; Pattern.from_points takes points, Pattern.load "
        "a file"
    )


@arguments.checked(PatternError, name=_is_name)
def pattern(name: str) -> Pattern:
    """Built-in pattern by name, such as "letter-A".

    Raises:
        PatternError: no pattern has that name.
    """
    if name not in SHAPES:
        raise PatternError(
            f"unknown pattern {name!r}; built in are {', '.join(pattern_names())} "
            "(or give a file of points)"
        )
    return Pattern(*SHAPES[name](), name=name)


def pattern_names() -> list[str]:
    """Names of the built-in patterns."""
    return list(SHAPES)
