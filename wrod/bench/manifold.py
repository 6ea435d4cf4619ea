"""`wrod bench manifold`: held grips per second, the boundary for many lengths, stability's cost."""

import time
from typing import Any

import click

from wrod import cost
from wrod.machine import machine_line
from wrod.options import option, own_options
from wrod.telling import json_option, tell


def held_inputs(count: int):
    """Grip positions about the optimal grasps of rods of 2 to 30 L_gb, all directions above."""
    import numpy as np

    rng = np.random.default_rng(0)
    length = np.exp(rng.uniform(np.log(2.0), np.log(30.0), count))
    angle = rng.uniform(0.2, 2.0, count)
    side = rng.uniform(-0.3, 0.3, count)
    radius = length * rng.uniform(0.85, 0.97, count)
    direction = np.stack([np.cos(angle), np.sin(side), np.sin(angle)], axis=1)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return radius[:, None] * direction, length, np.full(count, 2087.0)


@click.command(name="manifold")
@own_options
@cost.force_option
@json_option
def command(
    count: int = option("Held grips.", default=512),
    lengths: int = option("Values of l_s for the boundary.", default=50),
    device: str = option("cpu, cuda:0 or auto.", default="auto"),
    threads: int = option("CPU threads; 0: one per core.", default=0),
) -> None:
    """Equilibria for given grips, the manifold's boundary, and what stability adds to a plan."""
    import numpy as np

    from wrod.grasps.manifold.boundary import DIPS, EMPTY, FOLDS, TOUCHES, boundary
    from wrod.grasps.manifold.grips import equilibrium
    from wrod.grasps.optimal import solve_grasps
    from wrod.rods.device import resolve_device

    device = resolve_device(device)
    work = cost.manifold(count, lengths, device=device)
    cost.settle(work, f"{count} grips and {lengths} boundaries", "give smaller numbers")
    options: dict[str, Any] = {"device": device, "threads": threads or None}

    def clocked(work):
        work_clock, cpu = time.perf_counter(), time.process_time()
        result = work()
        return result, time.perf_counter() - work_clock, time.process_time() - cpu

    # Compile the kernels outside the clock.
    equilibrium([2.5, 0.0, 3.0], 5.0, 2087.0, **options)
    solve_grasps([5.0], [0.5], [2087.0], eigenvalues=True, **options)

    position, length, ratio = held_inputs(count)
    held, wall, cpu = clocked(lambda: equilibrium(position, length, ratio, **options))
    figures: dict[str, Any] = {
        "machine": machine_line(device),
        "device": device,
        "equilibria": count,
        "equilibria_per_second": count / wall,
        "equilibria_cpu_ms": 1e3 * cpu / count,
        "converged": float(held.converged.mean()),
        "admissible": float(held.admissible.mean()),
        "iterations": float(held.iterations.mean()),
    }
    ls = np.exp(np.linspace(np.log(2.0), np.log(50.0), lengths))
    edge, wall, cpu = clocked(lambda: boundary(ls, 2087.0, **options))
    ends = {"dips": DIPS, "touches": TOUCHES, "folds": FOLDS, "empty": EMPTY}
    figures |= {
        "boundary_lengths": lengths,
        "boundary_rays": len(edge.angle),
        "boundary_seconds": wall,
        "boundary_cpu_seconds": cpu,
        "boundary_ends": {name: int(np.sum(edge.kind == kind)) for name, kind in ends.items()},
    }
    # Grasps of a whole trajectory; medians, since the difference is small.
    ls, kappa = np.linspace(25.0, 5.0, 200), 1.5 * np.sin(np.linspace(0.0, 9.0, 200))
    times = {False: [], True: []}
    for _ in range(5):
        for eigenvalues, seen in times.items():
            _, _, cpu = clocked(
                lambda e=eigenvalues: solve_grasps(ls, kappa, 2087.0, eigenvalues=e, **options)
            )
            seen.append(cpu)
    solving, both = (float(np.median(times[key])) for key in (False, True))
    figures |= {
        "trajectory_grasps": 200,
        "solving_cpu_seconds": solving,
        "stability_cpu_seconds": both - solving,
    }
    counts = ", ".join(f"{n} {name}" for name, n in figures["boundary_ends"].items())
    tell(
        figures,
        f"{count} held grips on {device}: {figures['equilibria_per_second']:.1f} per s, "
        f"{figures['equilibria_cpu_ms']:.2f} CPU ms each, {figures['iterations']:.1f} iterations, "
        f"{figures['converged']:.1%} converged, {figures['admissible']:.1%} admissible",
        f"boundary for {lengths} suspended lengths, {figures['boundary_rays']} rays each: "
        f"{figures['boundary_seconds']:.1f} s ({figures['boundary_cpu_seconds']:.1f} CPU s); "
        f"low ends: {counts}",
        f"200 grasps of a trajectory: solving {figures['solving_cpu_seconds']:.3f} CPU s, "
        f"their stability {figures['stability_cpu_seconds']:.3f} CPU s",
    )
