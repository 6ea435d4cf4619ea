"""Checks of the arguments of public functions: a wrong one is named, in a typed exception."""

import contextlib
import functools
import inspect
import math
import numbers
import os
import re
import sys
from collections.abc import Callable, Collection, Set
from typing import Any, TypeVar

import numpy as np

from wrod.errors import WrodError
from wrod.places import DeviceLike, device_name, place

_LARGEST = sys.float_info.max
# [rad], as people write it; what is more was likely meant in degrees.
ONCE_ROUND = 2.0 * math.pi + 1e-3
# Numbers in an array: more would take gigabytes, if only to look whether all are finite.
MOST_NUMBERS = 2**27
F = TypeVar("F", bound=Callable)
# Says what is wrong with a value ("must be ..."), or None if nothing is.
Check = Callable[[Any], str | None]
# Of kinds that count as whole numbers, and are none.
_NO_NUMBERS = (bool, np.bool_, np.timedelta64)


def checked(error: type[WrodError], **checks: Check) -> Callable[[F], F]:
    """Decorator: arguments are checked before the function runs.

    Arguments that are left out, or given as their default, pass.

    Args:
        error: what a wrong argument raises; its sentence names function and argument.
        checks: of the arguments by name; the others are what their annotation says.
    """

    def decorate(function: F) -> F:
        signature = inspect.signature(function)
        # Where decorators are stacked, the lowest looks at annotations.
        alone = {} if hasattr(function, "__wrapped__") else signature.parameters
        told = [(name, _told(parameter.annotation)) for name, parameter in alone.items()]
        places = [name for name, check in told if check is place]
        wanted = {name: check for name, check in told if check is not None} | checks
        unknown = set(checks) - set(signature.parameters)
        if unknown:
            raise TypeError(f"{function.__qualname__} has no argument {min(unknown)!r}")

        @functools.wraps(function)
        def guarded(*args, **kwargs):
            try:
                given = signature.bind(*args, **kwargs).arguments
            except TypeError as reason:
                raise TypeError(f"{_name(function, args)}: {reason}") from None
            for name, check in wanted.items():
                if name not in given or given[name] is signature.parameters[name].default:
                    continue
                said = wrong(check, given[name])
                if said is not None:
                    raise error(f"{_name(function, args)}: {name} {said}")
            kwargs |= {name: device_name(kwargs[name]) for name in places if name in kwargs}
            try:
                return function(*args, **kwargs)
            except RecursionError:
                raise error(
                    f"{function.__qualname__}: what it is given is nested too deeply"
                ) from None

        return guarded  # type: ignore[return-value]

    return decorate


def check_fields(one: Any, error: type[WrodError], **checks: Check) -> None:
    """Refuse an object with a wrong attribute, as `checked` does arguments.

    Raises:
        error: names class and attribute.
    """
    for name, check in checks.items():
        said = wrong(check, getattr(one, name))
        if said is not None:
            raise error(f"{type(one).__name__}: {name} {said}")


def wrong(check: Check, value: Any) -> str | None:
    """What is wrong with a value ("is -1; it must be ..."), or None if nothing is."""
    try:
        said = check(value)
    except Exception as reason:  # of an object that says it is what it is not
        said = f"cannot be looked at ({type(reason).__name__})"
    return None if said is None else f"is {shown(value)}; it {said}"


def _name(function: Callable, args: tuple) -> str:
    """Of a method that was inherited, the class that was asked."""
    owner, _, name = function.__qualname__.rpartition(".")
    asked = args[0] if args and isinstance(args[0], type) else type(args[0]) if args else object
    if owner in [kind.__name__ for kind in asked.__mro__]:
        owner = asked.__name__
    return owner if name == "__init__" else f"{owner}.{name}" if owner else name


def each(check: Check, *instead: str) -> Check:
    """One, or a list of, what passes the check or has the attributes `instead`."""

    def wrong(value):
        for one in value if isinstance(value, (list, tuple)) else [value]:
            said = check(one)
            if said is not None and not (instead and like("", *instead)(one) is None):
                return said
        return None

    return wrong


def number(low: float = -math.inf, high: float = math.inf, above: float | None = None) -> Check:
    """A finite real number from `low` to `high`, and more than `above`."""
    least = low if above is None else above
    bounds = "" if (low, high, above) == (-math.inf, math.inf, None) else _range(low, high, above)

    def check(value: Any) -> str | None:
        # Other reals, such as fractions, are none to NumPy.
        real = isinstance(value, (int, float, np.floating, np.integer)) or (
            isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "fiu"
        )
        with contextlib.suppress(Exception):  # of a subclass that is not compared
            # A whole number may be too large for any float.
            fits = real and not isinstance(value, _NO_NUMBERS) and abs(value) <= _LARGEST
            fits = fits and not math.isnan(float(value))  # of a subclass that says otherwise
            if fits and least <= value <= high and (above is None or value > above):
                return None
        return f"must be a finite number{bounds}"

    return check


