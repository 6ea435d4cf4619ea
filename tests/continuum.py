"""Optimal grasps of a continuous Kirchhoff rod by collocation (SciPy), not by elements.

`python tests/continuum.py` writes `tests/data/continuum_grasps.json`, which tests of grasps and
controllers compare with in every clone.
"""

import json
from pathlib import Path

STORED = Path(__file__).parent / "data" / "continuum_grasps.json"
# (l_s, kappa, k_s) over the range that occurs: ends, middle, both turns.
INPUTS = (
    (1.1, 0.0, 2087.0), (1.1, 3.2, 400.0), (2.0, -1.0, 15000.0), (3.5, 2.6, 2087.0),
    (5.0, 0.5, 506.0), (5.0, 1.0, 1600.0), (8.0, 0.0, 2087.0), (8.0, -2.0, 2087.0),
    (13.0, 1.5, 150.0), (17.68, 0.5, 2087.0), (27.0, 3.0, 8000.0), (48.0, 1.0, 1156.0),
)  # fmt: skip


def main():
    from continuum_rods import uniform_grasp

    entries = []
    for inputs in INPUTS:
        rod, found = uniform_grasp(*inputs, tolerance=1e-9)
        position, rotation, force = rod.read(found)
        parts = dict(position=position, rotation=rotation.as_rotvec(), force=force)
        entries.append(
            dict(zip(("ls", "kappa", "ks"), inputs, strict=True))
            | {name: part.tolist() for name, part in parts.items()}
        )
        print(inputs)
    STORED.write_text(json.dumps(entries, indent=1) + "\n")


if __name__ == "__main__":
    main()
