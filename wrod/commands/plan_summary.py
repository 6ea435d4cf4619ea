"""What `wrod plan` tells a reader about a plan."""

from __future__ import annotations

from math import degrees, pi


def summary(figures: dict, friction: float | None) -> str:
    """Lines for a reader from the figures that --json prints."""
    lines = [
        f"{figures['pattern']}: {figures['pattern_length']:.3f} m"
        + (
            f" and a remainder of {figures['remainder_length']:.3f} m"
            if figures["remainder_length"]
            else ""
        )
        + f", {figures['nodes']} nodes, largest curvature {figures['largest_curvature']:.1f} 1/m",
        f"highest grip {figures['highest_grip']:.3f} m, method {figures['method']}",
        f"required static friction {figures['required_friction']:.2f}",
    ]
    lines += [f"note: {note}" for note in figures["notes"]]
    if figures["twist"] is not None:
        first, last = (value / (2.0 * pi) for value in figures["twist"])
        lines.append(
            f"naturally curved rod: lay it with its first material director "
            f"{degrees(figures['roll']):.0f} degrees from left towards up, twisted by {first:.2f} "
            f"turns between table and grip at first and by {last:.2f} in the end"
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
    if friction is not None:
        places = figures["insufficient_friction"]
        lines[2] += (
            f"; {friction:g} holds everywhere"
            if not places
            else f"; {friction:g} is not enough at s = "
            + ", ".join(f"{a:.3f} to {b:.3f}" for a, b in places)
            + " m"
        )
    return "\n".join(lines)
