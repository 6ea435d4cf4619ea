"""What the numbers of every command may be: a range for each option, in one table.

Options are declared where their commands are; here they get their limits, so that a number that
no rod, table or machine has is refused with its option's name before anything is done.
"""

import math
import os

import click

# (lowest, highest) by option, or by command and option where they differ. Lengths are in m, times
# in s. The lowest of what must not be 0 is the least that makes sense.
_SEED = (0, 2**52)  # benchmarks add to it; beyond 2**53 a float would be another
BOUNDS: dict[str, tuple[float, float]] = {
    "--radius": (1e-6, 1.0),
    "--lgb": (1e-4, 100.0),
    "--length": (1e-3, 1e3),
    "--height": (1e-4, 100.0),
    "--density": (1e-2, 1e5),
    "--poisson": (-0.999, 0.5),
    "--friction": (0.0, 100.0),
    "--kinetic": (0.0, 100.0),
    "--spacing": (2e-4, 1.0),
    "--spin": (-5700.0, 5700.0),
    "--scale": (1e-7, 1.0),
    "--trials": (1, 10_000),
    "--speed": (5e-4, 10.0),
    "--release": (0.0, 100.0),
    "--step": (1e-4, 1.0),
    "--chain-step": (1e-4, 0.02),
    "--every": (5e-3, 100.0),
    "--batch": (1, 100_000),
    "--noise": (1e-7, 1.0),
    "--iterations": (0, 100),
    "--seed": _SEED,
    "--seeds": (1, 10_000),
    "--workers": (1, 1024),
    "--threads": (0, 1024),
    "--count": (1, 1_000_000),
    "--minutes": (1e-3, 1e5),
    "--steps": (1, 10**8),
    "--stroke": (1, 100_000),
    "--resize": (1e-6, 1e6),
    "--tolerance": (1e-6, 1.0),
    "compile --jobs": (1, 1024),
    "markers --side": (1e-3, 10.0),
    "markers --margin": (1e-4, 10.0),
    "bench cosserat --elements": (4, 2000),
    "bench cosserat --longer": (1.0, 10.0),
    "measure --overhang": (1e-3, 100.0),
    "measure --fall": (1e-6, 100.0),
    "measure --reading": (1e-6, 1.0),
    "plan --hold": (0.0, 1e3),
    "plan --table-height": (-10.0, 10.0),
    "plan --gripper-length": (1e-3, 10.0),
    "deploy --frames": (1e-3, 1e4),
    "render --frames": (1, 10_000),
    "manifold --length": (0.2, 100.0),
    "manifold --stretch-ratio": (50.0, 1e5),
    "manifold --rays": (5, 2_000),
    "manifold --nudge": (1e-6, 1e3),
    "dataset --size": (1, 2**30),
    "dataset --shard-size": (1, 2**20),
    "distil --size": (16, 10**6),
    "distil --steps": (1, 10**7),
    "distil --rounds": (0, 100),
    "train --generate": (100, 2**29),
    "train --batch": (1, 2**20),
    "train --width": (1, 4096),
    "train --sensitivity-weight": (0.0, 1e6),
    "train --rows": (100, 2**30),
    "train --test": (1, 10**6),
    "bench optimised --together": (0, 10_000),
    "bench optimised --times": (1, 1_000),
    "bench grasp --count": (4, 1_000_000),
    "bench feedback --horizon": (2.0, 1e3),
    "bench feedback --patience": (1e-3, 1e9),
    "--left": (1.0, 1e3),
    "bench manifold --lengths": (2, 10_000),
    "bench perception --repeats": (1, 10_000),
    "bench deploy --levels": (1, 8),
    "bench bends --load": (0.05, 1e3),
    "bench grasp --patience": (0.0, 1e6),
    "bench rounds --rounds": (1, 100_000),
    "bench rounds --knots": (0, 10_000),
    "bench rounds --reefs": (0, 10_000),
    "bench newton --edges": (2, 10_000),
    "bench newton --worlds": (1, 2**20),
    "bench newton --cables": (2, 10_000),
    "bench identify --hidden": _SEED,
    "bench cables --folds": (2, 1_000),
    "bench photographs --damping": (0.0, 1.0),
    "bench photographs --scenarios": (0, 1024),
    "bench hands --folds": (2, 100),
    "bench loop --curvature": (-200.0, 200.0),
    "bench loop --lgb-error": (-0.9, 10.0),
    "bench loop --grasps": (100, 2**24),
    "bench applications --first": (0, 10**9),
}
# Of an option that has no row.
_ANY = (-1e9, 1e9)


class Real(click.FloatRange):
    """A finite number of a range."""

    def convert(self, value, param, ctx):
        found = super().convert(value, param, ctx)
        if not math.isfinite(found):  # NaN is in every range, as no comparison with it holds
            self.fail(f"{value} is not a finite number.", param, ctx)
        return found


class GivenPath(click.Path):
    """A path that says something: an empty one would be the current folder. Where a folder is
    asked for, a device or pipe is none."""

    def convert(self, value, param, ctx):
        if not os.fspath(value):
            self.fail("is empty; give a path.", param, ctx)
        if not self.file_okay and os.path.exists(value) and not os.path.isdir(value):
            self.fail(f"{os.fspath(value)!r} is no folder.", param, ctx)
        return super().convert(value, param, ctx)


def bounded(command: click.Command, path: str) -> click.Command:
    """The command, with a range for each of its numbers.

    Args:
        path: name of the command with its group's, such as "bench table3".
    """
    for option in command.params:
        if isinstance(option.type, click.Path):
            place = GivenPath.__new__(GivenPath)
            place.__dict__.update(option.type.__dict__)
            option.type = place
        if not isinstance(option, click.Option):
            continue
        name = max(option.opts, key=len)
        low, high = BOUNDS.get(f"{path} {name}", BOUNDS.get(name, _ANY))
        kind = option.type
        if isinstance(kind, (click.types.FloatParamType, click.FloatRange)):
            option.type = Real(low, high)
        elif isinstance(kind, (click.types.IntParamType, click.IntRange)):
            option.type = click.IntRange(math.ceil(low), math.floor(high))
    return command