def whole(low: int = 0, high: int = 2**53) -> Check:
    """A whole number from `low` to `high`."""

    def check(value: Any) -> str | None:
        fits = isinstance(value, (int, np.integer)) and not isinstance(value, _NO_NUMBERS)
        return (
            None if fits and low <= value <= high else f"must be a whole number{_range(low, high)}"
        )

    return check


def array(*shapes: tuple[int | None, ...], finite: bool = True, anywhere: bool = False) -> Check:
    """Numbers of one of these shapes; None stands for any length. `anywhere`: those of torch and
    Warp may lie on a GPU, where they are not looked at."""
    said = " or ".join(str(shape).replace("None", "n") for shape in shapes) or "(n,)"

    def check(value: Any) -> str | None:
        if getattr(value, "requires_grad", False) is True:
            return "would lose its gradient: use wrod.training.autograd, or detach it"
        place = str(getattr(value, "device", ""))
        there = anywhere and type(value).__module__.partition(".")[0] in ("torch", "warp")
        there = there and "cuda" in place  # looking at it would bring it here
        try:
            found = np.empty(tuple(value.shape)) if there else np.asarray(value)
        except Exception:  # whatever an object does that is asked to be an array
            where = f", on the host and not on {place}" if "cuda" in place else ""
            return f"must be an array of shape {said}{where}"
        if found.dtype.kind not in "fiu" or _has_masked(value):
            return f"must be an array of numbers, none masked, of shape {said}"
        if found.size > MOST_NUMBERS:
            return f"has {found.size:.3g} numbers and may have {MOST_NUMBERS:.3g}"
        fits = [
            len(shape) == found.ndim
            and all(a in (None, b) for a, b in zip(shape, found.shape, strict=True))
            for shape in shapes
        ]
        if shapes and not any(fits):
            return f"must be an array of shape {said}, not {found.shape}"
        if there:
            return None
        if finite and not np.isfinite(found).all():
            return "must hold finite numbers only"
        return None

    return check


def _has_masked(value: Any) -> bool:
    """Whether entries are masked: what stands there would count as if they were not."""
    return isinstance(value, np.ma.MaskedArray) and bool(np.ma.is_masked(value))


def text(value: Any) -> str | None:
    """A string."""
    return None if isinstance(value, str) else "must be a string"


def path(value: Any) -> str | None:
    """The name of a file."""
    try:
        good = isinstance(value, (str, os.PathLike)) and "\0" not in os.fsdecode(value)
        good = good and isinstance(f"{value}", str)  # messages say it
    except Exception:  # as in `array`
        good = False
    return None if good else "must be the path of a file"


def flag(value: Any) -> str | None:
    """True or False."""
    return None if isinstance(value, (bool, np.bool_)) else "must be True or False"


def like(what: str, *names: str) -> Check:
    """An object that has these attributes; `what` says of which type it should be."""

    def check(value: Any) -> str | None:
        # A class of that name has them too, and is not meant; nor is what has every name.
        good = not isinstance(value, type) and all(hasattr(value, name) for name in names)
        good = good and not hasattr(value, "name_that_nothing_has")
        return None if good else f"must be {what}"

    return check


def optional(check: Check) -> Check:
    """None, or what `check` lets pass."""
    return lambda value: None if value is None else check(value)


def either(*checks: Check) -> Check:
    """What one of the checks lets pass."""

    def check(value: Any) -> str | None:
        wrong = [one(value) for one in checks]
        if None in wrong:
            return None
        first, *others = map(str, wrong)
        return " or ".join([first, *(other.removeprefix("must be ") for other in others)])

    return check


def several(one: Check, least: int = 1) -> Check:
    """A list or tuple of what `one` lets pass."""

    def check(value: Any) -> str | None:
        if not isinstance(value, (list, tuple)) or len(value) < least:
            return f"must be a list of {least} or more"
        for k, item in enumerate(value):
            wrong = one(item)
            if wrong is not None:
                return f"holds at place {k} {shown(item)}, which {wrong}"
        return None

    return check


def some_of(names: Collection[str]) -> Check:
    """A list, tuple or set of none, some or all of these names."""

    def check(value: Any) -> str | None:
        good = isinstance(value, (list, tuple, Set)) and all(
            isinstance(name, str) and name in names for name in value
        )
        return None if good else f"must be a list of names out of {', '.join(names)}"

    return check


