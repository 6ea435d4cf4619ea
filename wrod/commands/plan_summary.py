"""What `wrod plan` tells a reader about a plan."""

from math import degrees, pi

from wrod.errors import PatternError


def summary(figures: dict) -> str:
    """Lines for a reader from the figures that --json prints."""
    lines = [
        f"{figures['pattern']}: {figures['pattern_length']:.3f} m"
        + (
            f" and a remainder of {figures['remainder_length']:.3f} m"
            if figures["remainder_length"]
            else ""
        )
        + f", {figures['nodes']} nodes, largest curvature {figures['largest_curvature']:.1f} 1/m",
        f"highest grip {figures['highest_grip']:.3f} m, method {figures['method']}"
        + (f", closure {figures['closure']}" if figures["closure"] else "")
        + (f", grasps of the {figures['solver']}" if figures.get("solver") else ""),
    ]
    if (off := figures.get("departure_from_points", 0.0)) > 5e-5:
        lines.append(f"the curve leaves the lines between its points by {1e3 * off:.1f} mm at most")
    if "distilled" in figures:
        said = figures["distilled"]
        lines.append(
            f"for friction {said['friction']:g} by the distilled corrections, the largest "
            f"{100.0 * said['largest_correction']:.1f} cm"
        )
    if figures.get("expected") is not None:
        lines += _expectation(figures["expected"], figures.get("optimised"))
    if not {"optimised", "distilled"} & set(figures):
        lines.append("for no table in particular; --friction 0.3 or 0.2:0.6 corrects it for one")
    lines += [f"note: {note}" for note in figures["notes"]]
    if "remembers" in figures:
        lines.append(
            f"grasps know how those before them left the rod bent (law {figures['remembers']})"
        )
    if figures["twist"] is not None:
        first, last = (value / (2.0 * pi) for value in figures["twist"])
        lines.append(
            "the rod has sides (it is bent at rest, stays bent, or is not round): lay it with its "
            "first director "
            f"{round(degrees(figures['roll']))} degrees from left towards up, twisted by "
            f"{first:.2f} turns between table and grip at first and by {last:.2f} in the end"
        )
    if spin := figures.get("spin"):
        lines.append(
            f"the hand turns about the rod by {degrees(spin):.0f} degrees besides, which twists it "
            f"by up to {abs(spin) / figures['laid_length']:.1f} 1/m"
        )
    if "shapes" in figures:
        apart = 1e3 * figures["shapes"]["largest_grip_difference"]
        lines[1] += f"; the rod solver's grips differ by {apart:.2g} mm at most"
    if figures["joint_path"] is not None:
        path = figures["joint_path"]
        place = path["placement"]
        lines.append(
            f"joint path of {path['duration']:.0f} s at {path['rate']:g} Hz, at least "
            f"{path['limit_margin']:.2f} rad from the joint limits and "
            f"{1e3 * min(path['gap'].values()):.0f} mm clear; pattern at x {place['x']:.3f}, "
            f"y {place['y']:.3f}, z {place['z']:.3f} m, yaw {degrees(place['yaw']):.0f} degrees "
            "from the robot's base"
        )
        if "phases" in path:
            lines.append(
                ", ".join(f"{p['name']} {p['end'] - p['start']:.0f} s" for p in path["phases"])
            )
        lines += _laid_slowly(path)
        if "stand" in path:
            lines.append(
                "the rod waits at a stand that "
                + ("may stay" if path["stand_stays"] else "goes away once the hand has the rod")
            )
    return "\n".join(lines)


def _laid_slowly(path: dict) -> list[str]:
    """Where the arm lays more slowly than at the pace that is kept elsewhere, if it does."""
    slowed = path["slowed"]
    if not slowed["at"]:
        return []
    places = ", ".join(f"{a:.3f} to {b:.3f}" for a, b in slowed["at"])
    return [
        f"the arm's limits do not let it lay at {path['pace']:g} m/s where {places} m are laid: it "
        f"is up to {slowed['most']:.2g} times as slow there"
    ]


