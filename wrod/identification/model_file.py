"""`model.json`: a fitted rod with every effect, which `RodMaterial.load` reads as a rod."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from wrod.files import write_atomically
from wrod.identification.effect import Model
from wrod.rods.material import RodMaterial

_FORMAT = "wrod-rod-model-1"


def with_effects(material: RodMaterial, model: Model, values: np.ndarray, m) -> RodMaterial:
    """The rod with the effects that its own numbers can express.

    Args:
        material: the rod that the model's parameters are relative to.
        m: the measurements that the values were fitted to.
    """
    for effect, part in zip(model.effects, model.split(values), strict=True):
        found = effect.describe(part, np.eye(len(part)), m)
        if effect.name == "stiffness":
            ratio = found["stiffness_ratio"].value ** (1 / 3)
            lgb = material.gravito_bending_length * ratio
            material = replace(material, gravito_bending_length=lgb)
        elif effect.name == "density":
            # The stiffness stays: k_b = 2 pi h^2 rho g L_gb^3.
            ratio = found["density_ratio"].value
            material = replace(
                material,
                density=material.density * ratio,
                gravito_bending_length=material.gravito_bending_length / ratio ** (1 / 3),
            )
        elif effect.name == "natural_curvature":
            # The curvature vector turns the tangent: t' = k x t.
            material = replace(material, natural_curvature=(float(part[1]), -float(part[0])))
    return material


def write_model(
    path: Path,
    material: RodMaterial,
    model: Model,
    values: np.ndarray,
    assumed: tuple[str, ...] = (),
) -> Path:
    """Write a rod and every effect's raw parameters.

    Args:
        material: the rod, with what its own numbers can carry of the effects.
        assumed: those of its numbers that were not measured.
    """
    content = {
        "format": _FORMAT,
        "rod": asdict(material),
        "assumed": list(assumed),
        "effects": [
            {
                "name": e.name,
                "parameters": dict(zip((p.key for p in e.parameters), v.tolist(), strict=True)),
            }
            for e, v in zip(model.effects, model.split(values), strict=True)
        ],
    }
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    return write_atomically(path, lambda file: file.write(text))
