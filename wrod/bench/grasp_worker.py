"""Grasps per second of one checkout: a process of `wrod bench grasp --against`, which may be of an
older wrod than this file.

`python grasp_worker.py CHECKOUT INPUTS DEVICE` reads lines "count closure" and answers each with
the seconds of one call on the first inputs of the file, and the share that converged.
"""

import gc
import importlib.util
import inspect
import sys
import time
from pathlib import Path
from typing import Any

# Where a checkout has the packages that are installed beneath wrod.
_FOLDERS = {"wrod.kernels": "kernels", "wrod.scenes": "scenes", "wrod.training": "training"}


class _Checkout:
    """Finds wrod in a checkout that is not installed."""

    def __init__(self, root: Path):
        self.root = root

    def find_spec(self, name, path=None, target=None):
        if name != "wrod" and name not in _FOLDERS:
            return None
        folder = self.root / _FOLDERS.get(name, "wrod")
        if not folder.is_dir():  # installed, where they are beneath it
            folder = self.root.joinpath(*name.split("."))
        return importlib.util.spec_from_file_location(
            name, folder / "__init__.py", submodule_search_locations=[str(folder)]
        )


def main() -> None:
    root, file, device = Path(sys.argv[1]), sys.argv[2], sys.argv[3]
    sys.meta_path.insert(0, _Checkout(root))
    import numpy as np
    import warp as wp

    try:
        room = importlib.import_module("wrod.grasps.optimal")
    except ModuleNotFoundError:  # before the library had rooms
        room = importlib.import_module("wrod.grasps")
    solve_grasps = room.solve_grasps

    options: dict[str, Any] = {"device": device}
    if "shapes" in inspect.signature(solve_grasps).parameters:
        options["shapes"] = False
    inputs = list(np.load(file).values())
    takes_arrays = "wrod.grasps.device_results" in sys.modules
    for line in sys.stdin:
        count, closure = int(line.split()[0]), line.split()[1]
        part = [values[:count] for values in inputs]
        if device != "cpu" and takes_arrays:
            part = [wp.array(values, dtype=wp.float64, device=device) for values in part]
        wp.synchronize_device(device)
        clock = time.perf_counter()
        grasps = solve_grasps(*part, closure=closure, **options)
        wp.synchronize_device(device)
        seconds = time.perf_counter() - clock
        converged = grasps.converged
        converged = converged.numpy() if hasattr(converged, "numpy") else converged
        share = float(converged.mean())
        grasps = converged = None  # the other process may need the room
        gc.collect()
        wp.synchronize_device(device)
        print("seconds", seconds, share, flush=True)


if __name__ == "__main__":
    main()
