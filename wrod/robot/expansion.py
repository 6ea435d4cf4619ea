"""xacro files as URDF text. They hold expressions: these are expanded in a process of their own,
which has bounds in time and memory, and whose expressions reach no attribute that leads to code.

`python -m wrod.robot.expansion FILE` is that process.
"""

import ast
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from wrod.errors import RobotError
from wrod.files import checked_path
from wrod.files.reading import MIB, shown

_SECONDS, _WALL, _MEMORY, _LONGEST = 6, 30.0, 1024 * MIB, 16 * MIB
# What an expression needs no part of, and from which every builtin can be reached.
_FORBIDDEN = (ast.Lambda, ast.GeneratorExp, ast.NamedExpr, ast.Await, ast.Yield, ast.YieldFrom)
_INNER = ("gi_", "cr_", "ag_", "tb_", "co_", "f_back", "f_globals", "f_locals", "f_builtins")
_TEXTUAL = ("format", "format_map")


def expanded(path: Path) -> bytes:
    """Text of the URDF that a xacro file makes.

    Raises:
        RobotError: xacro is missing, or cannot expand the file within 6 s and 1 GiB.
    """
    checked_path(path, "a xacro file", error=RobotError, limit=16 * MIB)
    if find_spec("xacro") is None:
        raise RobotError(
            f"{path}: is a xacro file, which needs the package xacro; install wrod[meshes], or "
            "write the URDF with `xacro FILE > arm.urdf`"
        )
    remedy = "write the URDF where its packages are installed, with `xacro FILE > arm.urdf`"
    call = [sys.executable, "-P", "-m", "wrod.robot.expansion", str(path.resolve())]
    try:
        done = subprocess.run(
            call, capture_output=True, timeout=_WALL, stdin=subprocess.DEVNULL,
            start_new_session=True,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise RobotError(f"{path}: xacro does not end within {_WALL:.0f} s; {remedy}") from None
    if done.returncode < 0:
        raise RobotError(f"{path}: xacro does not end within {_SECONDS} s; {remedy}")
    if done.returncode != 0 or not done.stdout:
        lines = done.stderr.decode(errors="replace").strip().splitlines() or ["it says nothing"]
        raise RobotError(f"{path}: xacro cannot expand it ({shown(lines[-1], 300)}); {remedy}")
    if len(done.stdout) > _LONGEST:
        raise RobotError(f"{path}: expands to {len(done.stdout) / MIB:.0f} MiB; that is no robot")
    return done.stdout


def folders_of(package: str, file: Path) -> list[Path]:
    """Folders that may be a package, likeliest first: of its name above the file, beside one above,
    or on ROS_PACKAGE_PATH or AMENT_PREFIX_PATH; then those above the file's own folder, for files
    that were handed on without their package, or in one of another name.
    """
    above = list(file.resolve().parents)
    ros = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    ament = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    named = [Path(p) for p in ros if p] + [Path(p) / "share" for p in ament if p]
    beside = [folder / package for folder in above + named]
    return [folder for folder in above if folder.name == package] + beside + above[1:]


def refuse_code(expression: str) -> None:
    """Refuse an expression that could do more than calculate.

    Raises:
        ValueError: names the part.
    """
    for node in ast.walk(ast.parse(expression.strip(), mode="eval")):
        name = getattr(node, "attr", None) or getattr(node, "id", None) or ""
        if isinstance(node, _FORBIDDEN) or name.startswith(("_", *_INNER)) or name in _TEXTUAL:
            said = name or type(node).__name__
            raise ValueError(
                f"the expression {shown(expression)} uses {said}, which no robot needs"
            )


def _main(path: str) -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_CPU, (_SECONDS, _SECONDS))
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_FSIZE, (_LONGEST, _LONGEST))
    import xacro
    from xacro import substitution_args

    evaluate = xacro.safe_eval

    def guarded(expression, *scope):
        refuse_code(expression)
        return evaluate(expression, *scope)

    xacro.safe_eval = guarded
    # xacro asks an installation of ROS, which need not be here.
    substitution_args._eval_find = lambda package: str(
        next(folder for folder in folders_of(package, Path(path)) if folder.is_dir())
    )
    try:
        sys.stdout.write(xacro.process_file(path).toxml())
    except MemoryError:
        sys.exit("it needs more than 1 GiB")
    except RecursionError:
        sys.exit("it expands within itself without an end")
    except Exception as error:
        sys.exit(" ".join(str(error).split()) or type(error).__name__)


if __name__ == "__main__":
    _main(sys.argv[1])
