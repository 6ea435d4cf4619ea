"""Options of commands: as fields of a dataclass, declared once and handed on as one argument."""

import functools
import typing
from collections.abc import Callable
from dataclasses import MISSING, field, fields
from pathlib import Path
from types import NoneType
from typing import Any

import click
from click.core import ParameterSource

from wrod.errors import DataError


def option(said: str | None, *flags: str, left_out: Any = MISSING, **how: Any) -> Any:
    """A field that `gathered` makes an option of; its name and annotation tell flag and type.

    Args:
        said: the option's help.
        flags: where they are not the field's name.
        left_out: the field's value where a command has no such option.
        how: further arguments of `click.option`.
    """
    return field(default=left_out, metadata={"flags": flags, "how": {"help": said, **how}})


def gathered(name: str, kind: type, *groups: tuple[str, ...], **defaults: Any) -> Callable:
    """Decorator that adds the options of a dataclass and hands their values on as one `kind`, by
    `name`; of groups of its fields, where there are some, those alone; `defaults` are this
    command's own."""
    every = [one.name for one in fields(kind) if one.metadata]
    names = [one for group in groups for one in group] or every

    def add(function):
        @functools.wraps(function)
        def run(*args, **values):
            values[name] = kind(**{key: values.pop(key) for key in names})
            return function(*args, **values)

        for one in reversed(names):
            run = _option(kind, one, defaults)(run)
        return run

    return add


def _option(kind: type, name: str, defaults: dict[str, Any]) -> Callable:
    """What adds the option of one field to a command."""
    (metadata,) = (one.metadata for one in fields(kind) if one.name == name)
    flags, how = metadata["flags"], dict(metadata["how"])
    if name in defaults:
        how["default"] = defaults[name]
    hint = typing.get_type_hints(kind)[name]
    (first, *_) = [one for one in typing.get_args(hint) or (hint,) if one is not NoneType]
    usual: dict[str, Any] = {}
    if typing.get_origin(hint) is tuple:
        usual["multiple"] = True
    elif first is bool:
        usual["is_flag"] = True
    elif how.get("default") is not None:
        usual["show_default"] = True
    else:
        usual["type"] = click.Path(path_type=Path) if first is Path else first
    return click.option(*(flags or (f"--{name.replace('_', '-')}",)), name, **usual | how)


def refuse_idle_options(beside: str, *names: str) -> None:
    """Refuse options, named as `names` without dashes, that were given and would do nothing."""
    context = click.get_current_context()
    known = {opt: str(param.name) for param in context.command.params for opt in param.opts}
    for name in names:
        option = f"--{name}"
        if context.get_parameter_source(known[option]) == ParameterSource.COMMANDLINE:
            raise DataError(f"{option} does nothing beside {beside}; leave it out")


def parse_list(
    text: str, option: str, low: float, high: float, *, whole: bool = False
) -> list[float]:
    """Different numbers with commas between, rising.

    Raises:
        DataError: names the option where one is no number or out of bounds.
    """
    try:
        found = sorted({(int if whole else float)(word) for word in text.split(",")})
    except ValueError:
        found = []
    if not found or not all(low <= value <= high for value in found):
        kind = "whole numbers" if whole else "numbers"
        raise DataError(
            f"{option} is {text!r:.80}; give {kind} from {low:g} to {high:g} with commas between"
        )
    return found
