"""No room looks up, nothing goes in circles, and functions stay short (`tests/house.py`)."""

import ast
from pathlib import Path

import house
import pytest

ROOT = Path(__file__).parents[1]
# Public signatures, whose keywords are their users'.
WIDE = 4


@pytest.fixture(scope="module")
def seen():
    return house.read(ROOT)


def test_no_room_looks_up_and_no_files_go_in_circles(seen):
    assert len(seen.rooms) > 20 and sum(map(len, seen.rooms.values())) > 100
    assert house.arrows_up(seen.rooms) == []
    assert house.circles(seen.rooms) == []
    assert seen.file_circles == []
    assert "wrod.commands" not in seen.rooms["wrod.bench"]
    assert "wrod.bench" not in seen.rooms["wrod.commands"]
    assert {"wrod.bench", "wrod.commands"}.isdisjoint(
        other for room, others in seen.rooms.items() if room.count(".") for other in others
        if room not in ("wrod.bench", "wrod.commands", "wrod.__main__")
    )  # fmt: skip


def test_functions_are_short_outside_kernels(seen):
    assert seen.long == []
    assert len(seen.wide) <= WIDE, seen.wide


def of_file(tree):
    """Names that a file defines or imports at its top."""
    names = set()
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            names.add(node.name)
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            names |= {a.asname or a.name for a in node.names}
        else:
            names |= {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
    return names


def test_what_is_taken_from_kernels_is_there(seen):
    """mypy looks into no kernels: a name that is gone would be found by who launches it."""
    kernels = {m: of_file(tree) for m, tree in seen.trees.items() if m.startswith(house.KERNELS)}
    looked_at, gone = 0, []
    for file, tree in seen.trees.items():
        if not any(other in kernels for other in seen.imports[file]):
            continue
        nodes = list(ast.walk(tree))
        own = {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
        own |= {n.arg for n in nodes if isinstance(n, ast.arg)}
        taken, modules = [], {}
        for node in nodes:
            if isinstance(node, ast.ImportFrom) and node.module:
                for one in node.names:
                    taken.append((node.module, one.name))
                    modules[one.asname or one.name] = f"{node.module}.{one.name}"
        for node in nodes:
            of = node.value if isinstance(node, ast.Attribute) else None
            if isinstance(of, ast.Name) and of.id not in own:
                taken.append((modules.get(of.id), node.attr))
        taken = [one for one in taken if one[0] in kernels and ".".join(one) not in kernels]
        looked_at += len(taken)
        gone += [(file, *one) for one in taken if one[1] not in kernels[one[0]]]
    assert looked_at > 500 and not gone


def test_circles_and_long_functions_are_seen(tmp_path):
    """The measure finds what the tests above say is not there."""
    for name in house.FOLDERS:
        (tmp_path / name).mkdir()
    for room, text in {
        "low": "def f():\n    from wrod.high import h\n",
        "high": "from wrod.low.a import f\n\n\ndef h():\n" + "    x = 1\n" * 80,
    }.items():
        (tmp_path / "wrod" / room).mkdir()
        (tmp_path / "wrod" / room / "__init__.py").write_text("")
        (tmp_path / "wrod" / room / "a.py").write_text(text)
    (tmp_path / "wrod" / "low" / "a.py").write_text("from wrod.high.a import h\n")
    seen = house.read(tmp_path)
    assert seen.file_circles == [["wrod.high.a", "wrod.low.a"]]
    assert house.circles(seen.rooms) == [["wrod.high", "wrod.low"]]
    assert len(house.arrows_up(seen.rooms)) == 1
    assert seen.long == [("wrod.high.a.h", 81)]
