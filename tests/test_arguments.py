"""Every parameter of every public callable meets what nobody means: only typed errors, or success.

A call is one that works; one argument after the other is replaced. What is refused has to be
refused before the work, so a call that still works after a while has taken its argument.
"""

import array
import atexit
import copy
import importlib
import inspect
import itertools
import os
import pickle
import random
import shutil
import signal
import sys
import tempfile
import time
import warnings
from contextlib import contextmanager, suppress
from dataclasses import fields
from decimal import Decimal
from fractions import Fraction
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
import scipy.signal  # noqa: F401 - half of it would stay where a call is cut short that imports it
from hostile import arrays_of, save_arrays
from strange import STRANGE
from wrod.scenes import sawyer

import wrod
from wrod.errors import WrodError
from wrod.identification.template import write_template

FUZZ = int(os.environ.get("WROD_FUZZ", "1"))
# Of the wrong values of a parameter, in the tests; `make fuzz` tries all, for so long [s] and in
# another order each time.
SHARE, LONGEST = 5, 90.0
TAKEN = 0.5 if FUZZ == 1 else 1.0  # [s] a call that works so long has taken its arguments


class Hostile:
    """Of a type that nothing knows."""


class Liar:
    """Says that it is an array, a number, a text and a path, and raises when it is asked."""

    def _raise(self, *_, **__):
        raise RuntimeError("no")

    __array__ = __float__ = __fspath__ = __len__ = __iter__ = __bool__ = __eq__ = _raise
    __hash__ = None


class Table:
    """As pandas has them: columns of their own kinds, by name."""

    columns, shape, ndim, size = ["x", "y"], (3, 2), 2, 6

    def __array__(self, dtype=None, copy=None):
        return np.array([[1.0, "a"], [2.0, None], [np.nan, "b"]], dtype=object)

    def __len__(self):
        return 3

    def __getitem__(self, key):
        raise KeyError(key)


class Tagged(np.ndarray):
    """A subclass that takes part in nothing."""

    __array_priority__ = 1e9

    def __array_ufunc__(self, *_, **__):
        return NotImplemented


class Sly(float):
    """A number that is none when it is asked."""

    def __float__(self):
        return float("nan")

    def __index__(self):
        raise OverflowError("no")


WRONG = {
    "table": Table(), "subclass": np.ones((4, 3)).view(Tagged), "sly": Sly(0.5),
    "memory": memoryview(b"abcdefgh"), "numbers": array.array("d", [0.1, 0.2, 0.3]),
    "void": np.void(b"abc"), "duration": np.timedelta64(3, "s"), "big-endian": np.ones(3, ">f8"),
    "zero-d object": np.array(None, dtype=object), "zero-d text": np.array("line"),
    "uint": np.full((4, 3), 2**64 - 1, np.uint64), "mapping": MappingProxyType({"a": 1}),
    "strange keys": {None: 1, 2: "b"},
    "huge range": range(10**18),
    "bool list": [True, False, True], "text numbers": ["0.1", "0.2", "0.3"], "pair": (0.1, "m"),
    "nan list": [float("nan")] * 4, "many": [0.1] * 100_000, "iterator": iter([0.1, 0.2]),
    "None": None, "words": "words", "no text": "", "bytes": b"x", "truth": True, "zero": 0,
    "minus": -1, "half": 0.5, "nan": float("nan"), "inf": float("inf"), "minus inf": -float("inf"),
    "huge": 1e300, "tiny": 1e-300, "digits": 10**400, "minus digits": -(10**400), "complex": 1j,
    "no list": [], "list": [1, 2, 3], "nested": [[1, 2], [3]], "mixed": [1, "a", None],
    "dict": {"a": 1}, "no dict": {}, "object": Hostile(), "class": Hostile, 
    "none in list": [None], "no array": np.zeros(0), "array": np.zeros(3), "matrix": np.eye(2),
    "deep array": np.zeros((1, 1, 1, 1, 1)), "nan array": np.full((4, 3), np.nan),
    "inf array": np.full((1, 4, 3), np.inf), "text array": np.array(["a"]), "zero byte": "a\0b",
    "object array": np.array([None, 1], dtype=object), "path": "/proc/nothing/x", "big": 10**9,
    "function": lambda *_: 1,
    "set": {1}, "generator": (k for k in ()), "bool array": np.ones(3, bool), "long": "x" * 5000,
    "masked array": np.ma.masked_array(np.ones(3), [0, 1, 0]), "datetime": np.datetime64("now"),
    "times": np.array(["2020", "2021"], "M8[D]"), "record": np.zeros(3, "f8,i4"),
    "complex array": np.ones((4, 3), complex), "half array": np.ones((4, 3), np.float16),
    "byte array": np.ones((4, 3), np.int8), "long array": np.ones((4, 3), np.longdouble),
    "read only": np.broadcast_to(1.0, (4, 3)), "strided": np.ones((8, 6))[::2, ::-2],
    "fortran": np.asfortranarray(np.ones((4, 3))), "zero-d": np.array(1.0), "np int": np.int8(3),
    "np bool": np.bool_(True), "np text": np.str_("words"), "fraction": Fraction(1, 3),
    "decimal": Decimal("0.1"), "minus zero": -0.0, "subnormal": 5e-324, "almost inf": 1.8e308,
    "range": range(3), "bytearray": bytearray(b"abc"), "module": np, "type": float,
    "exception": ValueError("x"), "ellipsis": ..., "slice": slice(3), "surrogate": "\udcff",
    "folder": "/", "device": "/dev/null", "proc": "/proc/self/environ", "rich": Liar(),
    "endless": itertools.repeat(1.0), "broadcast": np.broadcast_to(1.0, (2**33, 3)),
    "no rows": np.zeros((0, 3)), "no columns": np.zeros((3, 0)), "matrix type": np.matrix("1 2"),
    "bytes array": np.array([b"a"]), "enum": signal.SIGINT, "nested dict": {1: {}},
    "zeros": np.zeros((4, 3)), "huge array": np.full((4, 3), 1e300), "frozen": frozenset({"a"}),
}  # fmt: skip
WRONG |= STRANGE
WRONG["own list"] = own = []
own.append(own)
deep: list = []
for _ in range(100_000):
    deep = [deep]
