"""The line that says on what machine and with which versions a number was read."""

import os
import platform
from pathlib import Path

from wrod import __version__
from wrod.errors import DataError


def machine_line(device: str = "cpu") -> str:
    """Processor, cores, device and library versions, for the head of every benchmark."""
    from importlib.metadata import PackageNotFoundError, version  # commands load without

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


# Processes that this one shares its cores with, itself included.
_beside = 1


def share_cores(processes: int) -> None:
    """Let this process take no more than its part of the cores, of so many processes."""
    global _beside
    _beside = processes


def usable_cores() -> int:
    """Cores that this process may run on, or its part of them."""
    asked = hasattr(os, "sched_getaffinity")
    cores = len(os.sched_getaffinity(0)) if asked else os.cpu_count() or 1
    return max(1, cores // _beside)


def worker_threads(asked: int | None = None) -> int:
    """Threads to work with on a CPU: those asked for, or one per core, but no more than
    OMP_NUM_THREADS says."""
    said = os.environ.get("OMP_NUM_THREADS", "")
    most = int(said) if said.isdecimal() and int(said) > 0 else usable_cores()
    return asked or min(usable_cores(), most)


def available_memory(device: str = "cpu") -> float:
    """Bytes that this process may still take, of a GPU those that are free there; infinite where
    the system does not say."""
    if device != "cpu":
        import warp as wp

        return float(wp.get_device(device).free_memory)
    free = float("inf")
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                free = 1024.0 * int(line.split()[1])
        group = Path("/sys/fs/cgroup")
        limit = (group / "memory.max").read_text().strip()
        if limit != "max":
            used = int((group / "memory.current").read_text())
            free = min(free, float(int(limit) - used))
    except (OSError, ValueError, IndexError):
        pass  # another system, or an older one
    return free


def require_memory(needed: float, what: str, remedy: str, device: str = "cpu") -> None:
    """Refuse work that does not fit into the memory of this machine, or of its GPU.

    Args:
        needed: bytes.
        what: needs them, and `remedy`: what to do, for the message.

    Raises:
        DataError: there are less.
    """
    free = available_memory(device)
    if needed > free:
        where = "" if device == "cpu" else f" on {device}"
        raise DataError(
            f"{what} need about {needed / 2**30:.3g} GiB of memory{where}, and "
            f"{free / 2**30:.3g} GiB are free; {remedy}"
        )
