"""Command line: one file per command, loaded only when it is called."""

import contextlib
import importlib
import os
import sys
import warnings
from typing import NoReturn

import click

from wrod import __version__
from wrod.commands.bounds import bounded
from wrod.commands.running import INTERRUPTED, REFUSED, cut, holding_output, interruptible, stop
from wrod.commands.surroundings import open_streams, settle_variables
from wrod.errors import WrodWarning

COMMANDS = (
    "plan",
    "show",
    "deploy",
    "loop",
    "measure",
    "rods",
    "scan",
    "markers",
    "manifold",
    "identify",
    "laid",
    "dataset",
    "train",
    "distil",
    "render",
    "compile",
    "bench",
)


class LazyGroup(click.Group):
    """Group whose commands live in `<package>.<name>` as `command` and are imported on use."""

    def __init__(self, *args, package: str, names: tuple[str, ...], **kwargs):
        super().__init__(*args, **kwargs)
        self.package, self.names = package, names
        self.loaded: dict[str, click.Command] = {}

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.names)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in self.names:
            return None
        if name not in self.loaded:
            module = importlib.import_module(f"{self.package}.{name.replace('-', '_')}")
            path = name if self.package == "wrod.commands" else f"bench {name}"
            self.loaded[name] = holding_output(bounded(module.command, path), path)
        return self.loaded[name]

    def invoke(self, ctx: click.Context):
        try:
            # The outermost group alone: a benchmark runs within it.
            with interruptible() if ctx.parent is None else contextlib.nullcontext():
                settle_variables()
                return super().invoke(ctx)
        except click.UsageError as error:
            _say_usage(error, ctx.command_path)
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except (Exception, KeyboardInterrupt) as error:
            stop(ctx, error)

    def make_context(self, info_name, args, parent=None, **extra):
        # Shells put the home folder for ~ at the beginning of a word alone.
        args = [
            "--out=" + os.path.expanduser(one[6:]) if one.startswith("--out=~") else one
            for one in args
        ]
        try:
            return super().make_context(info_name, args, parent, **extra)
        except click.UsageError as error:
            if parent is not None:  # `invoke` says it
                raise
            _say_usage(error, info_name)

    def _main_shell_completion(self, *args, **kwargs):
        """Nothing, unless a shell asks for completions."""
        try:
            super()._main_shell_completion(*args, **kwargs)
        except (KeyError, ValueError) as error:  # it is no shell that asks
            click.echo(
                f"wrod: no words to complete ({error}); unset the variable that ends in "
                "WROD_COMPLETE",
                err=True,
            )
            sys.exit(REFUSED)

    def main(self, *args, **kwargs):
        open_streams()
        # What no command has loaded yet has nothing to forget, and brings NumPy with it.
        if "wrod.files.writing" in sys.modules:
            sys.modules["wrod.files.writing"].begin()
        try:
            return super().main(*args, **kwargs)
        except KeyboardInterrupt:  # before a command began, or after it ended
            click.echo("wrod: interrupted", err=True)
            sys.exit(INTERRUPTED)


def _say_usage(error: click.UsageError, path: str | None) -> NoReturn:
    """Say in one sentence what was called wrongly, or how to call, and exit."""
    if type(error).__name__ == "NoArgsIsHelpError":  # older click has none
        error.show()
    else:
        path = path if error.ctx is None else error.ctx.command_path
        click.echo(f"wrod: {cut(error.format_message())} (see {path} --help)", err=True)
    sys.exit(REFUSED)


def _show_warning(message, category, filename, lineno, file=None, line=None):
    if issubclass(category, WrodWarning):
        click.echo(f"wrod: warning: {message}", err=True)
    else:
        _default_show(message, category, filename, lineno, file, line)


_default_show = warnings.showwarning


@click.command(
    cls=LazyGroup,
    package="wrod.commands",
    names=COMMANDS,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(__version__, prog_name="wrod")
def main() -> None:
    """Plan and prove how a robot lays a rod along a pattern."""
    warnings.showwarning = _show_warning