WRONG["deep list"] = deep
with suppress(ImportError):
    import torch

    WRONG |= {
        "gradient": torch.ones((4, 3), requires_grad=True), "meta": torch.ones(3, device="meta"),
        "half tensor": torch.ones((4, 3), dtype=torch.half), "empty tensor": torch.zeros((0, 3)),
        "complex tensor": torch.ones(3, dtype=torch.cfloat), "truths": torch.ones(3, dtype=bool),
        "conjugate": torch.ones(3, dtype=torch.cdouble).conj(),
        "nan tensor": torch.full((4, 3), np.nan),
        "bfloat": torch.ones(3, dtype=torch.bfloat16), "sparse": torch.eye(3).to_sparse(),
    }  # fmt: skip
with suppress(ImportError):
    import warp

    WRONG |= {"warp": warp.ones((4, 3), dtype=float), "warp points": warp.zeros(3, dtype=warp.vec3)}
    WRONG |= {
        "warp whole": warp.zeros(3, dtype=int),
        "warp frames": warp.zeros(2, dtype=warp.quatd),
    }
    WRONG |= {"warp half": warp.ones(3, dtype=warp.float16), "warp type": warp.float64}


@pytest.fixture(scope="module", autouse=True)
def loaded():
    """What is imported late is imported now: an import that is cut short leaves halves."""
    for name in ("torch", "scipy.optimize", "pytorch_kinematics", "cv2", "pxr.UsdGeom", "newton"):
        with suppress(ImportError):
            importlib.import_module(name)


class _Enough(BaseException):
    """A call took longer than its arguments need."""


@contextmanager
def at_most(seconds: float):
    def late(*_):
        raise _Enough

    # A call that is cut short while it leaves `torch.no_grad` would leave gradients off for all.
    torch = sys.modules.get("torch")
    gradients = torch and torch.is_grad_enabled()
    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
        if torch:
            torch.set_grad_enabled(gradients)


def batch():
    x = np.linspace(0.0, 0.1, 6)
    position = np.stack([x, 0 * x, 0 * x], 1)[None]
    return dict(
        position=position, rest_length=0.02, stretching_stiffness=100.0, bending_stiffness=1e-4,
        twisting_stiffness=1e-4, natural_curvature=0.0, natural_twist=0.0, softening=0.0,
        node_mass=1e-3, gravity=(0.0, 0.0, -9.81), point_load=0.0, director=None, device="cpu",
    )  # fmt: skip


@cache
def line():
    return wrod.pattern("line")


@cache
def vps():
    return wrod.rod("green-vps")


@cache
def rod_model():
    return wrod.RodModel.of(vps())


@cache
def path():
    return wrod.plan(line(), vps(), "intuitive", spacing=0.02)


