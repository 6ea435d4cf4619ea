"""`wrod deploy PATTERN`: lay the rod in simulation and measure how well it lies."""

from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import click

from wrod import cost
from wrod.commands.options import (
    DEVICE,
    UNITS,
    PatternOptions,
    RodOptions,
    closure_option,
    method_option,
)
from wrod.options import FILE, FOLDER, gathered, option, own_options, refuse_idle_options
from wrod.telling import json_option, tell

_PAGE_INTERVAL = 0.25  # [s] between the states that the page shows


@dataclass(frozen=True)
class Planned:
    """What the grip follows."""

    trajectory: Path | None = option(
        "Trajectory (.npz) that `wrod plan` wrote, instead of a new plan.", type=FILE
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
        "Scene file (.json) of posts and clips to lay the rod between.", "--fixtures", type=FILE
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
        with cost.share_bar("laid") as progress:
            return simulate_deployments(
                jobs,
                speed=self.pace(path),
                release=self.release,
                frame_interval=self.interval,
                device=device,
                beyond_grip=whole,
                progress=progress,
            )


@click.command(name="deploy")
@click.argument("pattern")
@gathered("rod_options", RodOptions)
@own_options
@gathered("planned", Planned)
@gathered("reading", PatternOptions, UNITS)
@gathered("laying", Laying)
@DEVICE
@cost.force_option
@json_option
def command(
    pattern: str,
    rod_options: RodOptions,
    planned: Planned,
    reading: PatternOptions,
    laying: Laying,
    device: str,
    out: Path = option(None, type=FOLDER, required=True),
) -> None:
    """Lay a rod along PATTERN in simulation, and measure it.

    The free end's first 5 cm are held at first. The rod is measured at the end of the pattern with
    the grip holding, and again after the grip laid the tail straight ahead and let go.
    """
    from wrod.deployment.fixtures import Fixtures
    from wrod.solvers.friction import Friction

    planned.check()
    rod, curve = rod_options.read(), reading.read(pattern)
    Friction(laying.friction, laying.kinetic, laying.rolling)  # refused before it is planned
    file = laying.fixtures_file
    fixtures = None if file is None else Fixtures.load(file)
    given = rod
    path, curve, rod = planned.path(curve, rod, device)
    whole = given.length > rod.length
    laying.settle(path, device)
    deployments = laying.lay(curve, rod, path, fixtures, device, planned.another_rod, whole)
    written = _write(out, laying, deployments, path, curve, rod, fixtures)
    placed = [
        fixtures and fixtures.judge(d.released_centerline, rod.radius, d.released_speed)
        for d in deployments
    ]
    figures = {
        "pattern": curve.name,
        "method": path.method,
        "beyond_grip": path.beyond_grip,
        "friction": {
            "static": laying.friction,
            "kinetic": laying.kinetic or laying.friction,
            "rolling": laying.rolling,
        },
        "trials": [
            _figures(d, one) | ({"lies_beyond": _lying(d, rod)} if whole else {})
            for d, one in zip(deployments, placed, strict=True)
        ],
        "written": [str(name) for name in written],
    }
    tell(
        figures,
        *(
            f"trial {k}: "
            + ("diverged; the last good state is " if d.diverged else "")
            + f"{100 * d.error_mean:.3f} ± {100 * d.error_std:.3f} cm with the grip holding, "
            f"{100 * d.released_error_mean:.3f} ± {100 * d.released_error_std:.3f} cm let go; "
            f"largest slip {100 * d.slip.max():.2f} cm"
            + (
                f"; of {path.beyond_grip:.3f} m beyond the grip {_lying(d, rod):.3f} m are on the "
                "table"
                if whole
                else ""
            )
            + ("" if placed[k] is None else f"; {placed[k]}")
            for k, d in enumerate(deployments)
        ),
    )


def _lying(deployment, rod) -> float:
    """How much of what is beyond the grip is on the table while that still holds [m]: from where
    it first touches."""
    s = deployment.arc_length
    touched = (s > rod.length) & deployment.contact_force.any(axis=1)
    return float(s[-1] - s[touched.argmax()]) if touched.any() else 0.0


def _write(out: Path, laying: Laying, deployments: list, path, curve, rod, fixtures) -> list[Path]:
    """Write the deployments, their picture, and the page of one."""
    from wrod.deployment.picture import draw_deployments

    title = f"{curve.name} · {path.method or ''} · friction {laying.friction:g}"
    names = ["deployment"]
    if laying.trials > 1:
        names = [f"deployment-{k}" for k in range(laying.trials)]
    kept = deployments
    if laying.frames is None:  # they were for the page alone
        kept = [replace(d, frames=None, hand=None) for d in deployments]
    written = [d.save(out / name) for d, name in zip(kept, names, strict=True)]
    written.append(draw_deployments(out / "deployment.png", curve, kept, title, fixtures))
    seen = deployments[0]
    if laying.paged and seen.frames is not None and len(seen.frames) > 1:
        from wrod.scene.page import write_laying_page

        page = out / "deployment.html"
        written.append(write_laying_page(page, seen, path, curve, rod, laying.interval))
    return written


def _figures(deployment, placed) -> dict:
    """What one trial came to, with the gates that it went through where there are any."""
    own = {
        "error_mean": deployment.error_mean,
        "error_std": deployment.error_std,
        "released_error_mean": deployment.released_error_mean,
        "released_error_std": deployment.released_error_std,
        "largest_slip": float(deployment.slip.max()),
        "diverged": deployment.diverged,
    }
    if placed is None:
        return own
    return own | {
        "placed": placed.placed,
        "gates": placed.gates.tolist(),
        "released_speed": deployment.released_speed,
        "penetration": deployment.penetration,
    }
