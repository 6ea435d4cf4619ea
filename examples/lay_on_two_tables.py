"""The same plan laid on a grippy and on a slippery table."""

from pathlib import Path

import numpy as np

import wrod
from wrod.deployment.picture import draw_deployments
from wrod.deployment.simulate import with_remainder_of


def main(out: str | Path = "out/examples", spacing: float = 0.01) -> Path:
    turn = np.linspace(-0.5 * np.pi, 0.2 * np.pi, 80)
    pattern = wrod.Pattern.from_points(0.09 * np.column_stack([np.cos(turn), np.sin(turn)]))
    rod = wrod.RodMaterial(radius=0.0016, gravito_bending_length=0.032, length=0.45)
    trajectory = wrod.plan(pattern, rod)
    trials = [
        wrod.Trial(pattern, rod, trajectory, wrod.Friction(mu), wrod.Disturbance())
        for mu in (0.6, 0.2)
    ]
    laid = wrod.simulate_deployments(
        trials, discretisation=wrod.Discretisation(spacing), speed=0.04
    )
    for trial, one in zip(trials, laid, strict=True):
        print(f"friction {trial.friction.static}: {1e2 * one.error_mean:.2f} cm")
    title = "An arc laid on tables of friction 0.6 and 0.2"
    led = with_remainder_of(pattern, trajectory)
    return draw_deployments(Path(out) / "lay_on_two_tables.png", led, laid, title)


if __name__ == "__main__":
    main()