@cache
def files() -> dict[str, str]:
    """A valid file of each kind that something loads."""
    folder = Path(tempfile.mkdtemp(prefix="wrod-arguments-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    made = {
        "rod": wrod.save_rod(vps(), folder / "rod.json"),
        "model": wrod.save_rod(rod_model(), folder / "m.json"),
    }
    made["trajectory"] = path().save(folder / "plan")[1]
    for kind in ("clamped", "motion"):
        made[kind] = write_template(kind, folder / f"{kind}.npz")
    for kind in ("JointPath", "Deployment"):
        made[kind] = folder / f"{kind}.npz"
        save_arrays(made[kind], arrays_of(kind) | {"metadata": np.array("{}")})
    scenes = Path(sawyer.__file__).parent
    made |= {"knot": scenes / "knots" / "trefoil.json", "fixtures": scenes / "cable" / "U.json"}
    made["stage"] = folder / "stage.usda"
    made["stage"].write_text("#usda 1.0\n")
    made["points"] = folder / "points.csv"
    made["points"].write_text("".join(f"{0.01 * k}, {1e-3 * k * k}\n" for k in range(20)))
    return {kind: str(one) for kind, one in made.items()}


def rods():
    return wrod.RodBatch(**batch())


def free(one):
    one.set_free(wrod.prescribe(one, clamped_nodes=[0, 1], clamped_angles=[0]))
    return one


def picture():
    image = np.full((120, 160), 255, np.uint8)
    image[58:63, 20:140] = 0
    return image


def model():
    newton = pytest.importorskip("newton")
    builder = newton.ModelBuilder()
    wrod.SolverDER.register_custom_attributes(builder)
    wrod.SolverDER.add_rod(builder, batch()["position"][0] + [0, 0, 1], vps())
    return builder.finalize()


def builder():
    newton = pytest.importorskip("newton")
    made = newton.ModelBuilder()
    wrod.SolverDER.register_custom_attributes(made)
    return made


def knot():
    from wrod.bench.applications_trials import knot_plan

    return knot_plan("trefoil")


def joint_path():
    pytest.importorskip("pytorch_kinematics")
    return dict(
        trajectory=path(), robot="sawyer", placement="auto", grip_angle="auto",
        table_height=None, obstacles=None, pace=0.02, rate=100.0, limit_margin=0.02,
        clearance=0.005,
    )  # fmt: skip


ROD = dict(radius=0.0016, gravito_bending_length=0.03, length=0.8, poisson=0.5, density=1180.0,
           gravity=9.81, natural_curvature=(0.0, 0.0))  # fmt: skip
MODEL = dict(
    length=0.8, bending_stiffness=1e-4, twisting_stiffness=1e-4, stretching_stiffness=100.0,
    line_mass=0.01, radius=0.002, principal_angle=0.0, natural_curvature=(0.0, 0.0),
    natural_twist=0.0, point_masses=(), internal_damping=0.0, relaxation_time=0.0, air_damping=0.0,
    quadratic_drag=0.0, gravity=9.81,
)  # fmt: skip
# Public callables: what makes the function, and the arguments with which it works. Arguments that
# begin with * are given by their place.
CALLS = {
    "rod": lambda: (wrod.rod, dict(name="green-vps")),
    "pattern": lambda: (wrod.pattern, dict(name="line")),
    "RodMaterial": lambda: (wrod.RodMaterial, ROD),
    "RodMaterial.from_youngs_modulus": lambda: (
        wrod.RodMaterial.from_youngs_modulus,
        dict(youngs_modulus=1e6, radius=0.002, length=0.8, poisson=0.5, density=1e3, gravity=9.81),
    ),
    "RodMaterial.from_loop_height": lambda: (
        wrod.RodMaterial.from_loop_height,
        dict(loop_height=0.04, radius=0.002, length=0.8, poisson=0.5, density=1e3, gravity=9.81),
    ),
    "load_rod": lambda: (wrod.load_rod, dict(path=files()["rod"], radius=None, length=None)),
    "load_rod, a model": lambda: (
        wrod.load_rod,
        dict(path=files()["model"], radius=None, length=None),
    ),
    "save_rod": lambda: (wrod.save_rod, dict(rod=vps(), path="/proc/none/a", assumed=())),
    "save_rod, a model": lambda: (
        wrod.save_rod, dict(rod=rod_model(), path="/proc/none/a", assumed=(), found=None),
    ),
    "RodMaterial.curvature_held": lambda: (vps().curvature_held, dict(roll=0.0)),
    "RodModel": lambda: (wrod.RodModel, MODEL),
    "RodModel.of": lambda: (wrod.RodModel.of, dict(rod=vps())),
    "RodModel.rolled": lambda: (rod_model().rolled, dict(s=0.1)),
    "RodModel.curvature_held": lambda: (rod_model().curvature_held, dict(roll=0.0)),
    "RodModel.bent": lambda: (rod_model().bent, dict(left=1.0, up=0.0, roll=0.0)),
    "RodModel.stiffened": lambda: (rod_model().stiffened, dict(factor=2.0)),
    "RodModel.piece": lambda: (rod_model().piece, dict(start=0.1, stop=0.2)),
    "RodModel.turned": lambda: (rod_model().turned, dict(roll=0.1)),
    "RodModel.scaled": lambda: (rod_model().scaled, dict(length_unit=0.03, force_unit=0.01)),
    "Profile": lambda: (wrod.Profile, dict(values=(1.0, 2.0), knots=(0.0, 1.0))),
    "Profile.of": lambda: (wrod.Profile.of, dict(value=1.0)),
    "Profile.sampled": lambda: (
        wrod.Profile.sampled,
        dict(function=np.sin, start=0.0, stop=1.0),
    ),
    "Profile.__call__": lambda: (wrod.Profile((1.0, 2.0), (0.0, 1.0)), {"*s": 0.5}),
    "Profile.integral": lambda: (
        wrod.Profile((1.0, 2.0), (0.0, 1.0)).integral,
        dict(start=0.0, stop=0.5),
    ),
    "Profile.mean": lambda: (
        wrod.Profile((1.0, 2.0), (0.0, 1.0)).mean,
        dict(start=0.0, stop=0.5),
    ),
    "Profile.scaled": lambda: (
        wrod.Profile((1.0, 2.0), (0.0, 1.0)).scaled,
        dict(factor=2.0, length_factor=1.0),
    ),
    "Profile.piece": lambda: (
        wrod.Profile((1.0, 2.0), (0.0, 1.0)).piece,
        dict(start=0.0, stop=0.5),
    ),
    "Profile.reversed": lambda: (
        wrod.Profile((1.0, 2.0), (0.0, 1.0)).reversed,
        dict(length=1.0),
    ),
    "Pattern.load": lambda: (
        wrod.Pattern.load,
        dict(
            path=files()["points"], units=None, smoothing=None, name=None, layer=None, stroke=None,
        ),
    ),
    "Pattern.from_points": lambda: (
        wrod.Pattern.from_points,
        dict(
            points=np.column_stack([np.linspace(0, 0.3, 20), np.zeros(20)]), units="m",
            smoothing=None, name="a",
        ),
    ),
    "Pattern.from_expression": lambda: (
        wrod.Pattern.from_expression,
        {"*expression": "0.1*sin(9*x)", "start": 0.0, "stop": 0.3, "units": "m", "name": "a"},
    ),
    "Pattern.sample": lambda: (line().sample, dict(s=0.1)),
    "Pattern.curvature_derivative": lambda: (line().curvature_derivative, dict(s=0.1, order=1)),
    "Pattern.with_remainder": lambda: (line().with_remainder, dict(length=0.1)),
    "Pattern.scaled": lambda: (line().scaled, dict(factor=2.0)),
    "Pattern.save": lambda: (line().save, dict(path="/proc/none/a", spacing=0.01)),
    "Controller.load": lambda: (wrod.Controller.load, dict(path=None, closure="zero_tension")),
    "Controller.predict": lambda: (
        wrod.Controller.load().predict,
        dict(suspended_length=10.0, curvature=0.1, stretch_ratio=2000.0),
    ),
    "solve_grasps": lambda: (
        wrod.solve_grasps,
        dict(
            suspended_length=[10.0], curvature=[0.1], stretch_ratio=2000.0, closure="zero_tension",
            natural_curvature=None, poisson=0.5, device="cpu", sensitivities=False,
            eigenvalues=False, shapes=True, edge_count=128, extrapolate=True, threads=1,
            progress=None,
        ),
    ),
    "solve_rod_grasps": lambda: (
        wrod.solve_rod_grasps,
        dict(
            rod=rod_model(), arc_length=[0.4], curvature=[0.0], closure="zero_tension",
            held_roll=0.0, device="cpu", edge_count=16, extrapolate=True, threads=1,
        ),
    ),
    "plan": lambda: (
        wrod.plan,
        dict(
            pattern=line(), rod=vps(), method="intuitive", closure=None, spacing=0.05,
            remainder=None, roll="plane", controller=None, friction=None, device=None,
            progress=None,
        ),
    ),
    "friction_bound": lambda: (
        wrod.friction_bound,
        dict(pattern=line(), rod=vps(), spacing=0.01),
    ),
    "Trajectory": lambda: (wrod.Trajectory, vars(path()).copy()),
    "Trajectory.save": lambda: (path().save, dict(path="/proc/none/a")),
    "JointPath.save": lambda: (
        wrod.JointPath.load(files()["JointPath"]).save, dict(path="/proc/none/a"),
    ),
    "Deployment.save": lambda: (
        wrod.Deployment.load(files()["Deployment"]).save, dict(path="/proc/none/a"),
    ),
    "Trajectory.load": lambda: (wrod.Trajectory.load, dict(path=files()["trajectory"])),
    "JointPath.load": lambda: (wrod.JointPath.load, dict(path=files()["JointPath"], robot=None)),
    "Deployment.load": lambda: (wrod.Deployment.load, dict(path=files()["Deployment"])),
    "KnotPlan.load_plan": lambda: (wrod.KnotPlan.load_plan, dict(path=files()["knot"])),
    "load_measurements": lambda: (wrod.load_measurements, dict(path=files()["clamped"])),
    "load_motion": lambda: (wrod.load_motion, dict(path=files()["motion"])),
    "load_laid": lambda: (
        wrod.load_laid,
        dict(
            sources=[line().sample(np.linspace(0, 0.2, 30))[0]], pattern=line(), units=None,
            noise=None,
        ),
    ),
    "identify": lambda: (
        wrod.identify,
        dict(
            measurements=files()["clamped"], test=None, candidates=["stiffness"], device="cpu",
            progress=None,
        ),
    ),
    "identify_motion": lambda: (
        wrod.identify_motion,
        dict(
            measurements=files()["motion"], test=None, candidates=None, subdivisions=2,
            device="cpu", evidence=False, progress=None,
        ),
    ),
    "fit_laid": lambda: (
        wrod.fit_laid,
        dict(
            measurements=wrod.load_laid(
                [line().sample(np.linspace(0, 0.5, 60))[0]], line(), noise=1e-3
            ),
            rod=vps(), trajectory=path(), friction=0.6, fit_friction=False, released=True,
            iterations=1, progress=None,
        ),
    ),
    "Disturbance": lambda: (
        wrod.Disturbance,
        dict(
            jitter=0.0, lgb_error=0.0, offset=(0.0, 0.0), yaw=0.0, natural_curvature=0.0, seed=0,
            slip=0.0,
        ),
    ),
    "Disturbance.random": lambda: (wrod.Disturbance.random, dict(seed=0, slip=0.0, only=["yaw"])),
    "Handling.random": lambda: (wrod.Handling.random, dict(seed=0)),
    "Friction": lambda: (
        wrod.Friction,
        dict(static=0.5, kinetic=None, rolling=False, roll=None),
    ),
    "Plane": lambda: (wrod.Plane, dict(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0))),
    "Box": lambda: (
        wrod.Box,
        dict(center=(0.0, 0.0, 0.0), half_size=(1.0, 1.0, 1.0), rotation=(0.0, 0.0, 0.0, 1.0)),
    ),
    "Cylinder": lambda: (
        wrod.Cylinder,
        dict(center=(0.0, 0.0, 0.0), radius=1.0, half_height=1.0, axis=(0.0, 0.0, 1.0)),
    ),
    "Fixtures": lambda: (wrod.Fixtures, dict(items=(), gates=(), name="a", note="")),
    "Fixtures.load": lambda: (wrod.Fixtures.load, dict(path=files()["fixtures"])),
    "Fixtures.along": lambda: (
        wrod.Fixtures.along,
        dict(
            pattern=line(), stations=np.array([0.1, 0.2]), gap=0.01, radius=0.005, height=0.01,
            name=None,
        ),
    ),
    "Fixtures.judge": lambda: (
        wrod.Fixtures.along(line(), np.array([0.1]), gap=0.01).judge,
        dict(centerline=line().sample(np.linspace(0, 0.2, 30))[0], radius=0.002, speed=0.0),
    ),
    "Trial": lambda: (
        wrod.Trial,
        dict(
            pattern=line(), rod=vps(), trajectory=path(), friction=wrod.Friction(0.5),
            disturbance=wrod.Disturbance(), tail=None, fixtures=None,
        ),
    ),
    "Discretisation": lambda: (
        wrod.Discretisation,
        dict(spacing=0.05, step=0.05, scheme="euler", tolerance=1e-4, node_count=None),
    ),
    "simulate_deployment": lambda: (
        wrod.simulate_deployment,
        dict(
            pattern=line(), rod=vps(), trajectory=path(), friction=0.6, disturbance=None,
            fixtures=None, speed=0.2, discretisation=wrod.Discretisation(0.05, 0.05),
        ),
    ),
    "simulate_deployments": lambda: (
        wrod.simulate_deployments,
        dict(
            trials=[wrod.Trial(line(), vps(), path(), wrod.Friction(0.5))], hold=0.05,
            release=None, speed=0.2, discretisation=wrod.Discretisation(0.05, 0.05),
            frame_interval=None, device="cpu", threads=None, progress=None, beyond_grip=False,
        ),
    ),
    "pose_times": lambda: (wrod.pose_times, dict(trajectory=path(), speed=0.2)),
    "RodBatch": lambda: (wrod.RodBatch, batch()),
    "RodBatch.of": lambda: (
        wrod.RodBatch.of,
        dict(
            rods=[rod_model()], arc_length=np.linspace(0, 0.885, 6),
            position=np.stack([np.linspace(0, 0.885, 6), np.zeros(6), np.zeros(6)], 1)[None],
            clamped=(False, False), held=2, director=None, gravity=None, point_load=0.0,
            device="cpu",
        ),
    ),
    "RodBatch.set_configuration": lambda: (
        rods().set_configuration,
        dict(position=batch()["position"], angle=0.0, director=None),
    ),
    "RodBatch.set_softening": lambda: (rods().set_softening, dict(softening=0.0)),
    "RodBatch.set_free": lambda: (rods().set_free, dict(free=np.ones(23, bool))),
    "RodBatch.cut": lambda: (rods().cut, dict(edges=[[2]])),
    "prescribe": lambda: (
        wrod.prescribe,
        dict(batch=rods(), clamped_nodes=[0, 1], pinned_nodes=[5], clamped_angles=[0]),
    ),
    "solve_equilibria": lambda: (
        wrod.solve_equilibria,
        dict(batch=free(rods()), tolerance=1e-8, max_iterations=50),
    ),
    "Contact": lambda: (
        wrod.Contact,
        dict(
            batch=rods(), radius=np.array([0.001]), stiffness=np.array([100.0]),
            friction=wrod.Friction(0.5), shapes=(wrod.Plane(),), restitution=0.0,
            friction_field=None, keeps_roll=False,
        ),
    ),
    "Contact.set_shapes": lambda: (
        wrod.Contact(rods(), np.array([0.001]), np.array([100.0]), wrod.Friction(0.5)).set_shapes,
        dict(shapes=(wrod.Plane(),), friction=wrod.Friction(0.4)),
    ),
    "RodContact": lambda: (
        wrod.RodContact,
        dict(
            batch=rods(), radius=0.001, friction=wrod.Friction(0.5), stiffness=None,
            restitution=0.0, partners=32,
        ),
    ),
    "FrictionField": lambda: (
        wrod.FrictionField, dict(factor=np.ones((3, 4)), x=(0.0, 1.0), y=(0.0, 1.0)),
    ),
    "join_rods": lambda: (wrod.join_rods, dict(batches=[rods(), rods()])),
    "count_unstable_modes": lambda: (
        wrod.count_unstable_modes, dict(batch=free(rods()), neutral=1e-6),
    ),
    "find_critical_load": lambda: (
        wrod.find_critical_load,
        dict(
            equilibria=lambda loads: wrod.RodBatch.of(
                [rod_model()] * len(loads), np.linspace(0, 0.885, 6),
                np.stack([np.linspace(0, 0.885, 6), np.zeros(6), np.zeros(6)], 1)[None],
            ),
            low=0.0, high=1.0, neutral=1e-6, tolerance=1e-3,
        ),
    ),
    "PrescribedMotion": lambda: (
        wrod.PrescribedMotion,
        dict(
            batch=rods(), edge=[0], times=[0.0, 1.0], position=np.zeros((1, 2, 3)),
            rotation=np.zeros((1, 2, 3)), part=0.5, slides="",
        ),
    ),
    "Dynamics": lambda: (
        wrod.Dynamics,
        dict(
            batch=free(rods()), scheme="bdf2", radius=0.001, air_damping=0.0,
            internal_damping=0.0, contact=None, motion=None, force_scale=None, tolerance=1e-6,
            keeps_recording=False,
        ),
    ),
    "Dynamics.of": lambda: (
        wrod.Dynamics.of,
        dict(rods=[rod_model()], batch=free(rods()), clamped=(False, True), air_damping=1.0,
             internal_damping=0.01, scheme="bdf2"),
    ),
    "Dynamics.relax": lambda: (
        wrod.Dynamics(free(rods()), radius=0.001, internal_damping=0.1).relax,
        dict(time=0.1),
    ),
    "Dynamics.set_drag": lambda: (
        wrod.Dynamics(free(rods()), radius=0.001).set_drag,
        dict(drag=np.zeros((1, 6, 2))),
    ),
    "Dynamics.set_velocity": lambda: (
        wrod.Dynamics(free(rods()), radius=0.001).set_velocity,
        dict(velocity=np.zeros((1, 6, 3))),
    ),
    "Dynamics.advance": lambda: (
        wrod.Dynamics(free(rods()), radius=0.001).advance,
        dict(
            until=0.01, step=0.005, smallest_step=None, frames=None, frame_interval=1.0,
            progress=None,
        ),
    ),
    "trace_centerlines": lambda: (
        wrod.trace_centerlines,
        dict(image=picture(), mask=None, kind="auto", color=None),
    ),
    "scan": lambda: (
        wrod.scan,
        dict(
            image=picture(), markers=None, sheet=None, scale=0.001, camera=None, mask=False,
            kind="auto", color=None, start="lower-left", smoothing=None,
        ),
    ),
    "measure_deployment": lambda: (
        wrod.measure_deployment,
        dict(image=picture(), pattern=line(), points=50, picture=None, scale=0.001),
    ),
    "load_robot": lambda: (
        pytest.importorskip("pytorch_kinematics") and wrod.load_robot,
        dict(
            robot="panda", flange=None, tip=None, gripper_length=0.15, acceleration=2.0, jerk=20.0,
        ),
    ),
    "solve_joint_path": lambda: (wrod.solve_joint_path, joint_path()),
    "export_usd": lambda: (
        pytest.importorskip("pxr") and wrod.export_usd,
        dict(path="/proc/none/a.usda", trajectory=path(), joint_path=None, shapes=None,
             pattern=None, rod=None),
    ),
    "tie": lambda: (
        wrod.tie,
        dict(
            knot=knot(), trials=[wrod.Handling()], method="intuitive", friction=0.6,
            rod_friction=0.4, speed=0.03, hand_speed=0.06, step=0.01, film_interval=None,
            device="cpu", progress=None,
        ),
    ),
    "SolverDER": lambda: (
        wrod.SolverDER,
        dict(
            model=model(), scheme="bdf2", max_step=None, tolerance=1e-6, max_iterations=12,
            contact_stiffness=None, self_contact=None,
        ),
    ),
    "SolverDER.add_rod": lambda: (
        wrod.SolverDER.add_rod,
        dict(
            builder=builder(), points=batch()["position"][0], material=vps(), start="free",
            start_body=-1, end="free", end_body=-1, director=None, velocity=0.0,
            natural_curvature=None, natural_twist=None, air_damping=None, internal_damping=None,
            visible=True, color=None, label=None,
        ),
    ),
    "SolverDER.add_newton_rod": lambda: (
        wrod.SolverDER.add_newton_rod,
        dict(builder=builder(), rod=described(), density=1000.0),
    ),
    "SolverDER.add_cable": lambda: (
        wrod.SolverDER.add_cable, dict(builder=builder(), rod=described(), cfg=None),
    ),
    "SolverDER.attach": lambda: (
        wrod.SolverDER.attach, dict(builder=held(), rod=0, body=-1, node=2, kind="clamped"),
    ),
    "SolverDER.add_usd": lambda: (
        pytest.importorskip("pxr") and wrod.SolverDER.add_usd,
        dict(builder=builder(), source=files()["stage"]),
    ),
    "SolverDER.write_usd": lambda: (
        pytest.importorskip("pxr") and wrod.SolverDER.write_usd,
        dict(model=model(), state=model().state(), path="/proc/none/a.usda"),
    ),
    "SolverDER.register_custom_attributes": lambda: (
        wrod.SolverDER.register_custom_attributes, dict(builder=builder()),
    ),
    "SolverDER.step": lambda: (
        (solver := wrod.SolverDER(model())).step,
        dict(state_in=solver.model.state(), state_out=solver.model.state(), control=None,
             contacts=None, dt=1e-3, observables=None, moved=None),
    ),
    "SolverDER.reset": lambda: (
        (solver := wrod.SolverDER(model())).reset,
        dict(state=solver.model.state(), world_mask=None, flags=None),
    ),
    "LayingVectorEnv": lambda: (
        laying().LayingVectorEnv,
        dict(num_envs=1, pattern=line(), rod=vps(), plan=path(), friction=(0.2, 0.6),
             disturbed=True, interval=0.5, reach=0.02, turn=0.2, device="cpu", step=0.01),
    ),
    "LayingVectorEnv.reset": lambda: (environment().reset, dict(seed=1, options=None)),
    "LayingVectorEnv.step": lambda: (environment().step, dict(actions=np.zeros((1, 6)))),
    "solve_grasps_differentiable": lambda: (
        differentiable("autograd").solve_grasps_differentiable,
        dict(suspended_length=torch.tensor([5.0]), curvature=torch.tensor([1.0]),
             stretch_ratio=torch.tensor(2000.0), device="cpu"),
    ),
    "lay_differentiable": lambda: (
        differentiable("autograd").lay_differentiable,
        dict(trials=[wrod.Trial(line(), vps(), path(), wrod.Friction(0.5))], correction=None,
             friction=torch.tensor(0.5), gravito_bending_length=None, natural_curvature=None,
             points=20),
    ),
    "move_differentiable": lambda: (
        differentiable("moving").move_differentiable,
        dict(batch=free(rods()), position=torch.tensor(batch()["position"]),
             velocity=torch.zeros((1, 6, 3), dtype=torch.float64), step=0.005, steps=2,
             radius=0.001, stiffness=None, gravity=None, held=(), path=None, scheme="bdf2",
             air_damping=0.0),
    ),
    "lay_with_feedback": lambda: (
        feedback().lay_with_feedback,
        dict(loop=wrod.FeedbackLoop(line(), vps(), path(), 0.5),
             plant=feedback().Plant(vps(), wrod.Friction(0.4)), sight=None, known=False,
             device="cpu"),
    ),
    "FeedbackLoop": lambda: (
        wrod.FeedbackLoop,
        dict(pattern=line(), rod=vps(), trajectory=path(), friction=0.5, every=0.05, hidden=0.03,
             again=True, horizon=10.0, hold=0.05, patience=8.0),
    ),
    "Sight": lambda: (
        feedback().Sight, dict(noise=5e-4, spacing=0.01, hidden=0.03, hanging=1e-3, seed=0),
    ),
    "measure_overhang": lambda: (
        of_identification("ruler").measure_overhang, dict(overhang=0.07, fall=0.03, reading=1e-3),
    ),
    "measure_hanging_loop": lambda: (
        of_identification("hanging_loop").measure_hanging_loop,
        dict(points=np.column_stack([t := np.linspace(-0.1, 0.1, 40), 20.0 * t**2])),
    ),
    "draw_plan": lambda: (
        importlib.import_module("wrod.planning.picture").draw_plan,
        dict(path="/proc/none/a.png", pattern=line(), trajectory=path()),
    ),
    "Pattern": lambda: (
        wrod.Pattern, dict(heading=line()._heading, origin=np.zeros(2), height=0.0, points=None),
    ),
    "Controller": lambda: (
        wrod.Controller,
        dict(parameters=shipped()._parameters, metadata=shipped().metadata, source="a"),
    ),
    **{f"{name}, made": lambda name=name: parts(made()[name]) for name in (
        "Trajectory", "Deployment", "JointPath", "Grasps", "RodGrasps", "KnotPlan", "Handling",
        "Fixture", "Grip", "Placement", "Plant", "Disturbance",
    )},
    "with_remainder_of": lambda: (
        importlib.import_module("wrod.deployment.simulate").with_remainder_of,
        dict(pattern=line(), trajectory=path()),
    ),
}  # fmt: skip