def mesh(*shapes: tuple[int | None, ...], finite: bool = True) -> Check:
    """As `array`, or an array of Warp, which is taken as it is."""
    plain = array(*shapes, finite=finite)

    def check(value: Any) -> str | None:
        if isinstance(value, type) or not all(hasattr(value, n) for n in ("ptr", "dtype")):
            return plain(value)
        scalar = getattr(value.dtype, "_wp_scalar_type_", value.dtype)
        good = getattr(scalar, "__name__", "") == "float64"
        return None if good else "must be of float64, as all arrays of Warp that are handed over"

    return check


def floats(value: Any, where: str, error: type[WrodError]) -> np.ndarray:
    """The value as a float64 array, for functions that are called too often to be decorated.

    Args:
        value: whatever was given.
        where: begins the sentence: "Pattern.sample: s".
        error: type of the refusal.
    """
    try:
        found = np.asarray(value)
        # And no times, which would be counted in nanoseconds.
        if found.size <= MOST_NUMBERS and found.dtype.kind in "biufO" and not _has_masked(value):
            return found.astype(np.float64, copy=False)
    except Exception:  # whatever an object does that is asked to be an array
        pass
    raise error(f"{where} is {shown(value)}; it must be an array of numbers")


def truths(value: Any) -> str | None:
    """True or False, or an array of them."""
    try:
        good = np.asarray(value).dtype.kind == "b"
    except Exception:  # as in `array`
        good = False
    return None if good else "must be True or False, or an array of them"


def picture(value: Any) -> str | None:
    """An array of truths or numbers of any shape."""
    return None if truths(value) is None else _any_array(value)


_any_array = array(finite=False)


def spread(value: Any, shape: tuple[int, ...], where: str, error: type[WrodError]) -> np.ndarray:
    """The value as float64, broadcast to a shape.

    Args:
        value: whatever was given.
        shape: wanted.
        where: begins the sentence: "Contact: radius".
        error: type of the refusal.
    """
    found = floats(value, where, error)
    try:
        return np.broadcast_to(found, shape)
    except ValueError:
        raise error(f"{where} has shape {found.shape}, which does not spread to {shape}") from None


# An array of numbers of any shape.
numbers_of_any_shape = array()


def indices(value: Any) -> str | None:
    """Whole numbers in a list, a tuple, a range or an array."""
    try:
        found = np.asarray(value)
        good = found.ndim == 1 and (found.dtype.kind in "iu" or found.size == 0)
        good = good and not hasattr(value, "ptr")  # an array of Warp has no items
    except Exception:  # as in `array`
        good = False
    return None if good else "must be a list of whole numbers"


callback = like("a function", "__call__")


_ROD = like("a wrod.RodMaterial or wrod.RodModel", "radius", "length", "gravito_bending_length")
_BY_TYPE: dict[str, Check] = {
    "bool": flag,
    "str": text,
    "str | PathLike[str]": path,
    "DeviceLike": place,
    "ModelBuilder": like("a newton.ModelBuilder", "has_custom_attribute"),
    "Pattern": like("a wrod.Pattern", "sample", "length", "remainder_length"),
    "Model": like("a newton.Model", "body_q", "device", "shape_count"),
    "State": like("a newton.State", "body_q", "body_qd"),
    "RodBatch": like("a wrod.RodBatch", "rod_count", "node_count", "state"),
    "Rod": _ROD,
    "RodModel | RodMaterial": _ROD,
    "Trajectory": like("a wrod.Trajectory", "arc_length", "position", "rotation"),
}


def _told(annotation: Any) -> Check | None:
    """What an annotation says, if it is one of `_BY_TYPE` or a function, or None besides."""
    said = annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)
    said = re.sub(r"(\w+\.)+", "", said.replace(f"{DeviceLike}", "DeviceLike"))
    plain = said.removesuffix(" | None")
    check = callback if plain.startswith("Callable[") else _BY_TYPE.get(plain)
    return check if check is None or plain == said else optional(check)


def _range(low: float, high: float, above: float | None = None) -> str:
    if above is not None:
        return f" above {above:g}" + ("" if high == math.inf else f", at most {high:g}")
    if high == math.inf:
        return f" of at least {low:g}"
    return f" from {low:g} to {high:g}"


def shown(value: Any) -> str:
    """A value for a sentence, whatever it is."""
    said = f"of type {type(value).__name__}"
    with contextlib.suppress(Exception):  # it may be nested deeply, hold or do anything
        if isinstance(value, np.ndarray) and value.size > 8:
            return f"an array of shape {value.shape}"
        if isinstance(value, str | numbers.Number | np.ndarray | list | tuple | dict | None):
            said = repr(value)
    return said if len(said) <= 60 else f"{said[:59]}…"
