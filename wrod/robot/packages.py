"""Where the packages of ROS are that a robot's file names."""

import os
from pathlib import Path


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