@cache
def shipped():
    return wrod.Controller.load()


@cache
def made() -> dict:
    """Objects that are mostly made by others."""
    joints = wrod.JointPath.load(files()["JointPath"])
    found = [
        path(), wrod.Deployment.load(files()["Deployment"]), joints, joints.grip,
        joints.placement, wrod.solve_grasps([5.0], [0.1], 2e3, device="cpu"),
        wrod.solve_rod_grasps(rod_model(), [0.4], [0.0], edge_count=16, device="cpu"), knot(),
        wrod.Handling.random(1), wrod.Fixtures.along(line(), np.array([0.1]), gap=0.01).items[0],
        feedback().Plant(vps(), wrod.Friction(0.4)), wrod.Disturbance(),
    ]  # fmt: skip
    return {type(one).__name__: one for one in found}


def parts(one):
    return type(one), {f.name: getattr(one, f.name) for f in fields(one) if f.init}


def held():
    made = builder()
    wrod.SolverDER.add_rod(made, batch()["position"][0], vps())
    return made


def laying():
    pytest.importorskip("gymnasium")
    return importlib.import_module("wrod.deployment.environment")


def environment():
    made = laying().LayingVectorEnv(1, line(), vps(), path())
    made.reset(seed=0)
    return made


def differentiable(name):
    pytest.importorskip("torch")
    return importlib.import_module(f"wrod.training.{name}")


