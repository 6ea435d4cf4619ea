"""Numbers and profiles of a rod, checked."""

import math

from wrod.arguments import number, shown, wrong
from wrod.errors import RodError
from wrod.rods.profile import Profile

# What stands in for a profile of what is one number for the whole rod.
_INSTEAD = {
    "radius": "the largest one, which touches",
    "principal_angle": "that at the beginning, and how it turns from there as natural_twist",
}


def as_number(name: str, value, *, positive: bool = False, least: float = -math.inf) -> float:
    if issubclass(type(value), (Profile, dict)):
        raise RodError(
            f"rod {name} is a profile and can only be one number for the whole rod; give "
            f"{_INSTEAD.get(name, 'its mean')}"
        )
    if wrong(number(least, above=0.0 if positive else None), value) is not None:
        wanted = (
            "a positive" if positive else "a" if least == -math.inf else f"at least {least:g}, a"
        )
        raise RodError(f"rod {name} is {shown(value)}; give {wanted} finite number in SI units")
    return float(value)


def as_profile(name: str, value) -> Profile:
    try:
        return Profile.of(value)
    except RodError as error:
        raise RodError(f"rod {name}: {error}") from None


def as_pair(name: str, value, *, same: bool = False) -> tuple[Profile, Profile]:
    if same and not issubclass(type(value), (tuple, list)):
        value = (value, value)
    if not issubclass(type(value), (tuple, list)) or len(value) != 2:
        raise RodError(f"rod {name} is {shown(value)}; give two profiles, one per direction")
    return as_profile(name, value[0]), as_profile(name, value[1])
