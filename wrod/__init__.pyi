"""Public names, for editors, type checkers and the lazy imports of `wrod`."""

from .controller.controller import Controller as Controller
from .deployment.fixtures import Fixtures as Fixtures
from .deployment.result import Deployment as Deployment
from .deployment.setup import Disturbance as Disturbance
from .deployment.simulate import Trial as Trial
from .deployment.simulate import simulate_deployment as simulate_deployment
from .deployment.simulate import simulate_deployments as simulate_deployments
from .grasps.optimal import Grasps as Grasps
from .grasps.optimal import solve_grasps as solve_grasps
from .grasps.rod_grasps import RodGrasps as RodGrasps
from .grasps.rod_grasps import solve_rod_grasps as solve_rod_grasps
from .identification import IdentificationReport as IdentificationReport
from .identification import identify as identify
from .identification import identify_motion as identify_motion
from .identification import load_measurements as load_measurements
from .identification import load_motion as load_motion
from .identification.laid.fit import fit_laid as fit_laid
from .identification.laid.measurements import load_laid as load_laid
from .knots.plan import KnotPlan as KnotPlan
from .knots.trials import Handling as Handling
from .knots.tying import tie as tie
from .newton_solver import SolverDER as SolverDER
from .patterns.pattern import Pattern as Pattern
from .patterns.pattern import pattern as pattern
from .patterns.pattern import pattern_names as pattern_names
from .perception.measure import measure_deployment as measure_deployment
from .perception.scan import scan as scan
from .perception.trace import trace_centerlines as trace_centerlines
from .planning.friction import friction_bound as friction_bound
from .planning.plan import plan as plan
from .planning.trajectory import Trajectory as Trajectory
from .robot.joint_path import JointPath as JointPath
from .robot.joint_path import solve_joint_path as solve_joint_path
from .rods.batch import RodBatch as RodBatch
from .rods.material import RodMaterial as RodMaterial
from .rods.material import rod as rod
from .rods.material import rod_names as rod_names
from .rods.model import RodModel as RodModel
from .rods.profile import Profile as Profile
from .rods.rows import join_rods as join_rods
from .scene.export import export_usd as export_usd
from .solvers.contact import Box as Box
from .solvers.contact import Contact as Contact
from .solvers.contact import Cylinder as Cylinder
from .solvers.contact import Friction as Friction
from .solvers.contact import Plane as Plane
from .solvers.dynamics import Dynamics as Dynamics
from .solvers.prescribed import PrescribedMotion as PrescribedMotion
from .solvers.rod_contact import RodContact as RodContact
from .solvers.statics import prescribe as prescribe
from .solvers.statics import solve_equilibria as solve_equilibria

__version__: str
__all__: list[str]