def feedback():
    return importlib.import_module("wrod.deployment.feedback")


def of_identification(name):
    return importlib.import_module(f"wrod.identification.{name}")


def described():
    import newton

    points = batch()["position"][0]
    return newton.Rod(points, radius=0.002, youngs_modulus=1e6, poissons_ratio=0.3)


def test_every_public_callable_is_here():
    """What has no own arguments, or is made by others' results only, is named."""
    made_by_others = {"IdentificationReport", "rod_names", "pattern_names"}
    here = {name.partition(",")[0].partition(".")[0] for name in CALLS}
    assert set(wrod.__all__) - {"__version__"} <= here | made_by_others


@pytest.mark.parametrize(
    "metadata", [{"remainder_length": "x"}, {"spin": np.nan}, {"a": own}, {"a": Hostile()}, 3]
)
def test_metadata_that_is_none_of_a_trajectory_is_refused(metadata, tmp_path):
    with pytest.raises(WrodError, match="metadata"):
        wrod.Trajectory(**{**vars(path()), "metadata": metadata}).save(tmp_path / "a")
    assert not list(tmp_path.iterdir())


def test_what_holds_arrays_is_compared_and_kept_in_sets():
    laid = wrod.load_laid([line().sample(np.linspace(0, 0.5, 60))[0]], line(), noise=1e-3)
    made = [
        path(), wrod.Deployment.load(files()["Deployment"]), laid, rod_model(), vps(), line(),
        wrod.JointPath.load(files()["JointPath"]), wrod.solve_grasps([5.0], [0.1], 2e3),
        wrod.Trial(line(), vps(), path(), wrod.Friction(0.5)),
    ]  # fmt: skip
    assert len({*made, *made}) == len(made)
    for one in made:
        assert one == one and one != 1 and isinstance(one == copy.deepcopy(one), bool)


