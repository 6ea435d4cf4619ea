"""`wrod bench grasp`: cold grasps per second over the whole range, and how cost grows."""

import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import click

from wrod import cost
from wrod.machine import machine_line
from wrod.options import SOURCE_FOLDER, option, own_options, parse_list, refuse_idle_options
from wrod.telling import asked, json_option, tell

# Calls of which the middle one counts.
_CALLS = 3


@click.command(name="grasp")
@own_options
@cost.force_option
@json_option
def command(
    count: int = option("Grasps in the main measurement.", default=512),
    device: str = option("cpu, cuda:0 or auto.", default="auto"),
    threads: int = option("CPU threads.", default=1),
    against: Path | None = option(
        "Folder of another checkout of wrod: its grasps per second beside this one's, medians of "
        "five calls in turn.",
        type=SOURCE_FOLDER,
    ),
    counts: str | None = option(
        "--against: grasps a call, separated by commas. Default: 4096,65536,1048576, on a CPU "
        "256,1024."
    ),
    patience: float = option(
        "--against: take fewer calls of what needs longer than this for five [s].", default=60.0
    ),
    closures: tuple[str, ...] = option(
        "--against: this closure; may be given several times. Default: all.",
        "--closure",
        type=click.Choice(["zero_tension", "min_force", "min_friction"]),
    ),
) -> None:
    """Cold starts over l_s 1..50, |kappa| 0..3.5, k_s 150..15000."""
    from wrod.grasps.inputs import CLOSURES, whole_range
    from wrod.grasps.optimal import solve_grasps
    from wrod.rods.device import resolve_device

    device = resolve_device(device)
    if against is not None:
        refuse_idle_options("--against", "count", "threads", "force")
        counts = counts or ("256,1024" if device == "cpu" else "4096,65536,1048576")
        _compare(against, counts, closures or tuple(CLOSURES), device, patience)
        return
    refuse_idle_options("a measurement without --against", "counts", "closure", "patience")

    on_gpu = device != "cpu"
    # 3.75 times as many grasps, some of them of closures that take twice as long, with shapes.
    work = cost.grasps(
        5 * _CALLS * count, 0, count // 10, sensitivities=False, device=device, ranks=1
    )
    cost.settle(work, f"{3.75 * _CALLS * count:.0f} grasps", "give a smaller --count")

    for closure in CLOSURES:  # compile the kernels outside the clock
        solve_grasps([5.0], [0.5], [1000.0], closure=closure, device=device)
    measure = partial(_measured, device, threads)
    rows = [measure(n) for n in (count // 4, count // 2, count)]
    rows += [measure(count // 2, edge_count=n) for n in (64, 256)]
    rows += [measure(count // 2, closure=c) for c in ("min_force", "min_friction")]
    figures: dict[str, Any] = {"machine": machine_line(device), "device": device, "rows": rows}
    if on_gpu:
        figures["gpu"] = gpu_work(whole_range(count), device)
    else:
        figures["cpu"] = cpu_work(rows[2])
    tell(figures, *_lines(figures, threads))


def _measured(device: str, threads: int, n: int, **options) -> dict:
    """Figures of the middle one of some calls."""
    import warp as wp

    from wrod.grasps.inputs import whole_range
    from wrod.grasps.optimal import EDGE_COUNT, solve_grasps

    inputs = whole_range(n)
    if device != "cpu":  # what is solved there starts and stays there
        inputs = [wp.array(v, dtype=wp.float64, device=device) for v in inputs]
        options["shapes"] = False
        solve_grasps(*inputs, **options)
        wp.synchronize_device(device)
    taken = []
    for _ in range(_CALLS):
        clock, cpu = time.perf_counter(), time.process_time()
        grasps = solve_grasps(*inputs, device=device, threads=threads, **options)
        wp.synchronize_device(device)
        taken.append((time.perf_counter() - clock, time.process_time() - cpu))
    wall, cpu = sorted(taken)[_CALLS // 2]
    return {
        "grasps": n,
        "edges": options.get("edge_count", EDGE_COUNT),
        "closure": options.get("closure", "zero_tension"),
        "per_second": n / wall,
        "cpu_seconds_per_grasp": cpu / n,
        "cores": cpu / wall,
        "converged": float(_numpy(grasps.converged).mean()),
        "iterations": float(_numpy(grasps.iterations).mean()),
    }


def _lines(figures: dict, threads: int) -> Iterator[str]:
    yield f"device {figures['device']}, {threads} thread(s); cold starts over the whole range"
    yield (
        f"{'grasps':>8} {'edges':>6} {'closure':>13} {'per s':>9} {'cpu ms':>8} {'cores':>5} "
        f"{'converged':>10} {'iterations':>10}"
    )
    for row in figures["rows"]:
        yield (
            f"{row['grasps']:8d} {row['edges']:6d} {row['closure']:>13} {row['per_second']:9.1f} "
            f"{1e3 * row['cpu_seconds_per_grasp']:8.3f} {row['cores']:5.2f} "
            f"{row['converged']:10.4f} {row['iterations']:10.1f}"
        )
    if "cpu" in figures:
        yield (
            "by count of operations {gflops:.1f} GFLOP/s of float64, where a core multiplies "
            "matrices with {peak_gflops:.0f}, and {gbytes:.1f} GB/s to and from scratch memory, "
            "where it copies {peak_gbytes:.0f}; {flops_per_byte:.1f} operations a byte: it would "
            "be limited to {bound:.0f} grasps/s a core by {limit}".format(**figures["cpu"])
        )
    if "gpu" in figures:
        yield (
            "one call of {grasps} grasps: {wall:.1f} ms, the GPU works {gpu:.1f} ms of them "
            "({busy:.0%}); {launches} launches, {copies} copies between host and GPU\n"
            "by count of operations {gflops:.0f} GFLOP/s of float64 and {gbytes:.0f} GB/s to and "
            "from scratch memory, {flops_per_byte:.1f} operations a byte: a card of {peak_gflops} "
            "GFLOP/s and {peak_gbytes} GB/s would be "
            "limited to {bound:.0f} grasps/s by {limit}".format(**figures["gpu"])
        )


def _compare(
    other: Path, counts: str, closures: tuple[str, ...], device: str, patience: float
) -> None:
    from wrod.bench.grasp_against import HEAD, compare, line

    numbers = [int(n) for n in parse_list(counts, "--counts", 1, 2**30, whole=True)]
    measured = compare(other, numbers, closures, device, patience)
    if asked("json"):
        tell({"machine": machine_line(device), "rows": list(measured)})
        return
    click.echo(machine_line(device))
    click.echo(HEAD)
    for row in measured:
        click.echo(line(row))


# Float64 and memory of an H200 (data sheet).
PEAK_GFLOPS, PEAK_GBYTES = 34_000, 4_800


def work_of(iterations: float, edges: int) -> tuple[float, float]:
    """(floating point operations, bytes) of a grasp, counted in the source.

    A node of an iteration costs about 330 operations for its stencil, 3 pivots on 8, 7 and 6
    entries below them and 4 border columns, 2 operations each, and the way back; it writes and
    reads 21 second derivatives, 42 numbers of the factor, and 12 of load, motion and shape. Two
    thirds of the iterations are on a quarter of the edges, the others on half and on all of them.
    """
    nodes = iterations * edges * (0.66 * 0.25 + 0.17 * 0.5 + 0.17)
    operations = 330 + 2 * sum(k * (k + 1) / 2 + 4 * k + 10 for k in (8, 7, 6)) + 2 * 3 * 12
    return nodes * operations, nodes * 8 * (2 * 21 + 2 * 42 + 3 * 12)


def gpu_work(inputs, device: str) -> dict:
    """What one call does on a GPU: how long it works, launches, copies, and where limits lie."""
    import warp as wp

    from wrod.grasps.optimal import EDGE_COUNT, solve_grasps

    inputs = [wp.array(v, dtype=wp.float64, device=device) for v in inputs]

    def solve():
        grasps = solve_grasps(*inputs, shapes=False)
        wp.synchronize_device(device)
        return grasps

    walls = []
    for _ in range(3):
        clock = time.perf_counter()
        grasps = solve()
        walls.append(1e3 * (time.perf_counter() - clock))
    wp.timing_begin(cuda_filter=wp.TIMING_ALL)
    solve()
    events = wp.timing_end()
    wall, gpu = sorted(walls)[1], sum(event.elapsed for event in events)
    work = work_of(float(grasps.iterations.numpy().mean()), EDGE_COUNT)
    return {
        "grasps": len(grasps),
        "wall": wall,
        "gpu": gpu,
        "busy": gpu / wall,
        "launches": sum("kernel" in event.name for event in events),
        "copies": sum("memcpy" in event.name and "DtoD" not in event.name for event in events),
        **_roofline(work, 1e3 * len(grasps) / gpu, PEAK_GFLOPS, PEAK_GBYTES),
    }


def cpu_work(row: dict) -> dict:
    """What a CPU does for the grasps of a row, and where the limits of one core lie, which are
    measured: a product of matrices, and a copy of more than caches hold."""
    import numpy as np

    def best(do) -> float:
        walls = []
        for _ in range(5):
            cpu = time.process_time()
            do()
            walls.append(time.process_time() - cpu)
        return min(walls)

    size = 768
    a = np.ones((size, size))
    source = np.ones(2**24)
    target = np.empty_like(source)
    peaks = (
        2e-9 * size**3 / best(lambda: a @ a),
        2e-9 * source.nbytes / best(lambda: np.copyto(target, source)),
    )
    # A few grasps may take less than the clock of processors tells apart.
    rate = 1.0 / (row["cpu_seconds_per_grasp"] or 1.0 / row["per_second"])
    return _roofline(work_of(row["iterations"], row["edges"]), rate, *peaks)


def _roofline(work: tuple[float, float], rate: float, gflops: float, gbytes: float) -> dict:
    """Operations and bytes a second at a rate of grasps [1/s], and the limit under peaks."""
    operations, moved = work
    bounds = {"arithmetic": gflops * 1e9 / operations, "memory": gbytes * 1e9 / moved}
    limit = min(bounds, key=lambda name: bounds[name])
    return {
        "gflops": operations * rate / 1e9,
        "gbytes": moved * rate / 1e9,
        "flops_per_byte": operations / moved,
        "peak_gflops": gflops,
        "peak_gbytes": gbytes,
        "bound": bounds[limit],
        "limit": limit,
    }


def _numpy(array):
    return array.numpy() if hasattr(array, "numpy") else array
