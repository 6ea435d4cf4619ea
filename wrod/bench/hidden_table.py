"""The confusion table of `wrod bench identify --hidden`: what was hidden, what was found."""

import math
import traceback
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from wrod.bench.hidden_effects import DRAUGHT_END, KINK_WIDTH, MAGNET_REACH, Truth
from wrod.identification.effect import Effect

# A direction is right within the same 5 %, of a radian.
WITHIN = 0.05
# What is built is found where it is to so many m, and as large as it is to such a share.
_LOCATED, _SIZED = 0.01, 0.15
# Parameters of built effects that say where they are [m].
_PLACES = {"arc_length", "start", "stop", "x", "y", "z"}
# Standard errors either side of an 80 % interval.
_OF_80 = 1.2816
OUTCOMES = (
    "right",
    "near",
    "confounded",
    "incomplete",
    "unexplained",
    "wrong",
    "false alarm",
    "refused",
    "failed",
)


def examine(
    case: str,
    seed: int,
    noise: str = "white",
    device: str = "cpu",
    seconds: float | None = None,
) -> dict:
    """Make one set, identify it, and compare what is said with what was hidden."""
    from wrod.bench.hidden_sets import NEAR, OTHER_LAWS, UNCOVERED, hidden_set
    from wrod.bench.identify_row import row
    from wrod.errors import DataError
    from wrod.identification.clamped.loading import measurements_from_arrays

    key, so_far = {"set": case, "seed": seed, "noise": noise}, "not made"
    try:
        data, hidden = hidden_set(case, seed, noise)
        measurements = measurements_from_arrays(data, name=case)
        so_far = "refused"
        entry = row(measurements, device, seconds)
    except DataError as error:
        return key | {"outcome": so_far, "reason": str(error)}
    except Exception as error:  # a fault of the program: the other sets are to be seen all the same
        at = traceback.extract_tb(error.__traceback__)[-1]
        said = f"{type(error).__name__} at {Path(at.filename).name}:{at.lineno}: {error}"
        whole = "".join(traceback.format_exception(error))
        return key | {"outcome": "failed", "reason": said, "traceback": whole}
    found = {effect["name"]: effect["parameters"] for effect in entry["effects"]}
    worst, deviations = error_of(found, hidden.truth)
    akin, prints = NEAR.get(case, ((), ()))
    return entry | {
        "seed": seed,
        "noise": noise,
        "hidden": sorted(hidden.truth),
        "truth": {
            name: [[list(keys), list(values)] for keys, values in own.items()]
            for name, own in hidden.truth.items()
        },
        "outcome": outcome(entry, set(hidden.truth), case in UNCOVERED, case in OTHER_LAWS, akin),
        "print_near": entry["likeliest_print"] in prints if prints else None,
        "worst_error": worst,
        "worst_deviations": deviations,
        "limit": limit_of(measurements, hidden.truth),
    }


def outcome(
    entry: dict,
    hidden: set[str],
    uncovered: bool,
    other_law: bool = False,
    akin: Sequence[str] = (),
) -> str:
    """One of `OUTCOMES`.

    right: exactly the hidden names; for what no plug-in covers, no verdict of `explained`; for a
        law of bending that is none of the known ones, a law of its own as well as the nearest.
    near: what no plug-in covers is `explained` by effects, or by what is another one in each trial,
        that are `akin` to it; so is a profile that an effect that is built comes near to.
    confounded: a name is wrong, but the report says that the data do not tell it from the true one.
    incomplete: only true names, not all. unexplained: no name, though there is one.
    wrong: a name that is not hidden. false alarm: a name for a rod without an effect.
    """
    found = {effect["name"] for effect in entry["effects"]}
    changing = {one["name"] for one in entry.get("scatter", ())}
    if other_law and "moment_law" in found:
        found = (found - {"moment_law"}) | hidden
    if uncovered:
        if entry["verdict"] not in ("explained", "adequate"):
            return "right"
        found |= changing
        return "near" if found and found <= set(akin) else "wrong"
    if akin and not uncovered and found and found <= set(akin):
        return "near"
    if found == hidden:
        return "right" if entry["verdict"] in ("explained", "adequate") else "incomplete"
    if not hidden:
        return "false alarm"
    if not found:
        return "unexplained"
    if found < hidden:
        return "incomplete"
    for pair in entry["confounded"]:
        mine, other = (set(part.split(" + ")) for part in pair["effects"])
        for swapped in ((found - mine) | other, (found - other) | mine):
            if swapped == hidden:
                return "confounded"
    return "wrong"