def test_what_lies_on_a_device_is_neither_pickled_nor_copied():
    made = rods()
    for one in (made, wrod.Dynamics(free(made), radius=0.001)):
        for how in (pickle.dumps, copy.copy, copy.deepcopy):
            with pytest.raises(WrodError, match=f"a {type(one).__name__} holds arrays on a device"):
                how(one)


def test_a_device_is_a_name_or_such_an_object_of_warp_or_torch():
    import warp as wp

    from wrod.solvers.solids import Mesh

    torch = pytest.importorskip("torch")
    arc = np.linspace(0.0, 0.2, 4)
    straight = np.stack([arc, 0 * arc, 0 * arc], axis=1)[None]

    def ways(device):
        yield wrod.RodBatch.of(vps(), arc, straight, device=device).device
        yield Mesh(np.eye(3), [[0, 1, 2]], device=device).device
        wrod.solve_grasps([5.0], [0.1], 2e3, device=device)
        wrod.plan(line(), vps(), "numeric", spacing=0.2, device=device)

    for device in ("cpu", wp.get_device("cpu"), torch.device("cpu"), torch.device("cpu", 0)):
        assert list(ways(device)) == ["cpu"] * 2
    for device in ("gpu", torch.device("meta"), torch.device("cuda", 99), 0, torch.float64):
        with pytest.raises(WrodError, match="device"):
            wrod.RodBatch.of(vps(), arc, straight, device=device)
        with pytest.raises(WrodError, match="device"):
            wrod.solve_grasps([5.0], [0.1], 2e3, device=device)
        with pytest.raises(WrodError, match="device"):
            wrod.plan(line(), vps(), device=device)  # by a controller, which needs none


