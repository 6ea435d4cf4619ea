"""What robots measured: the accuracy table of Tong et al., e_mean ± sigma [cm].

Tong, Choi, Qin, Huang, Joo, Jawed: Sim2Real neural controllers for physics-based robotic
deployment of deformable linear objects, Table 3 (ten trials a cell).
"""

from itertools import product
from pathlib import Path

import click

PATTERNS = ("line", "circle", "sine", "letter-U", "letter-C", "letter-L", "letter-A")
RODS = ("pink-vps", "green-vps", "rope")
SUBSTRATES = ("fabric", "steel", "foam")
METHODS = ("intuitive", "numeric")

# The paper's words for each rod's friction, Table 2, and what they are taken to mean.
FRICTION = {"low": 0.3, "medium": 0.6, "high": 1.0}
_WORDS = {
    "pink-vps": ("low", "medium", "high"),
    "green-vps": ("low", "medium", "high"),
    "rope": ("medium", "low", "high"),
}
_ROWS = """
0.40 0.22 0.61 0.36 1.66 0.74 1.39 0.63 2.21 0.92 1.00 0.59 4.81 2.27
0.14 0.09 0.15 0.07 0.27 0.10 0.22 0.07 0.22 0.10 0.35 0.18 0.47 0.23
1.42 0.66 2.34 1.24 2.69 1.69 3.59 2.39 3.67 1.93 0.87 0.55 3.64 2.09
0.22 0.12 0.22 0.08 0.27 0.10 0.24 0.13 0.27 0.09 0.42 0.16 0.58 0.37
1.03 0.21 1.23 0.45 2.84 1.52 3.33 1.93 3.89 1.29 1.13 0.74 4.09 2.19
0.25 0.15 0.18 0.06 0.29 0.16 0.24 0.15 0.41 0.20 0.35 0.12 0.54 0.24
0.52 0.13 1.64 0.95 1.60 0.83 3.74 2.89 4.58 1.15 1.74 1.11 4.95 2.63
0.13 0.07 0.16 0.07 0.20 0.09 0.17 0.11 0.19 0.22 0.29 0.11 0.32 0.18
1.72 0.63 2.52 1.02 3.30 2.08 4.78 4.15 6.66 2.53 2.14 1.26 5.23 3.38
0.17 0.08 0.22 0.09 0.54 0.20 0.21 0.09 0.74 0.31 0.66 0.24 0.36 0.17
1.38 0.60 2.24 0.97 4.17 2.57 5.42 4.47 6.14 3.08 1.70 1.32 5.09 3.39
0.27 0.13 0.20 0.09 0.37 0.14 0.17 0.08 0.39 0.18 0.37 0.15 0.43 0.19
1.56 0.81 1.13 0.53 5.09 1.35 4.22 3.10 3.36 1.58 2.37 1.56 4.59 2.54
0.49 0.28 0.29 0.15 0.47 0.23 0.36 0.18 0.35 0.19 0.50 0.24 0.56 0.29
4.53 2.80 1.85 0.45 4.43 2.82 4.53 2.80 3.35 1.55 2.57 1.62 4.30 1.73
0.47 0.20 0.29 0.13 0.46 0.20 0.47 0.20 0.56 0.20 0.51 0.24 0.81 0.30
2.00 0.88 1.94 0.84 3.80 1.96 3.67 2.46 6.03 3.11 3.32 1.80 4.47 2.50
0.78 0.34 0.27 0.15 0.46 0.20 0.32 0.16 0.56 0.26 0.33 0.14 0.52 0.20
"""


def friction(rod: str, substrate: str) -> float:
    """Friction coefficient of a rod on a substrate."""
    return FRICTION[_WORDS[rod][SUBSTRATES.index(substrate)]]


def measured() -> dict[tuple[str, str, str, str], tuple[float, float]]:
    """(rod, substrate, pattern, method) -> e_mean, sigma [cm]."""
    table = {}
    for cell, line in zip(product(RODS, SUBSTRATES, METHODS), _ROWS.split("\n")[1:-1], strict=True):
        rod, substrate, method = cell
        numbers = [float(x) for x in line.split()]
        for name, mean, spread in zip(PATTERNS, numbers[::2], numbers[1::2], strict=True):
            table[rod, substrate, name, method] = (mean, spread)
    return table


# What `read_pattern` reads patterns from.
patterns_option = click.option(
    "--patterns",
    type=click.Path(file_okay=False, exists=True, path_type=Path),
    help="Folder of pattern files (line.txt, letterA.txt, ...); default: the built-in patterns.",
)


def read_pattern(name: str, folder: Path | None):
    """The built-in pattern of that name, or that of a folder of files (line.txt, letterA.txt)."""
    from wrod.patterns.named import pattern
    from wrod.patterns.pattern import Pattern

    if folder is None:
        return pattern(name)
    return Pattern.load(folder / f"{name.replace('-', '')}.txt", name=name)