def error_of(found: dict, truth: dict) -> tuple[float | None, float | None]:
    """(relative error, error in standard errors) of the worst parameter that was named rightly; of
    a profile, which may be nothing somewhere, relative to the largest value along the rod."""
    errors, deviations = [], []
    for name, own in truth.items():
        largest = max((math.hypot(*v) for v in own.values()), default=0.0)
        for keys, values in own.items() if name in found else ():
            parts = [found[name][key] for key in keys]
            away = [p["value"] - v for p, v in zip(parts, values, strict=True)]
            size = largest if name.startswith("profile_of_") else math.hypot(*values)
            if parts[0]["unit"] == "deg":  # principal directions repeat after half a turn
                away = [math.radians((away[0] + 90.0) % 180.0 - 90.0)]
                parts, size = [{"stderr": math.radians(parts[0]["stderr"])}], 1.0
            errors.append(math.hypot(*away) / size)
            spread = math.sqrt(sum(p["stderr"] ** 2 for p in parts) / len(parts))
            deviations.append(math.hypot(*away) / math.sqrt(len(away)) / max(spread, 1e-300))
    return (max(errors), max(deviations)) if errors else (None, None)


def limit_of(measurements, truth: dict[str, Truth]) -> tuple[float, float] | None:
    """(place [m], share of the size), the worst of each: the least root mean square error of any
    unbiased estimate of a built effect from the trials to fit, by the bound of Cramer and Rao: at
    its true values, by the declared noise, rod and set-up known, the effect's other numbers not;
    None where nothing is built or the rods have no equilibrium with it.
    """
    from wrod.errors import DataError
    from wrod.identification.clamped.laboratory import Laboratory
    from wrod.identification.effect import Model

    true = _built(truth, measurements.material)
    if true is None:
        return None
    effect, values = true
    laboratory, scale = Laboratory(measurements), np.array([p.scale for p in effect.parameters])
    try:
        rates = laboratory.jacobian(Model((effect,)), values)[1][measurements.train]
    except DataError:
        return None
    rates = laboratory.whiten(rates, measurements.train).reshape(-1, len(values)) * scale
    bound = np.linalg.inv(rates.T @ rates) * np.outer(scale, scale)
    told = effect.describe(values, bound, measurements)
    parts = [part for own in truth.values() for part in own.items()]
    return _worst(parts, {key: told[key].stderr for keys, _ in parts for key in keys})


def _built(truth: dict[str, Truth], rod) -> tuple[Effect, np.ndarray] | None:
    """The effect that `identify` builds of what is hidden, and its true values."""
    from wrod.identification.clamped import described

    t = {
        key: value
        for own in truth.values()
        for keys, part in own.items()
        for key, value in zip(keys, part, strict=True)
    }
    if "local_bend" in truth:
        values = [t["angle_1"], t["angle_2"], t["arc_length"], math.log(KINK_WIDTH)]
        kind: type[described.Described] = described.LocalBend
    elif "stretch" in truth:
        length, line = t["stop"] - t["start"], rod.weight / rod.gravity
        gain = t.get("extra_mass", 0.0) / (line * length)
        softer = math.log1p(t["extra_compliance"] / length)
        kind, values = described.Stretch, [-softer, gain, t["start"], math.log(length), 0.0]
    elif "local_load" in truth:
        length = rod.length - t["start"]
        breadth = math.hypot(length, 2.0 * math.pi * DRAUGHT_END)
        load = [length * t[f"force_{axis}"] for axis in "xyz"]
        softness = math.log(DRAUGHT_END / length / described.SOFT_END)
        kind = described.LocalLoad
        values = [*load, t["start"] + 0.5 * length, breadth, softness]
    elif "attraction" in truth:
        kind, reach = described.Attraction, math.log(MAGNET_REACH)
        values = [t["strength"], t["x"], t["y"], t["z"], reach]
    else:
        return None
    return kind([values]), np.array(values)


