"""`wrod bench rounds`: what a round of time steps costs, on a GPU kernel by kernel."""

import time
from collections import Counter
from collections.abc import Iterator
from itertools import cycle, islice, product

import click

from wrod import cost
from wrod.machine import machine_line
from wrod.options import option, own_options, parse_list
from wrod.telling import json_option, tell

# Simulated seconds after which a batch is looked at, and that it is timed for.
_AFTER, _TIMED = 4.0, 1.0
_STEP = 0.01
# Of knots that hands pull, each at this speed [m/s]: when they are nearly tight.
_PULLED, _SPEED = (5.0, 1.5), 0.03
_SHOWN = 12


@click.command(name="rounds")
@own_options
@json_option
def command(
    counts: str = option(
        "Deployments at once, separated by commas: of table 3, one trial of each cell first.",
        "--rods",
        default="1260,100,10",
    ),
    knots: int = option("Trefoils at once; 0: none.", default=10),
    reefs: int = option("Ready-made reef knots that are pulled; 0: none.", default=0),
    rounds: int = option("Rounds that are looked at.", default=200),
    device: str = option("cpu, cuda:0 or auto.", default="auto"),
) -> None:
    """A round is a Newton iteration of every rod that is under way, or ends its step.

    Times of kernels, on a GPU, are of rounds that are launched one by one; a round's own time is as
    simulations take them, on a GPU of a graph. A CPU takes a few seconds for ten rods.
    """
    import wrod.kernels  # noqa: F401  # starts Warp quietly
    from wrod.rods.device import resolve_device

    device = resolve_device(device)
    numbers = [int(count) for count in parse_list(counts, "--rods", 1, 100_000, whole=True)][::-1]
    # Of a plan of each cell, then a length that is laid in five seconds.
    laid = cost.deployments(sum(numbers), 0.1, speed=0.02, step=_STEP, spacing=5e-4, device=device)
    seconds = laid.seconds + knots * cost.APPLICATION["trefoil"] + cost.BEND * reefs
    work = cost.Cost(seconds, laid.memory + 1e7 * knots + 2e7 * reefs)
    what = f"{sum(numbers)} deployments and {knots + reefs} knots"
    cost.settle(work, what, "ask for fewer --rods, --knots or --reefs")
    rows = [_deployments(count, rounds, device) for count in numbers]
    if knots:
        rows.append(_knots(knots, rounds, device))
    if reefs:
        rows.append(_reefs(reefs, rounds, device))
    lines = (line for row in rows for line in _lines(row))
    tell({"machine": machine_line(device), "rows": rows}, *lines)


def _lines(row: dict) -> Iterator[str]:
    yield (
        f"{row['rods']} {row['what']} of {row['nodes']} nodes: {row['round']:.3f} ms a round, "
        f"{row['rounds_a_second']:.0f} rounds a simulated second"
        + (f", set up by the host in {row['setup']:.2f} s" if "setup" in row else "")
    )
    if row["kernels"]:
        yield (
            f"  one by one the GPU works {row['work']:.3f} ms in {row['launches']:.0f} launches, "
            "of which"
        )
    for name, milliseconds in row["kernels"]:
        yield f"  {1e3 * milliseconds:8.1f} us  {name}"


def _deployments(count: int, rounds: int, device: str) -> dict:
    """Those of table 3, by its command's defaults."""
    from wrod.bench.table3 import _plans, _trial
    from wrod.bench.table3_paper import METHODS, PATTERNS, RODS, SUBSTRATES, read_pattern
    from wrod.deployment.assembly import assemble
    from wrod.deployment.discretisation import USUAL
    from wrod.deployment.simulate import prepare_trials

    plans = _plans(RODS, {name: read_pattern(name, None) for name in PATTERNS}, None, None, device)
    keys = product(range(10), RODS, SUBSTRATES, PATTERNS, METHODS)
    keys = [(rod, table, name, method, trial) for trial, rod, table, name, method in keys]
    trials = [_trial(key, plans) for key in islice(cycle(keys), count)]
    clock = time.perf_counter()
    setups = prepare_trials(trials, 0.05, 0.05, 0.02, USUAL)
    _, _, dynamics = assemble(trials, setups, device=device)
    seconds = time.perf_counter() - clock
    return {"what": "deployments", "setup": seconds, **_timed(dynamics, 0.0, rounds)}


