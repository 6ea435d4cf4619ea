"""Rods as JSON: `RodModel` (`model.json`) and `RodMaterial`."""

import json
import math
import os
import warnings
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import msgspec

from wrod import arguments
from wrod.errors import RodError, WrodWarning
from wrod.files import decode_labels, read_json, schemas, write_json, write_text
from wrod.files.reading import entry_message
from wrod.rods.law import law_as_json, law_of
from wrod.rods.material import RodMaterial
from wrod.rods.model import Rod, RodModel
from wrod.rods.profile import Profile

MODEL_FORMAT = "wrod-rod-model-3"
MATERIAL_FORMAT = "wrod-rod-1"
# A knot so many lengths of the rod away is a mistake; pieces of rods keep some that are beyond.
_FAR_KNOTS = 100.0
# [Pa] Twice as stiff as steel.
_STIFF = 4e11
_WHAT = "a rod file, as `wrod loop --out` or `wrod identify` writes it"


@arguments.checked(RodError, assumed=arguments.several(arguments.text, 0))
def save_rod(rod: Rod, path: str | os.PathLike[str], *, assumed=(), found=None) -> Path:
    """Write a rod as JSON, SI units.

    Args:
        assumed: names of a `RodModel`'s numbers that nobody measured.
        found: a record of how the model was found, which readers keep out of the rod.

    Raises:
        RodError: it is no rod, or `found` is nothing that JSON holds.
    """
    if isinstance(rod, RodMaterial):
        return write_json(path, {"format": MATERIAL_FORMAT, **asdict(rod)}, allow_nan=False)
    content = {"format": MODEL_FORMAT, **model_as_json(RodModel.of(rod))}
    content["assumed"] = list(assumed)
    if found is not None:
        content["found"] = found
    try:
        text = json.dumps(content, indent=2, allow_nan=False)
    except Exception as error:  # whatever an object does that is asked to be JSON
        raise RodError(f"save_rod: found is nothing that JSON holds ({error})") from None
    return write_text(path, f"{text}\n")


def model_as_json(model: RodModel) -> dict:
    """A rod model as lists, numbers and strings; `model_of` reads it."""

    def plain(value):
        if isinstance(value, Profile):
            return value.as_json()
        return [plain(v) for v in value] if isinstance(value, tuple) else value

    content = {f.name: plain(getattr(model, f.name)) for f in fields(model)}
    return {**content, "law": law_as_json(model.law)}


def model_of(content: dict) -> RodModel:
    """The rod model that `model_as_json` wrote.

    Raises:
        RodError: a field is missing, unknown, or holds what a rod cannot have.
    """
    known = {f.name for f in fields(RodModel)}
    unknown = sorted(set(content) - known)
    if unknown:
        raise RodError(f"holds {', '.join(map(str, unknown))!s:.80}, which no rod has")
    if "law" in content:
        content = {**content, "law": law_of(content["law"])}
    try:
        return RodModel(**content)
    except TypeError as error:
        raise RodError(str(error).replace("RodModel.__init__() ", "")) from None


def rod_as_json(rod: Rod) -> dict:
    """A rod as plain JSON values: a uniform one by the numbers of `RodMaterial`."""
    if isinstance(rod, RodMaterial):
        return {**asdict(rod), "natural_curvature": list(rod.natural_curvature)}
    return {**model_as_json(rod), "gravito_bending_length": rod.gravito_bending_length}


def rod_of_json(content) -> Rod:
    """The rod that `rod_as_json` wrote.

    Raises:
        RodError: it is not one.
    """
    if not isinstance(content, dict):
        raise RodError(f"{content!r:.80} is no rod")
    if "bending_stiffness" in content:
        return model_of({k: v for k, v in content.items() if k != "gravito_bending_length"})
    try:
        return RodMaterial(**content)
    except TypeError as error:
        raise RodError(str(error).replace("RodMaterial.__init__() ", "")) from None


@arguments.checked(RodError)
def load_rod(
    path: str | os.PathLike[str], *, radius: float | None = None, length: float | None = None
) -> Rod:
    """Read a rod that `save_rod`, `wrod loop` or `wrod identify` wrote.

    Args:
        radius, length: instead of the file's, which measurements may not tell [m].

    Returns:
        A `RodMaterial` where the file holds no more than that, else the `RodModel`.

    Raises:
        RodError: the file is missing, not a rod file, or holds unphysical values.

    Warns:
        WrodWarning: the file holds numbers that were not measured, or names what it cannot carry.
    """
    content = _read(path)
    instead = {"radius": radius, "length": length}
    instead = {key: value for key, value in instead.items() if value is not None}
    try:
        if content.get("format") != MODEL_FORMAT:
            return _material(content, instead)
        model = _new(path, content, instead)
        return model if model.not_uniform() else model.material()
    except RodError as error:
        said = str(error)
        raise RodError(said if said.startswith(str(path)) else f"{path}: {said}") from None


