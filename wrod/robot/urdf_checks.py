"""What a URDF must hold before a robot is built from it: a tree, and numbers in bounds."""

import math
import warnings
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from wrod.arguments import ONCE_ROUND
from wrod.errors import RobotError, WrodWarning
from wrod.files.reading import shown

MOVING = ("revolute", "continuous", "prismatic")
_KINDS = (*MOVING, "fixed", "floating", "planar")
# Arms have tens of links; a hand with sensors, a hundred.
_MOST_LINKS = 500
# Of lengths [m], of angles [rad] and of joint speeds [rad/s]; files say 10000 for none.
_FARTHEST, _MOST_TURN, _SLOWEST, _FASTEST = 100.0, 1e3, 1e-3, 1e5
# What joints of arms reach in degrees only, not in radians; 1000 rad/s say that there is no limit.
_TURNS, _SPEEDS = 8.0 * math.pi, (30.0, 1e3)
_REMEDY = "correct the file"


def check_urdf(root: ElementTree.Element, path: Path) -> None:
    """Refuse a robot that is no tree of links, or has numbers that no robot has.

    Raises:
        RobotError: names the link or joint, and what is wrong with it.
    """
    if root.tag != "robot":
        raise RobotError(f"{path}: its root element is <{root.tag}>, not <robot>; give a URDF file")
    _check_tree(root, path)
    for joint in root.findall("joint"):
        where = f"{path}: joint {joint.get('name')!r:.80}"
        _check_origin(joint, where)
        axis = joint.find("axis")
        if axis is not None and joint.get("type") in MOVING:
            vector = numbers(axis.get("xyz", "1 0 0"), 3, f"{where}: axis")
            if np.linalg.norm(vector) < 1e-6:
                raise RobotError(f"{where}: its axis is {vector}; {_REMEDY}")
        if joint.get("type") in MOVING:
            _check_limit(joint, where)
    for link in root.findall("link"):
        where = f"{path}: link {link.get('name')!r:.80}"
        for part in link:
            if part.tag in ("visual", "collision"):
                _check_origin(part, f"{where}: {part.tag}")
                _check_shape(part, f"{where}: {part.tag}")
            elif part.tag == "inertial":
                _check_origin(part, f"{where}: inertial")
                for element in part:
                    for name, value in element.attrib.items():
                        if element.tag in ("mass", "inertia"):
                            numbers(value, 1, f"{where}: {element.tag} {name}", most=1e6)
    for color in root.iter("color"):
        rgba = numbers(color.get("rgba", "0.5 0.5 0.5 1"), 4, f"{path}: rgba of a material")
        if min(rgba) < 0.0 or max(rgba) > 1.0:
            raise RobotError(f"{path}: rgba of a material is {rgba}; give four numbers in 0 to 1")


def _check_tree(root: ElementTree.Element, path: Path) -> None:
    links = [link.get("name") or "" for link in root.findall("link")]
    joints = root.findall("joint")
    names = [joint.get("name") or "" for joint in joints]
    if len(links) > _MOST_LINKS:
        raise RobotError(f"{path}: has {len(links)} links; at most {_MOST_LINKS} are planned with")
    for kind, given in (("link", links), ("joint", names)):
        if "" in given:
            raise RobotError(f"{path}: has a {kind} without a name; {_REMEDY}")
        twice = [name for name, count in Counter(given).items() if count > 1]
        if twice:
            raise RobotError(f"{path}: has two {kind}s of the name {shown(twice[0])!r}; {_REMEDY}")
    known, parent = set(links), {}
    for joint, name in zip(joints, names, strict=True):
        if joint.get("type") == "planar":
            raise RobotError(
                f"{path}: joint {name!r:.80} is planar, which no arm here has; make it fixed"
            )
        if joint.get("type") not in _KINDS:
            raise RobotError(
                f"{path}: joint {name!r:.80} is of type {joint.get('type')!r:.80}; URDF knows "
                f"{', '.join(_KINDS)}"
            )
        ends = []
        for end in ("parent", "child"):
            element = joint.find(end)
            link = None if element is None else element.get("link")
            if link not in known:
                raise RobotError(
                    f"{path}: joint {name!r:.80} names the {end} link {str(link)!r:.80}, which the "
                    "file does not have"
                )
            ends.append(link)
        if ends[1] in parent:
            raise RobotError(f"{path}: link {ends[1]!r:.80} hangs from two joints; {_REMEDY}")
        parent[ends[1]] = ends[0]
    roots = [name for name in links if name not in parent]
    if len(roots) != 1:
        raise RobotError(
            f"{path}: {len(roots)} links have no parent ({shown(', '.join(roots)) or 'none'}); a "
            "robot needs exactly one root link"
        )
    for link in links:
        at, steps = link, 0
        while at in parent:
            at, steps = parent[at], steps + 1
            if steps > len(links):
                raise RobotError(
                    f"{path}: link {link!r:.80} hangs from itself, in a cycle; {_REMEDY}"
                )