def _knots(count: int, rounds: int, device: str) -> dict:
    """Trefoils that have just been laid, their hands at rest."""
    from wrod.bench.applications_trials import KNOT_FRICTION, ROD_FRICTION, knot_plan
    from wrod.knots.laying import lay
    from wrod.knots.trials import Handling
    from wrod.knots.tying_run import TyingRun

    trials = [Handling.random(seed) for seed in range(count)]
    run = TyingRun(
        knot_plan("trefoil"), trials, "neural", KNOT_FRICTION, ROD_FRICTION, 0.03, 0.06, _STEP,
        None, device,
    )  # fmt: skip
    lay(run, 0)
    return {"what": "knots", **_timed(run.bench.dynamics, run.bench.time, rounds)}


def _reefs(count: int, rounds: int, device: str) -> dict:
    """Ready-made reef knots, as `wrod bench bends` lays them, while two hands pull them tight."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    from wrod.bench.applications_trials import KNOT_FRICTION, ROD_FRICTION
    from wrod.bench.bend_shapes import bend
    from wrod.knots.workbench import Poses, Workbench
    from wrod.rods.catalogue import rod
    from wrod.solvers.friction import Friction

    pair = [rod("green-vps"), rod("pink-vps-thick")]
    lines, arcs = bend("reef knot", pair)
    position = np.tile(np.concatenate(lines), (count, 1, 1))
    director = np.cross(np.diff(position, axis=1), [0.1, 0.2, 1.0])
    friction = (Friction(KNOT_FRICTION), Friction(ROD_FRICTION))
    bench = Workbench([pair] * count, arcs, position, director, friction, device=device)

    def hands(gone: float) -> list[Poses]:
        ends = [line[:2].mean(axis=0) for line in lines]
        places = [end + [way, 0.0, 0.0] for end, way in zip(ends, (-gone, gone), strict=True)]
        return [Poses(np.tile(place, (count, 1)), Rotation.identity(count)) for place in places]

    for hand, (nodes, poses) in enumerate(zip(bench.slices, hands(0.0), strict=True)):
        for scene in range(count):
            bench.held.grasp(scene, hand, nodes.start, poses)
    after, timed = _PULLED
    bench.plan([0.0, after + timed], [hands(0.0), hands(_SPEED * (after + timed))])
    return {"what": "reef knots", **_timed(bench.dynamics, 0.0, rounds, after, timed)}


def _timed(dynamics, now: float, rounds: int, after: float = _AFTER, timed: float = _TIMED) -> dict:
    """What rounds of a simulation that has come to the time `now` cost, so long after it."""
    import warp as wp

    batch = dynamics.batch
    before = dynamics.advance(now + after, _STEP)
    wp.synchronize_device(batch.device)
    clock = time.perf_counter()
    after = dynamics.advance(now + after + timed, _STEP)
    seconds = time.perf_counter() - clock
    # A step is judged in a round of its own, after its iterations.
    rounds_of = [progress.iterations + progress.steps for progress in (before, after)]
    taken = int((rounds_of[1] - rounds_of[0]).max())
    on_gpu = wp.get_device(batch.device).is_cuda
    spent, launches = Counter(), 0
    for name, milliseconds in dynamics.launch_times(now + 1e3, _STEP, rounds) if on_gpu else ():
        spent[name.removeprefix("forward kernel ")] += milliseconds / rounds
        launches += 1
    return {
        "rods": batch.rod_count,
        "nodes": batch.node_count,
        "round": 1e3 * seconds / taken,
        "rounds_a_second": taken / timed,
        "work": sum(spent.values()),
        "launches": launches / rounds,
        "kernels": spent.most_common(_SHOWN),
    }
