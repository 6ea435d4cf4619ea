"""One set of measurements identified, as a row of the tables of `wrod bench identify`."""

import time

from wrod.identification import identify


def row(data, device: str, seconds: float | None = None) -> dict:
    """One set, a file or measurements: what `wrod identify` says of it, and what that cost.

    Args:
        seconds: after which its search ends, as in `identify_clamped`.
    """
    clock, cpu = time.perf_counter(), time.process_time()
    report = identify(data, device=device, seconds=seconds)
    content = report.to_dict()
    left_out, left_over = ("reference", "title"), content["left_over"]
    return {
        "set": report.measurements.name,
        "verdict": report.verdict,
        "reason": report.reason,
        "out_of_time": report.out_of_time,
        "before_mm": content["before_mm"],
        "after_mm": content["after_mm"],
        "noise_floor_mm": content["noise_floor_mm"],
        "likeliest_print": report.prints[0].name,
        "effects": [
            {key: value for key, value in effect.items() if key not in left_out}
            for effect in content["effects"]
        ],
        "scatter": content["scatter"],
        "changing": content["changing"],
        "left_over": left_over and [left_over["name"], left_over["log_evidence"]],
        "confounded": content["confounded"],
        "selection": content["selection"],
        "seconds": time.perf_counter() - clock,
        "cpu_seconds": time.process_time() - cpu,
    }