def _check_limit(joint: ElementTree.Element, where: str) -> None:
    limit = joint.find("limit")
    given = {} if limit is None else limit.attrib
    for name in ("lower", "upper", "velocity", "effort"):
        if name in given:
            numbers(given[name], 1, f"{where}: limit {name}", most=1e9)
    if joint.get("type") != "continuous" and "lower" in given and "upper" in given:
        lower, upper = float(given["lower"]), float(given["upper"])
        if not lower < upper or max(abs(lower), abs(upper)) > _MOST_TURN:
            raise RobotError(
                f"{where}: its limits are {lower:g} to {upper:g}; give the lower one first, in "
                "radians"
            )
    speed = float(given.get("velocity", _FASTEST))
    if speed != 0.0 and not _SLOWEST <= speed <= _FASTEST:
        raise RobotError(
            f"{where}: its velocity limit is {speed:g}; give {_SLOWEST:g} to {_FASTEST:g} rad/s"
        )


def _check_origin(element: ElementTree.Element, where: str) -> None:
    origin = element.find("origin")
    if origin is not None:
        numbers(origin.get("xyz", "0 0 0"), 3, f"{where}: origin xyz")
        numbers(origin.get("rpy", "0 0 0"), 3, f"{where}: origin rpy", most=_MOST_TURN)


def _check_shape(part: ElementTree.Element, where: str) -> None:
    geometry = part.find("geometry")
    shape = next(iter(geometry)) if geometry is not None and len(geometry) else None
    if shape is None or shape.tag not in ("sphere", "cylinder", "box", "mesh"):
        raise RobotError(f"{where} has no sphere, cylinder, box or mesh; {_REMEDY}")
    wanted = {"sphere": {"radius": 1}, "cylinder": {"radius": 1, "length": 1}, "box": {"size": 3}}
    for name, count in wanted.get(shape.tag, {}).items():
        values = numbers(shape.get(name), count, f"{where}: {shape.tag} {name}")
        if min(values) <= 0.0:
            raise RobotError(f"{where}: {shape.tag} {name} is {shape.get(name)}; give it above 0")
    if shape.tag == "mesh":
        if not shape.get("filename"):
            raise RobotError(f"{where}: mesh without a file name; {_REMEDY}")
        scale = numbers(shape.get("scale", "1 1 1"), 3, f"{where}: mesh scale", most=1e6)
        if 0.0 in scale:
            raise RobotError(f"{where}: mesh scale is {scale}; {_REMEDY}")


def numbers(text: str | None, count: int, where: str, most: float = _FARTHEST) -> list[float]:
    """`count` finite numbers of an attribute.

    Raises:
        RobotError: `where` begins the sentence.
    """
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(v) and abs(v) <= most for v in values):
        what = "one finite number" if count == 1 else f"{count} finite numbers"
        raise RobotError(f"{where} is {shown(str(text))!r}; give {what}, at most {most:g} in size")
    return values