def _expectation(expected: dict, optimised: dict | None) -> list[str]:
    """What simulated deployments say of the plan, in sentences."""
    mus, errors = expected["friction"], expected["error_mean"]
    half = -(-len(mus) // 2)
    own = sum(expected["error_robot"]) / len(mus)
    lines = [
        f"expected of {len(mus)} disturbed rods, laid in simulation: "
        f"{100 * expected['mean']:.2f} ± {100 * expected['deviation']:.2f} cm off the pattern, "
        f"{100 * own:.2f} from where the robot, misplaced, has it; "
        + ", ".join(
            f"{100 * sum(some) / len(some):.2f} at friction {first:.2g} to {last:.2g}"
            for some, first, last in (
                (errors[:half], mus[0], mus[half - 1]),
                (errors[half:], mus[min(half, len(mus) - 1)], mus[-1]),
            )
            if some
        )
    ]
    holds = expected["holds_from"]
    lines.append(
        f"within 5 mm of where the robot has it from friction {holds:.2g} on"
        if holds is not None
        else f"more than 5 mm off that somewhere, up to the largest friction of {mus[-1]:.2g}"
    )
    if optimised is not None:
        lines.append(
            f"grip corrected by up to {1e3 * optimised['largest_correction']:.1f} mm and "
            f"{degrees(optimised['largest_turn']):.1f} degrees, from "
            f"{100 * optimised['errors'][0]:.2f} to {100 * min(optimised['errors']):.2f} cm over "
            "the rods that it was fitted to"
            if optimised["kept"]
            else "grip left as planned: no correction lays these rods better"
        )
        tried = ", ".join(f"{100 * e:.2f} cm at {v:g}" for v, e in optimised.get("paces", ()))
        lines.append(
            f"to be laid at {optimised['pace']:g} m/s of the contact, slower where the grip goes "
            "over 1.4 times as far"
            + (f", the fastest that does no harm of {tried} m/s" if tried else "")
        )
        if optimised.get("ended_early"):
            lines.append("corrected for as long as --minutes says; more may lie better")
        if optimised.get("within_limits"):
            lines.append("corrected within what the arm's joints can do")
        if (share := optimised.get("share")) is not None:
            lines.append(
                f"the arm follows {share:.0%} of what was found, which is what is expected; with "
                "all of it there is no joint path"
            )
    if expected["diverged"]:
        lines.append(f"{expected['diverged']} of them could not be simulated to the end")
    if expected["slides"]:
        places = ", ".join(f"{a:.3f} to {b:.3f}" for a, b in expected["slides"])
        lines.append(f"slides by more than 1 mm while it is laid at s = {places} m")
    rougher = (optimised or {}).get("rougher")
    beyond = rougher or [None] * len(expected["off"])
    for (start, stop, least), needed in zip(expected["off"], beyond, strict=True):
        if least is not None:
            until = f" below friction {least:.2f}"
        elif needed is not None:
            until = f", and can be laid from friction {needed:.2g} on"
        else:
            until = ", up to the largest friction asked for"
            until += " and on rougher tables that were tried" if rougher else ""
        lines.append(
            f"lies off the pattern by more than 5 mm at s = {start:.3f} to {stop:.3f} m{until}"
        )
    return lines


def beyond_the_grip(trajectory, joint_path) -> tuple[dict | None, list[str]]:
    """Figures of what hangs beyond the grip, and a sentence each of the table and of the arm where
    it meets them; nothing where the rod is held at its end."""
    if not trajectory.beyond_grip:  # nor what computes it is loaded
        return None, []
    from wrod.planning.beyond import Beyond, longest_free

    beyond = Beyond.of(trajectory)
    if beyond is None:
        return None, []
    free, from_laid, notes = trajectory.beyond_grip, None, []
    if beyond.touches.any():
        free, from_laid = longest_free(trajectory), float(beyond.laid[beyond.touches.argmax()])
        onto = " and onto what lies there" if beyond.lies_on.any() else ""
        notes.append(
            f"what hangs beyond the grip comes down to the table{onto} when {from_laid:.3f} m are "
            f"laid: cut off all but {free:.3f} m of it, as scenes show it, or hold it up"
        )
    figures = {"off_the_table": free, "on_the_table_from": from_laid, "met": None}
    if joint_path is not None:
        from wrod.robot.beyond import met_beyond

        met = met_beyond(joint_path, beyond)
        if met is not None:
            figures["met"] = {"link": met.link, "free": met.free, "laid": met.laid}
            notes.append(
                f"what hangs beyond the grip may meet the arm's link {met.link} {met.free:.3f} m "
                f"from the grip, for the first time when {met.laid:.3f} m are laid: cut it off "
                "there, or lead it aside"
            )
    return figures, notes


def read_friction(text: str) -> float | tuple[float, float]:
    """0.3, (0.2, 0.6) of "0.2:0.6", or one standard error down and up of a table's file (.json).

    Raises:
        PatternError: it is none of these.
        DataError: the file is no table's.
    """
    from wrod.deployment.table import TableFriction, friction_range

    if text.lower().endswith(".json"):
        return TableFriction.load(text).interval
    friction = read_range(text, "friction", "0.3 or 0.2:0.6")
    friction_range(friction)  # refused before anything is planned
    return friction


def read_range(
    text: str, what: str, example: str, bounds: tuple[float, float] | None = None
) -> float | tuple[float, float]:
    """0.3, or (0.2, 0.6) of "0.2:0.6".

    Raises:
        PatternError: it is neither, or not within the bounds.
    """
    try:
        values = [float(word) for word in text.split(":")]
    except ValueError:
        values = []
    if len(values) not in (1, 2):
        raise PatternError(f"--{what} is {text!r}; give a number or a range, as {example}")
    if bounds is not None and not all(bounds[0] <= value <= bounds[1] for value in values):
        raise PatternError(f"--{what} is {text!r}; give {bounds[0]:g} to {bounds[1]:g}")
    return values[0] if len(values) == 1 else (values[0], values[1])
