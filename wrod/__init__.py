"""wrod plans and proves how a robot lays a rod along a pattern.

Public names are imported when first used, so that `import wrod` stays light.
"""

import importlib

# The only place of it: the package, datasets and benchmarks read it here.
__version__ = "0.1.0"

_PUBLIC = {
    "RodMaterial": "wrod.rods.material",
    "rod": "wrod.rods.material",
    "rod_names": "wrod.rods.material",
    "RodModel": "wrod.rods.model",
    "Profile": "wrod.rods.profile",
    "RodBatch": "wrod.rods.batch",
    "solve_equilibria": "wrod.solvers.statics",
    "Dynamics": "wrod.solvers.dynamics",
    "Contact": "wrod.solvers.contact",
    "Fixtures": "wrod.deployment.fixtures",
    "tie": "wrod.knots.tying",
    "Pattern": "wrod.patterns.pattern",
    "pattern": "wrod.patterns.pattern",
    "pattern_names": "wrod.patterns.pattern",
    "friction_bound": "wrod.planning.friction",
    "Trajectory": "wrod.planning.trajectory",
    "Grasps": "wrod.grasps.optimal",
    "solve_grasps": "wrod.grasps.optimal",
    "plan": "wrod.planning.plan",
    "simulate_deployment": "wrod.deployment.simulate",
    "simulate_deployments": "wrod.deployment.simulate",
    "Deployment": "wrod.deployment.result",
    "Trial": "wrod.deployment.simulate",
    "Disturbance": "wrod.deployment.setup",
    "Friction": "wrod.solvers.contact",
    "Controller": "wrod.controller.controller",
    "JointPath": "wrod.robot.joint_path",
    "solve_joint_path": "wrod.robot.joint_path",
    "export_usd": "wrod.scene.export",
    "scan": "wrod.perception.scan",
    "trace_centerlines": "wrod.perception.trace",
    "measure_deployment": "wrod.perception.measure",
    "SolverDER": "wrod.newton_solver",
    "identify": "wrod.identification",
    "load_measurements": "wrod.identification",
    "IdentificationReport": "wrod.identification",
}

__all__ = sorted(_PUBLIC)


def __getattr__(name: str):
    if name not in _PUBLIC:
        raise AttributeError(f"module 'wrod' has no attribute {name!r}")
    value = getattr(importlib.import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_PUBLIC])