def _new(path, content: dict, instead: dict) -> RodModel:
    found = content.get("found")
    content = {k: v for k, v in content.items() if k not in ("format", "found")}
    assumed = content.pop("assumed", [])
    model = model_of(content)
    aside = found.get("set_aside") if isinstance(found, dict) else None
    aside = [name for name in aside if isinstance(name, str)] if isinstance(aside, list) else []
    said = [f"{', '.join(aside)!s:.200} set aside, as it belongs to the measurement"] * bool(aside)
    said += _assumed(content, assumed, instead)
    last = max((p.knots[-1] for p in model.varying), default=0.0)
    if last > _FAR_KNOTS * model.length:
        said.append(
            f"its profiles go on to {last:.4g} m on a rod of {model.length:g} m (knots in "
            "millimetres?)"
        )
    said += _doubts(model)
    if "length" in instead:
        longest = model.length
        model = with_length(model, instead.pop("length"))
        if model.length > longest * (1.0 + 1e-9) and model.varies:
            said.append(f"beyond the measured {longest:g} m it goes on as it is there")
    model = replace(model, **instead)
    model.refuse_lump()
    if said:
        warnings.warn(f"{path}: {'; '.join(said)}", WrodWarning, stacklevel=4)
    return model


def _doubts(model: RodModel) -> list[str]:
    """What no rod has, and one has whose file was written in other units."""
    solid = 4.0 * model.mean_bending_stiffness / (math.pi * model.radius**4)
    bend_twist = 1.0 + model.poisson
    damping = model.internal_damping or 0.0
    doubts = {
        f"bends as a solid of {solid:.2g} Pa (bending_stiffness in N mm^2?)": solid > _STIFF
        and model.is_isotropic,
        f"stretches more easily than it bends (k_s L_gb^2 / k_b is {model.stretch_ratio:.2g}; "
        "stretching_stiffness in other units?)": model.stretch_ratio < 1.0,
        f"bends {bend_twist:.2g} times as hard as it twists (twisting_stiffness in other units?)": (
            not 1e-3 < bend_twist < 1e5
        ),
        f"has {damping:g} s of internal damping (milliseconds?)": damping > 10.0,
    }
    return [one for one, doubtful in doubts.items() if doubtful]


def with_length(model: RodModel, length: float) -> RodModel:
    """The rod cut, or gone on with as it ends, to another length [m].

    Raises:
        RodError: the length is not positive and finite.
    """
    masses = tuple((s, m) for s, m in model.point_masses if s <= length)
    return replace(model, length=length, point_masses=masses)


def _material(content: dict, instead: dict) -> RodMaterial:
    if content.pop("format", None) != MATERIAL_FORMAT:
        raise RodError(
            f"is not a {MATERIAL_FORMAT} file, nor a {MODEL_FORMAT} one; write one with "
            "`wrod loop --out` or `wrod identify`"
        )
    content = {**content, **instead}
    try:
        msgspec.convert({"format": MATERIAL_FORMAT, **content}, schemas.RodFile)
        return RodMaterial(**content)
    except msgspec.ValidationError as error:
        raise RodError(entry_message(str(error))) from None
    except (TypeError, UnicodeError) as error:
        raise RodError(str(error).replace("RodMaterial.__init__() ", "")) from None


def _assumed(rod: dict, assumed, instead: dict) -> list[str]:
    assumed = assumed if isinstance(assumed, list) else []
    assumed = [key for key in rod if key in assumed and key not in instead]
    values = ", ".join(f"{key} {rod.get(key)!r:.40}" for key in assumed)
    return [f"{values} assumed, as nothing that was measured tells them"] if assumed else []


def _read(path) -> dict:
    content = read_json(path, dict[str, Any], _WHAT, error=RodError)
    if content.get("format") == MODEL_FORMAT:
        # Every entry of the right kind, named if not; what they mean is for `RodModel`.
        text = json.dumps(content)
        return decode_labels(text, schemas.RodModelFile, str(path), _WHAT, error=RodError)
    return content
