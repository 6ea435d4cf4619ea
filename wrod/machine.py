"""The line that says on what machine and with which versions a number was read."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from wrod import __version__


def machine_line(device: str = "cpu") -> str:
    """Processor, cores, device and library versions, for the head of every benchmark."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                cpu = line.split(":", 1)[1].strip()
                break
    parts = [f"{cpu}, {os.cpu_count()} cores", f"Python {platform.python_version()}"]
    parts.append(f"wrod {__version__}")
    for package in ("warp-lang", "numpy", "torch"):
        try:
            parts.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            continue
    if device != "cpu":
        import warp as wp

        parts.insert(1, wp.get_device(device).name)
    return "; ".join(parts)
