"""Options of commands, declared once: as defaults of a command's own arguments, or as fields of a
dataclass that is handed on as one argument."""

import functools
import inspect
import typing
from collections.abc import Callable, Mapping
from dataclasses import Field, field, fields
from pathlib import Path
from types import NoneType
from typing import Any

import click
from click.core import ParameterSource

from wrod.errors import DataError

# Types of options: a folder that may be new, one that is there, and a file that may be new.
FOLDER = click.Path(file_okay=False, path_type=Path)
SOURCE_FOLDER = click.Path(file_okay=False, exists=True, path_type=Path)
FILE = click.Path(dir_okay=False, path_type=Path)
# What is said of options that say nothing of themselves.
USUAL = {"out": "Folder to write into.", "seed": "Of all that is drawn at random."}


def option(said: str | None, *flags: str, left_out: Any = None, **how: Any) -> Any:
    """A field that `gathered`, or an argument that `own_options`, makes an option of; its name and
    annotation tell flag and type.

    Args:
        said: the option's help.
        flags: where they are not the field's name.
        left_out: the field's value where a command has no such option.
        how: further arguments of `click.option`.
    """
    return field(default=left_out, metadata={"flags": flags, "how": {"help": said, **how}})


# Of what simulates rods over time.
SCHEME = option(
    "Of time stepping, of first and of second order.",
    type=click.Choice(["euler", "bdf2"]),
    default="bdf2",
)


def own_options(command: Callable) -> Callable:
    """Decorator that adds the options which are defaults of a command's arguments."""
    hints = typing.get_type_hints(command)
    for name, argument in reversed(list(inspect.signature(command).parameters.items())):
        if isinstance(argument.default, Field):
            command = _option(name, hints[name], argument.default.metadata)(command)
    return command


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

        hints = typing.get_type_hints(kind)
        known = {one.name: one.metadata for one in fields(kind)}
        for one in reversed(names):
            default = {"default": defaults[one]} if one in defaults else {}
            run = _option(one, hints[one], known[one], **default)(run)
        return run

    return add


def _option(name: str, hint: Any, metadata: Mapping[str, Any], **own: Any) -> Callable:
    """What adds the option of a field or an argument to a command; `own` overrides what it says."""
    flags, how = metadata["flags"], {**metadata["how"], **own}
    how["help"] = how["help"] or USUAL.get(name)
    (first, *more) = [one for one in typing.get_args(hint) or (hint,) if one is not NoneType]
    usual: dict[str, Any] = {}
    if first is bool:
        usual["is_flag"] = True
    elif how.get("default") is not None:
        usual["show_default"] = True
    else:
        usual["type"] = click.Path(path_type=Path) if first is Path else first
        usual["multiple"] = more == [...]
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