@pytest.mark.parametrize("name", ["Trajectory", "Deployment", "JointPath"])
def test_what_no_file_is_called_is_refused_by_the_name_of_the_call(name):
    one = made()[name]
    for wrong in (3, None, b"a.npz", ["a"], "a\0b"):
        for call in (one.save, type(one).load):
            with pytest.raises(WrodError, match=rf"^{name}\.(save|load): path is"):
                call(wrong)


def test_a_pattern_is_not_saved_as_what_it_could_not_be_read_from(tmp_path):
    for suffix in ("npz", "NPY", "svg", "dxf"):
        with pytest.raises(WrodError, match=r"give it the suffix \.csv"):
            line().save(tmp_path / f"line.{suffix}")
    assert not list(tmp_path.iterdir())


def test_a_tilde_is_the_home_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    path().save("~/made/path.npz")
    assert len(wrod.Trajectory.load("~/made/path.npz")) == len(path())
    assert [one.name for one in tmp_path.iterdir()] == ["home"]


@pytest.mark.parametrize("name", ["Trajectory", "Deployment", "JointPath"])
def test_nobody_changes_what_was_checked(name):
    kind, own = parts(made()[name])
    given = {key: np.array(v) if isinstance(v, np.ndarray) else v for key, v in own.items()}
    one = kind(**given)
    arrays = [key for key, value in given.items() if isinstance(value, np.ndarray)]
    assert len(arrays) > 3
    for key in arrays:
        given[key][...] = 7.0
        np.testing.assert_array_equal(getattr(one, key), own[key])
        with pytest.raises(ValueError, match="read-only"):
            getattr(one, key)[...] = 7.0


