"""What `wrod deploy` lays, and how: its options and what they say."""

from dataclasses import dataclass
from pathlib import Path

import click

from wrod import cost
from wrod.commands.options import closure_option, method_option
from wrod.options import option, refuse_idle_options

_PAGE_INTERVAL = 0.25  # [s] between the states that the page shows


@dataclass(frozen=True)
class Planned:
    """What the grip follows."""

    trajectory: Path | None = option(
        "Trajectory (.npz) that `wrod plan` wrote, instead of a new plan.",
        type=click.Path(dir_okay=False, path_type=Path),
    )
    another_rod: bool = option("Lay another rod than that of the trajectory, on purpose.")
    method: str = method_option()
    closure: str | None = closure_option()

    def check(self) -> None:
        """Refuse options that would do nothing."""
        if self.trajectory is not None:
            refuse_idle_options("--trajectory", "method", "closure")
        else:
            refuse_idle_options("a new plan", "another-rod")
        if self.method == "intuitive":
            refuse_idle_options("--method intuitive", "closure")

    def path(self, curve, rod, device: str):
        """The trajectory, read or made, the pattern with its remainder, and the rod as the grip
        holds it."""
        from wrod.deployment.bounds import refuse_another_pattern, refuse_another_rod
        from wrod.deployment.plan import plan
        from wrod.deployment.simulate import with_remainder_of
        from wrod.planning.hold import as_held
        from wrod.planning.trajectory import Trajectory

        if self.trajectory is None:
            chosen = None if device == "auto" else device
            path = plan(curve, rod, self.method, closure=self.closure, device=chosen)
            return path, with_remainder_of(curve, path), rod
        path = Trajectory.load(self.trajectory)
        curve, rod = with_remainder_of(curve, path), as_held(path, rod)
        refuse_another_pattern(path, curve)
        if not self.another_rod:
            names = ("length", "radius", "gravito_bending_length")
            refuse_another_rod(path, rod, names, ", or --another-rod to lay this one all the same")
        return path, curve, rod


@dataclass(frozen=True)
class Laying:
    """The world that the rod is laid in, and how."""

    friction: float = option("Static friction coefficient.", default=0.6)
    kinetic: float | None = option("Kinetic friction coefficient; default: the static.")
    fixtures_file: Path | None = option(
        "Scene file (.json) of posts and clips to lay the rod between.",
        "--fixtures",
        type=click.Path(dir_okay=False, path_type=Path),
    )
    rolling: bool = option("Let the laid rod roll freely.")
    trials: int = option("Disturbed trials; 1 is the ideal.", default=1)
    speed: float | None = option("Speed of the contact [m/s]; that of the plan, or 0.02.")
    release: float = option(
        "Laid length at which the free end, held for 5 cm, is let go [m].", default=0.05
    )
    frames: float | None = option("Keep the rod's states at this interval [s].")

    @property
    def interval(self) -> float | None:
        """Time between the states that are kept [s], if only for the page."""
        return _PAGE_INTERVAL if self.frames is None and self.paged else self.frames

    @property
    def paged(self) -> bool:
        """Whether a page shows the laying."""
        from importlib.util import find_spec

        return find_spec("viser") is not None and self.trials == 1

    def pace(self, path) -> float:
        """Speed of the contact [m/s]: as asked for, or what the path was corrected for."""
        from wrod.planning.pace import USUAL_PACE, pace_of

        return self.speed or pace_of(path) or USUAL_PACE

    def settle(self, path, device: str) -> None:
        """Say what it costs, and refuse what costs too much."""
        how = {"speed": self.pace(path), "step": 0.01, "spacing": 0.005}
        work = cost.deployments(self.trials, float(path.arc_length[-1]), device=device, **how)
        remedy = "ask for fewer --trials or a larger --speed"
        cost.settle(work, f"{self.trials} deployments", remedy)

    def lay(self, curve, rod, path, fixtures, device: str, another_rod: bool, whole: bool) -> list:
        """The deployments, one for each trial, of the `whole` rod or of it as far as the grip."""
        from wrod.deployment.setup import Disturbance
        from wrod.deployment.simulate import Trial, simulate_deployments
        from wrod.planning.tail import tail
        from wrod.solvers.friction import Friction

        law, rest = Friction(self.friction, self.kinetic, self.rolling), tail(curve, rod, path)
        ideal = self.trials == 1
        jobs = [
            Trial(
                curve,
                rod,
                path,
                law,
                Disturbance() if ideal else Disturbance.random(seed),
                rest,
                fixtures,
                another_rod,
            )
            for seed in range(self.trials)
        ]
        shown = "{desc}: {percentage:3.0f}% |{bar}| {elapsed} < {remaining}"
        with cost.progress_bar(total=100, desc="laid", bar_format=shown) as bar:
            return simulate_deployments(
                jobs,
                speed=self.pace(path),
                release=self.release,
                frame_interval=self.interval,
                device=device,
                beyond_grip=whole,
                progress=lambda fraction: bar.update(min(100 * fraction, bar.total - bar.n)),
            )