def _worst(parts, away: dict[str, float]) -> tuple[float, float]:
    """(largest error [m] of a place, largest error of a size relative to it).

    Args:
        parts: (keys, true values), those of a vector together; away: by key, how far off.
    """
    places, sizes = [0.0], [0.0]
    for keys, values in parts:
        off = [away[key] for key in keys]
        if set(keys) <= _PLACES:
            places += [math.hypot(*off)] if "x" in keys else map(abs, off)
        else:
            sizes.append(math.hypot(*off) / math.hypot(*values))
    return max(places), max(sizes)


def located(row: dict) -> tuple[float, float]:
    """(error [m] of the worst place, relative error of the worst size) of a built effect."""
    told = {k: e["value"] for effect in row["effects"] for k, e in effect["parameters"].items()}
    parts = [part for own in row["truth"].values() for part in own]
    true = [kv for keys, part in parts for kv in zip(keys, part, strict=True)]
    return _worst(parts, {key: told[key] - value for key, value in true})


def _near(place: float, size: float) -> bool:
    return place <= _LOCATED and size <= _SIZED


def held(row: dict) -> tuple[int, int]:
    """(how many of the true values an 80 % interval holds, of how many that are told, of profiles
    at the quarters of the rod), whatever the effect that tells them is called."""
    from wrod.identification.clamped.profiles import KNOTS

    told = {key: e for effect in row["effects"] for key, e in effect["parameters"].items()}
    inside = [
        abs(told[key]["value"] - value) <= _OF_80 * told[key]["stderr"]
        for own in row["truth"].values()
        for first in range(0, len(own), KNOTS)
        for keys, values in own[
            first : first + KNOTS : (KNOTS - 1) // 4 if len(own) >= KNOTS else 1
        ]
        for key, value in zip(keys, values, strict=True)
        if key in told
    ]
    return sum(inside), len(inside)


def lines(rows: Sequence[dict]) -> list[str]:
    """The table for people."""
    text = [
        f"{'hidden':38} {'seed':>4} {'noise':14}  {'outcome':12} {'verdict':17} {'before':>7} "
        f"{'/floor':>7} {'error':>7} {'/sigma':>7} {'cpu s':>6}  found"
    ]
    for r in rows:
        if r["outcome"] in ("not made", "refused", "failed"):
            said = f"{r['outcome']:12} {r['reason']}"
            text.append(f"{r['set']:38} {r['seed']:>4} {r['noise']:14}  {said}")
            continue
        error = "" if r["worst_error"] is None else f"{100 * r['worst_error']:.1f} %"
        sigma = "" if r["worst_error"] is None else f"{r['worst_deviations']:.1f}"
        ratio = r["after_mm"] / r["noise_floor_mm"]
        found = " + ".join(effect["name"] for effect in r["effects"]) or "-"
        found += "".join(
            f", scatter of {one['name']} {one['value']:.2g} {one['unit']}"
            for one in r.get("scatter", ())
        )
        found += " (out of time)" if r.get("out_of_time") else ""
        rivals = "; ".join(" ~ ".join(pair["effects"]) for pair in r["confounded"])
        text.append(
            f"{r['set']:38} {r['seed']:>4} {r['noise']:14}  {r['outcome']:12} {r['verdict']:17} "
            f"{r['before_mm']:7.2f} {ratio:7.3f} {error:>7} {sigma:>7} {r['cpu_seconds']:6.1f}  "
            f"{found}" + (f"  ({rivals})" if rivals else "")
        )
        if r.get("limit") and r["outcome"] == "right":
            (place, size), (least, smallest) = located(r), r["limit"]
            text.append(
                f"    off by {1e3 * place:.1f} mm and {1e2 * size:.1f} %; no unbiased estimate by "
                f"less than {1e3 * least:.1f} mm and {1e2 * smallest:.1f} % (Cramer and Rao)"
            )
    return text


