"""`python docs/formats.py`: docs/formats.md, from the schemas themselves."""

import inspect
import math
import sys
from pathlib import Path
from typing import Any

import msgspec

from wrod.files import row_schemas, schemas
from wrod.files.array_schemas import ARRAYS, ArrayFile

HEAD = """# Files that wrod reads

Printed by `python docs/formats.py docs/formats.md` from `wrod/files/schemas.py`, which every
reader checks against; a test compares the two. JSON is UTF-8, at most 4 MiB and nested at most 32
deep; numbers are finite, whole ones at most 2^53; entries that a table does not name are refused
unless it says so. A refusal names the file, and the line or the entry.

Arrays (`.npz`, `.npy`, `.safetensors`) hold numbers or text, at most 512 MiB unpacked (weights and
shards 2 GiB); their headers are checked before anything is unpacked, nothing in a file is executed,
and every array is checked against its table in `wrod/files/array_schemas.py`: type, shape, range,
order, and finite but where NaN stands for what is not known. Points of a pattern are at most
20 000, within 100 m of the origin; pictures have at most 36 million pixels; a URDF at most 500
links, 50 000 elements and 16 MiB. Lines of a campaign's file (`.jsonl`) end in a digest of what is
on them, and one that was changed is refused. Pipes, devices and folders are no files.
"""
_ROOTS = (
    schemas.RodFile, schemas.RodModelFile, schemas.Fixtures, schemas.TableFriction,
    schemas.Obstacle, schemas.MarkerLayout, schemas.CameraIntrinsics, schemas.KnotPlan,
    schemas.Manifest, schemas.Shard, schemas.Controller, schemas.Corrector, schemas.Plans,
    schemas.TrajectoryMetadata,
    row_schemas.Table3Row, row_schemas.ApplicationsRow, row_schemas.HiddenRow,
    row_schemas.SlipperyRow, row_schemas.FeedbackRow, row_schemas.FoldRow, row_schemas.LaidRow,
    row_schemas.ArmsRow, row_schemas.ArmsRefused, row_schemas.StepRow,
)  # fmt: skip


def document() -> str:
    """The page."""
    parts, seen, queue = [HEAD], set(), list(_ROOTS)
    _, components = msgspec.json.schema_components(_ROOTS, ref_template="{name}")
    while queue:
        struct = queue.pop(0)
        if struct.__name__ in seen:
            continue
        seen.add(struct.__name__)
        content = components[struct.__name__]
        parts.append(f"## {struct.__name__}\n\n{inspect.getdoc(struct)}\n")
        if content.get("additionalProperties", True):
            parts.append("It may hold more entries than these.\n")
        rows = ["| entry | what it holds | default |", "| --- | --- | --- |"]
        for name, entry in content["properties"].items():
            if name in content.get("required", ()):
                default = "required"
            else:
                default = f"`{msgspec.json.encode(entry.get('default')).decode()}`"
            rows.append(f"| `{name}` | {_said(entry)} | {default} |")
            queue += [getattr(schemas, ref) for ref in _references(entry)]
        parts.append("\n".join(rows) + "\n")
    return "\n".join(parts + [_arrays(name, kind) for name, kind in ARRAYS.items()])


def _arrays(name: str, kind: ArrayFile) -> str:
    """The table of a file of arrays."""
    rows = ["| array | shape | what it holds |", "| --- | --- | --- |"]
    for key, field in kind.fields.items():
        shape = f"({', '.join(map(str, field.shape))})" if field.shape else "one"
        unit = f" [{field.unit}]" if field.unit else ""
        said = [f"{field.kind}{unit}" + (f": {field.about}" if field.about else "")]
        low, high = field.low if field.above is None else field.above, field.high
        said += [f"above {low:g}" if field.above is not None else f"at least {low:g}"] * (
            low > -math.inf
        )
        said += [f"at most {high:g}"] * (high < math.inf)
        said += [field.order] * bool(field.order)
        said += ["NaN where not known"] * field.gaps + ["may be left out"] * (not field.needed)
        rows.append(f"| `{key}` | {shape} | {'; '.join(said)} |")
    notes = [f"`format` is `{kind.format}`."] * bool(kind.format)
    least = ", ".join(f"{letter} >= {count}" for letter, count in kind.least.items())
    notes += ["; ".join(f"{letter}: {axis}" for letter, axis in kind.axes.items()) + "."] * bool(
        kind.axes
    )
    notes += [f"{least}."] * bool(least)
    notes += [
        f"{' and '.join(f'`{one}`' for one in group)} come together." for group in kind.together
    ]
    said = " ".join([kind.about, *notes])
    return f"## {name} ({kind.suffix})\n\n{said}\n\n" + "\n".join(rows) + "\n"


def _said(entry: dict[str, Any]) -> str:
    """An entry of a JSON schema in words."""
    if "$ref" in entry:
        return f"[{entry['$ref']}](#{entry['$ref'].lower()})"
    if "anyOf" in entry:
        return " or ".join(_said(one) for one in entry["anyOf"])
    if "const" in entry or "enum" in entry:
        values = entry.get("enum", [entry.get("const")])
        return ", ".join(f"`{value}`" for value in values)
    kind = entry.get("type")
    if kind == "array":
        if "prefixItems" in entry:
            items = [_said(one) for one in entry["prefixItems"]]
            same = len(set(items)) == 1
            return f"{len(items)} x {items[0]}" if same else f"list of {', '.join(items)}"
        return f"list of {_said(entry.get('items', {}))}{_limits(entry, 'Items')}"
    if kind == "object":
        return f"object of {_said(entry.get('additionalProperties') or {})}"
    words = {"number": "number", "integer": "whole number", "string": "text", "boolean": "truth"}
    bounds = _limits(entry, "Length") if kind == "string" else _range(entry)
    unit = f" {entry['description']}" if "description" in entry else ""
    return f"{words.get(str(kind), str(kind))}{unit}{bounds}"


def _range(entry: dict) -> str:
    low = entry.get("minimum", entry.get("exclusiveMinimum"))
    high = entry.get("maximum", entry.get("exclusiveMaximum"))
    if low is None or high is None:
        return ""
    return f", {'above ' if 'exclusiveMinimum' in entry else ''}{low:g} to {high:g}"


def _limits(entry: dict, what: str) -> str:
    high = entry.get(f"max{what}")
    return "" if high is None else f", at most {high}"


def _references(entry: Any) -> list[str]:
    if isinstance(entry, dict):
        own = [entry["$ref"]] if "$ref" in entry else []
        return own + [ref for value in entry.values() for ref in _references(value)]
    if isinstance(entry, list):
        return [ref for value in entry for ref in _references(value)]
    return []


if __name__ == "__main__":
    if len(sys.argv) > 1:
        Path(sys.argv[1]).write_text(document(), encoding="utf-8")
    else:
        print(document(), end="")
