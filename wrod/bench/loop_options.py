"""What `wrod bench loop` is asked for."""

import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import click

from wrod.options import FOLDER, SOURCE_FOLDER, option

# Who makes the plan: the trained network, the rod solver with the same closure, or what `wrod plan`
# does when nothing else is said.
CONTROLLERS = ("network", "numeric", "default")
EFFECTS = ("natural_curvature", "stiffness", "varied")


@dataclass
class Loop:
    """What is asked for, and how long its parts took [s]."""

    out: Path = option(None, type=FOLDER, required=True)
    effects: tuple[str, ...] = option("Default: all.", "--effect", type=click.Choice(EFFECTS))
    recording: Path | None = option(
        "Recordings of a cable in motion (.npz) instead: what is found in them is planned with, "
        "and lays that cable along a bend of its own size.",
        type=click.Path(dir_okay=False, exists=True, path_type=Path),
    )
    names: tuple[str, ...] = option("Pattern (repeatable); default: seven.", "--pattern")
    patterns: Path | None = option(
        "Folder of pattern files (line.txt, letterA.txt, ...); default: the built-in patterns.",
        type=SOURCE_FOLDER,
    )
    rod_name: str = option("Believed rod.", "--rod", default="green-vps")
    curvature: float = option("Natural curvature [1/m].", default=4.0)
    lgb_error: float = option("Of the believed L_gb.", default=0.15)
    trials: int = option("Clamped shapes measured.", default=16)
    noise: float = option("Of a marker coordinate [m].", default=3e-4)
    candidates: tuple[str, ...] = option(
        "Let the identification try this effect only (repeatable); default: all it knows.",
        "--candidate",
    )
    controllers: tuple[str, ...] = option(
        "Who plans (repeatable); default: network, and default: what `wrod plan` does unasked.",
        "--controller",
        type=click.Choice(CONTROLLERS),
    )
    grasps: int = option("That a curved rod's network learns.", default=2048)
    steps: int | None = option("Of its training; default: the recipe's.")
    friction: float = option("Friction coefficient.", default=1.0)
    known_table: bool = option(
        "Correct new plans for that friction, as `wrod plan --friction` does (a minute or two)."
    )
    rolling: bool = option("Let the laid rod roll freely.")
    roll_text: str | None = option(
        "How all plans hold the rod: plane, as one would by accident who knows of no curvature, "
        "up, tilted, or degrees; default: as `wrod plan` would.",
        "--roll",
    )
    speed: float = option("Speed of the contact [m/s].", default=0.03)
    step: float = option("Largest time step [s].", default=0.02)
    spacing: float = option("Length of the edges [m].", default=0.006)
    seed: int = option("Of poses and noise.", default=0)
    device: str = option("cpu, cuda:0 or auto.", default="cpu")
    seconds: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        from wrod.rods.device import resolve_device

        self.device = resolve_device(self.device)
        self.controllers = self.controllers or ("network", "default")
        if self.recording is not None:
            # Which network would know a cable that nobody has described?
            self.controllers = ("default",)

    @property
    def head(self) -> str:
        """What was simulated, in a sentence."""
        curves = "built-in patterns" if self.patterns is None else "patterns of a folder"
        what = self.rod_name
        if self.recording is not None:
            what = f"the cable found in {self.recording.name}"
            curves = curves if self.names else "a bend of the cable's own size"
        return (
            f"Simulated deployments of {what}, e_mean ± sigma [cm] (N = 50); friction "
            f"{self.friction:g}{', which new plans know' if self.known_table else ''}"
            f"{', rolling freely' if self.rolling else ''}, roll "
            f"{self.roll_text or 'by default'}, contact speed {self.speed:g} m/s, step "
            f"{self.step:g} s, edges {self.spacing:g} m, {curves}."
        )

    @contextmanager
    def timed(self, what: str):
        """Add how long something took."""
        clock = time.perf_counter()
        yield
        self.seconds[what] = self.seconds.get(what, 0.0) + time.perf_counter() - clock