def summary(rows: Sequence[dict]) -> list[str]:
    """How often each outcome came, for each kind of case."""
    from wrod.bench.hidden_profiles import PROFILES
    from wrod.bench.hidden_sets import BUILT, IN_ORDER, KNOWN, UNCOVERED

    def kind(row):
        name = row["set"]
        if name in BUILT:
            return "built from its print"
        if name in PROFILES:
            return "a profile along the rod"
        if name in IN_ORDER:
            return "changes in order"
        if name in UNCOVERED:
            return "no plug-in covers it"
        if name in KNOWN:
            return "one effect"
        if " + slight " in name:
            return "a small one beside"
        return "two effects" if " + " in name else "nothing hidden"

    text = []
    for title in (
        "nothing hidden",
        "one effect",
        "two effects",
        "a small one beside",
        "built from its print",
        "a profile along the rod",
        "changes in order",
        "no plug-in covers it",
    ):
        own = [r for r in rows if kind(r) == title and r["outcome"] != "not made"]
        if not own:
            continue
        counts = {o: sum(r["outcome"] == o for r in own) for o in OUTCOMES}
        said = ", ".join(f"{o} {n}" for o, n in counts.items() if n)
        text.append(f"{title:21} {len(own):3} sets: {said}")
        for noise in sorted({r["noise"] for r in own} - {"white"}):
            part = [r["outcome"] for r in own if r["noise"] == noise]
            said = ", ".join(f"{o} {part.count(o)}" for o in OUTCOMES if o in part)
            text.append(f"{'':21}     {len(part):3} of them with {noise}: {said}")
        intervals = {**BUILT, **PROFILES, **IN_ORDER}
        counted = [held(r) for r in own if "truth" in r and r["set"] in intervals]
        inside, of = np.sum(counted, axis=0) if counted else (0, 0)
        if of:
            share = f"{100 * inside / of:.0f} %"
            text.append(f"{'':21}     80 % intervals hold {inside} of {of} true values, {share}")
        if late := sum(r.get("out_of_time", False) for r in own):
            text.append(f"{'':21}     {late:3} of them ran out of time")
        told = [r["print_near"] for r in own if r.get("print_near") is not None]
        if told:
            text.append(f"{'':21}     likeliest print near the truth in {sum(told)} of {len(told)}")
        named = [r for r in own if r["outcome"] == "right" and r["worst_error"] is not None]
        for name in BUILT:
            if mine := [r for r in named if r["set"] == name]:
                off = [located(r) for r in mine]
                near = sum(_near(*one) for one in off)
                place, size = map(max, zip(*off, strict=True))
                inside, of = np.sum([held(r) for r in mine], axis=0)
                text.append(
                    f"{'':21}     {name}, {len(off)} right, {near} within {1e2 * _LOCATED:.0f} cm "
                    f"and {1e2 * _SIZED:.0f} %: places within {1e3 * place:.1f} mm, sizes within "
                    f"{1e2 * size:.1f} %; 80 % intervals hold {inside} of {of}"
                )
                told = [(o, r["limit"]) for o, r in zip(off, mine, strict=True) if r.get("limit")]
                if may := [_near(*own) for own, limit in told if _near(*limit)]:
                    text.append(
                        f"{'':21}     the bound of Cramer and Rao is as near in {len(may)} of "
                        f"{len(told)}, the estimate in {sum(may)} of these"
                    )
        if named:
            close = sum(r["worst_error"] <= WITHIN for r in named)
            ratios = [r["after_mm"] / r["noise_floor_mm"] for r in named]
            text.append(
                f"{'':21}     where right: parameters within {100 * WITHIN:.0f} % in {close} of "
                f"{len(named)}, after at most {max(ratios):.3f} times the noise floor"
            )
    return text
