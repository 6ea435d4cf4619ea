"""Files of an adversary, into every option that takes a file: bombs, loops, lies, code.

Each call of `wrod` is a process of its own, of 12 s and 3 GiB: what hangs, crashes or swells fails.
The tests try a share of the kinds; WROD_FUZZ=50 (`make fuzz`) tries all of them.
"""

import os
import random
import shutil
import time
from pathlib import Path

import pytest
from bombs import bombs, specials
from forked import call

FUZZ = int(os.environ.get("WROD_FUZZ", "1"))
# Of a family's kinds, in the tests; `make fuzz` tries all, for so long [s] and in another order
# each time.
SHARE, LONGEST = 2, 120.0
ROD = ["--rod", "green-vps"]
PLAN = ["plan", "line", *ROD, "--method", "intuitive", "--no-expect", "--out", "out"]
# Out of reach, so that the search for a path ends at once: arms and meshes are read before it.
FAR = ["--no-remedy", "--lay-only", "--placement", "9,9,0,0"]
# Where a file goes in: its family, its ending, the words, and which extra they need.
DOORS = {
    "text": ("texts", ".txt", ["show", "{}", *ROD], None),
    "csv": ("texts", ".csv", ["show", "{}", *ROD, "--units", "mm"], None),
    "npz": ("arrays", ".npz", ["show", "{}", *ROD], None),
    "npy": ("arrays", ".npy", ["show", "{}", *ROD], None),
    "svg": ("svg", ".svg", ["show", "{}", *ROD, "--stroke", "1"], "svgelements"),
    "dxf": ("dxf", ".dxf", ["show", "{}", *ROD, "--stroke", "1"], "ezdxf"),
    "picture": ("pictures", ".png", ["show", "{}", *ROD, "--scale", "0.0005"], "cv2"),
    "scan": ("pictures", ".jpg", ["scan", "{}", "--out", "out"], "cv2"),
    "markers": ("json", ".json", ["scan", "{good}", "--markers", "{}", "--out", "out"], "cv2"),
    "camera": ("json", ".json", ["scan", "{good}", "--camera", "{}", "--out", "out"], "cv2"),
    "rod": ("json", ".json", ["show", "line", "--rod", "{}"], None),
    "fixtures": ("json", ".json", ["deploy", *PLAN[1:], "--fixtures", "{}"], None),
    "trajectory": (
        "arrays", ".npz", ["deploy", "line", *ROD, "--trajectory", "{}", "--out", "out"], None,
    ),
    "measurements": ("arrays", ".npz", ["identify", "{}", "--out", "out"], None),
    "laid": (
        "arrays", ".npz",
        ["laid", "{}", "--pattern", "line", "--trajectory", "{}", *ROD, "--out", "out/rod.json"],
        None,
    ),
    "stage": ("usd", ".usda", ["render", "{}", "--out", "out", "--size", "16x16"], "newton"),
    "crate": ("usd", ".usdc", ["render", "{}", "--out", "out", "--size", "16x16"], "newton"),
    "controller": (
        "tensors", ".safetensors", ["bench", "controller", "{}", "--count", "10"], None,
    ),
    "urdf": ("urdf", ".urdf", [*PLAN, "--robot", "{}", *FAR], "pytorch_kinematics"),
    "xacro": ("xacro", ".xacro", [*PLAN, "--robot", "{}", *FAR], "xacro"),
    "obstacles": ("json", ".json", [*PLAN, "--obstacles", "{}", *FAR], "pytorch_kinematics"),
    "friction": ("json", ".json", [*PLAN, "--no-robot", "--friction", "{}"], None),
    "dataset": (
        "json", ".json", ["dataset", "--size", "10", "--rod", "{}", "--out", "out"], None,
    ),
    "shards": (
        "tensors", ".safetensors", ["train", "--dataset", "{folder}", "--out", "out"], "torch",
    ),
    "manifest": ("json", ".json", ["train", "--dataset", "{folder}", "--out", "out"], "torch"),
    "checkpoint": (
        "arrays", ".pt", ["train", "--generate", "100", "--out", "{folder}"], "torch",
    ),
    "ledger": ("json", ".jsonl", ["bench", "table3", "--trials", "1", "--out", "{folder}"], None),
    "patterns": ("texts", ".txt", ["bench", "plan", "--patterns", "{folder}"], None),
    "sets": ("arrays", ".npz", ["bench", "identify", "--sets", "{folder}"], None),
    "meshes": ("meshes", "", [*PLAN, "--robot", "{robot}", *FAR], "trimesh"),
}  # fmt: skip
# Of files in a folder: what they are called there.
NAMES = {
    "shards": "grasps-00000.safetensors",
    "manifest": "manifest.json", "checkpoint": "checkpoint.pt",
    "ledger": "trials.jsonl", "patterns": "letterA.txt", "sets": "a.npz",
}  # fmt: skip


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A picture that can be read."""
    path = tmp_path_factory.mktemp("good") / "good.png"
    try:
        from PIL import Image, ImageDraw
    except ImportError:
        return path
    picture = Image.new("RGB", (200, 150), "white")
    ImageDraw.Draw(picture).line([(30, 70), (170, 75)], fill="black", width=5)
    picture.save(path)
    return path


def robot_with(mesh: Path) -> Path:
    """An arm whose last link is that mesh."""
    arm = bombs("urdf")["stylesheet"].decode()
    shape = f'<geometry><mesh filename="{mesh}"/></geometry>'
    last = f'<link name="l7"><visual>{shape}</visual><collision>{shape}</collision></link>'
    path = mesh.with_suffix(".urdf")
    path.write_text(arm.replace('<link name="l7"/>', last))
    return path


@pytest.mark.parametrize("door", DOORS)
def test_no_file_harms(door, tmp_path, good, tried):
    family, suffix, words, extra = DOORS[door]
    if extra is not None:
        pytest.importorskip(extra)
    kinds = list(bombs(family).items())
    others = list(specials(tmp_path / "special", suffix).items())
    draw, late = random.Random(door if FUZZ == 1 else None), time.monotonic() + LONGEST
    if FUZZ == 1:
        kinds = draw.sample(kinds, min(SHARE, len(kinds)))
        others = draw.sample(others, 1)
    both = [*kinds, *others]
    draw.shuffle(both)
    count, refused, wrong = 0, 0, []
    for kind, content in both:
        if time.monotonic() > late:
            break
        place = tmp_path / "run"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        path = _put(door, kind, content, suffix, tmp_path, place)
        if path is None:
            continue
        names = {"{}": path, "{good}": good, "{folder}": path.parent}
        if "{robot}" in words:
            names["{robot}"] = robot_with(path)
        end = call([str(names.get(word, word)) for word in words], place)
        said = end.wrong()
        count, refused = count + 1, refused + (end.code == 2)
        tried[f"files for {door}"] = (count, refused)
        if said is not None:
            wrong.append(f"{kind}: {said}")
        if list(tmp_path.rglob("ran-by-*")):
            wrong.append(f"{kind}: ran code")
        out = place / "out"
        if end.code == 2 and out.exists() and list(out.rglob("*")) and "complete" not in end.said:
            wrong.append(f"{kind}: left {sorted(p.name for p in out.rglob('*'))}")
    assert not wrong, "\n".join(wrong)


def _put(door: str, kind: str, content, suffix: str, base: Path, place: Path) -> Path | None:
    """Where the file is that the call is to read."""
    if isinstance(content, str):  # a special one stands where it is
        if door in NAMES or door == "meshes":
            return None
        return Path(content) if content else Path("")
    if door in NAMES:
        folder = place / "folder"
        folder.mkdir()
        if door == "shards":
            (folder / "manifest.json").write_text(
                '{"format": "wrod-grasps-1", "size": 100, "shard_size": 100, "seed": 0, "closure": '
                '"zero_tension", "edge_count": 128, "sensitivities": true, "solver": "x"}'
            )
        path = folder / NAMES[door]
    elif door == "meshes":
        path = base / kind
    else:
        path = base / f"{kind}{suffix}"
    path.write_bytes(content)
    return path