def test_patterns_and_controllers_keep_what_they_were_made_of():
    heading, origin = line()._heading, np.zeros(2)
    pattern = wrod.Pattern(heading.__class__(heading.c.copy(), heading.x.copy()), origin)
    before = pattern.sample(0.3)[0]
    origin += 1.0
    weights = {name: value.copy() for name, value in shipped()._parameters.items()}
    label = copy.deepcopy(shipped().metadata)
    controller = wrod.Controller(weights, label)
    said = controller.predict(10.0, 0.1, 2000.0)
    for value in weights.values():
        value[...] = 0.0
    label["range"]["curvature"][0] = 99.0
    assert np.array_equal(pattern.sample(0.3)[0], before)
    np.testing.assert_array_equal(controller.predict(10.0, 0.1, 2000.0), said)
    assert controller.metadata["range"] == shipped().metadata["range"]


@pytest.mark.parametrize("name", CALLS)
def test_only_typed_errors(name, tmp_path, monkeypatch, tried):
    monkeypatch.chdir(tmp_path)
    function, valid = CALLS[name]()
    valid = _defaults(function) | valid
    bad, count, refused = [], 0, 0
    draw, late = random.Random(name if FUZZ == 1 else None), time.monotonic() + LONGEST
    share = SHARE if FUZZ == 1 else len(WRONG | others())
    wrong = list((WRONG | others()).items())
    calls = [(one, k, {one: v}) for one in valid for k, v in draw.sample(wrong, share)]
    pairs = list(itertools.combinations(valid, 2))
    swapped = pairs if FUZZ > 1 else draw.sample(pairs, min(len(pairs), SHARE))
    calls += [(a, f"and {b} swapped", {a: valid[b], b: valid[a]}) for a, b in swapped]
    for _ in range((2 if FUZZ == 1 else share) * (len(valid) > 1)):  # two or more wrong at once
        some = draw.sample(list(valid), draw.choice([2, min(3, len(valid)), len(valid)]))
        change = {one: draw.choice(wrong) for one in some}
        kinds = " and ".join(kind for kind, _ in change.values())
        calls.append((" and ".join(some), kinds, {one: v for one, (_, v) in change.items()}))
    draw.shuffle(calls)
    for parameter, kind, change in calls:
        if time.monotonic() > late:
            break
        changed = {**valid, **change}
        places = [changed.pop(key) for key in list(changed) if key.startswith("*")]
        count += 1
        end, said, seconds = _called(function, places, changed)
        if seconds > 5.0:  # the first call of a machine also compiles kernels
            end, said, seconds = _called(function, places, changed)
        refused += end
        if said:
            bad.append(f"{parameter} {kind}: {said}")
        if end and seconds > 5.0:  # what is taken may take its time
            bad.append(f"{parameter} {kind}: {seconds:.0f} s")
    tried["wrong arguments"] = (count, refused)
    assert not bad, "\n".join(bad)


@cache
def others() -> dict:
    """What is meant for another argument."""
    return {
        "a rod": vps(), "a model": rod_model(), "a pattern": line(), "a trajectory": path(),
        "a friction": wrod.Friction(0.5), "a batch": rods(), "a file": files()["trajectory"],
    }  # fmt: skip


def _defaults(function) -> dict:
    """Arguments that nobody has to give."""
    try:
        parameters = inspect.signature(function).parameters
    except ValueError:  # NumPy's own
        return {}
    return {name: one.default for name, one in parameters.items() if one.default is not one.empty}


def _called(function, places: list, changed: dict) -> tuple[bool, str, float]:
    """Whether a call was refused, what is wrong with its end ("" is nothing), its CPU time [s]."""
    began, said, refused = time.process_time(), "", False
    try:
        with warnings.catch_warnings(), at_most(TAKEN):
            warnings.simplefilter("ignore")
            function(*places, **changed)
    except WrodError as error:
        refused, said = True, "" if str(error) else "says nothing"
    except _Enough:
        pass  # it works: the argument was taken
    except OSError as error:  # of what is written: it names the file
        said = "" if error.filename else repr(error)
    except BaseException as error:
        said = f"{type(error).__name__}: {str(error).partition(chr(10))[0][:100]}"
    return refused, said, time.process_time() - began