def check_reach(path: Path, chain, lower: np.ndarray, upper: np.ndarray) -> None:
    """Refuse a chain that cannot turn and move its tip in all six directions anywhere.

    Args:
        chain: `pytorch_kinematics.SerialChain` from the base to the tip, float64.
        lower, upper: (n,) limits of its joints [rad].

    Raises:
        RobotError: it has less than six freedoms, as of joints about one axis.
    """
    import torch

    lower, upper = np.maximum(lower, -np.pi), np.minimum(upper, np.pi)
    share = np.random.default_rng(0).random((16, len(lower)))
    joints = torch.from_numpy(lower + share * (upper - lower))
    values = np.linalg.svd(chain.jacobian(joints).numpy(), compute_uv=False)
    if (values[:, -1] / values[:, 0]).max() < 1e-6:
        freedoms = int((values / values[:, :1] > 1e-6).sum(axis=1).max())
        raise RobotError(
            f"{path}: its {len(lower)} joints move the grasp in {freedoms} directions only; a grip "
            "pose in space needs six"
        )


def chain_limits(path, joints, tip: str) -> tuple:
    """Names of the joints that move a link, from the base on, their limits lower and upper (n,)
    [rad], and velocities (n,) [rad/s].

    Raises:
        RobotError: they are fewer than six, one slides or mimics another, or has no limits.

    Warns:
        WrodWarning: one has numbers of degrees.
    """
    above = {joint.find("child").get("link"): joint for joint in joints}
    chain, link = [], tip
    while link in above:
        joint = above[link]
        link = joint.find("parent").get("link")
        if joint.get("type") != "fixed":
            chain.insert(0, joint)
    if len(chain) < 6:
        raise RobotError(
            f"{path}: {len(chain)} joints move the grasp; a grip pose in space needs six"
        )
    limits, velocity = [], []
    for joint in chain:
        name = joint.get("name")
        if joint.get("type") == "prismatic":
            raise RobotError(
                f"{path}: joint {name!r:.80} slides; paths are planned for joints that turn, so "
                "make it fixed in the file, with its origin where it is to stand"
            )
        if joint.find("mimic") is not None:
            raise RobotError(
                f"{path}: joint {name!r:.80} mimics another; paths are planned for joints that "
                "turn by themselves, so remove its <mimic>, or make it fixed"
            )
        limit = joint.find("limit")
        if joint.get("type") == "continuous":
            limits.append((-np.inf, np.inf))
        elif limit is None or limit.get("lower") is None or limit.get("upper") is None:
            raise RobotError(
                f"{path}: joint {name!r:.80} has no position limits; add them to the file, as "
                '<limit lower="..." upper="..." velocity="..."/>'
            )
        else:
            limits.append((float(limit.get("lower")), float(limit.get("upper"))))
        if limit is None or not float(limit.get("velocity", 0)) > 0:
            raise RobotError(
                f"{path}: joint {name!r:.80} has no velocity limit; add it to its <limit>, as "
                'velocity="..." in rad/s'
            )
        velocity.append(float(limit.get("velocity")))
    lower, upper = np.array(limits).T
    for joint, ends, speed in zip(chain, limits, velocity, strict=True):
        _ask_after_degrees(path, joint, ends, speed)
    return tuple(joint.get("name") for joint in chain), lower, upper, np.array(velocity)


def _ask_after_degrees(path, joint: ElementTree.Element, ends: tuple, speed: float) -> None:
    """Warn of what of a joint was likely meant in degrees: a path would go beyond its stops."""
    origin = joint.find("origin")
    rotated = [] if origin is None else map(float, origin.get("rpy", "").split())
    turn = max(abs(end) for end in ends) if math.isfinite(ends[0]) else 0.0
    rotation = max(map(abs, rotated), default=0.0)
    said = [f"turns to {turn:g} rad"] * bool(turn > _TURNS)
    said += [f"may turn by {speed:g} rad/s"] * (_SPEEDS[0] < speed < _SPEEDS[1])
    said += [f"is rotated by {rotation:g} rad"] * bool(rotation > ONCE_ROUND)
    if said:
        text = f"{path}: joint {joint.get('name')!r:.80} {' and '.join(said)} (degrees?)"
        warnings.warn(WrodWarning(text), stacklevel=4)
