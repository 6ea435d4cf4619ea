"""Exact derivatives of what sensors see of clamped rods, by implicit differentiation.

At equilibrium the gradient of the energy vanishes, so a change of the model moves the rods by
-H^-1 (rate of the gradient), H the Hessian that Newton's iteration already has.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields

import numpy as np
import warp as wp

from wrod.identification.clamped.layout import (
    COMPLEX_STEP,
    batch_arrays,
    coupling_of,
    dead_force,
    end_poses,
    inelastic_of,
    law_layers,
    wind_rates,
)
from wrod.identification.clamped.sensing import END, Prediction, View
from wrod.identification.clamped.setup import ClampedSetup
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.elastic.bend_twist import bend_twist_energy
from wrod.kernels.elastic.inelastic import inelastic_energy
from wrod.kernels.stepping.motion_tangents import elastic_tangents
from wrod.rods.arrays import never_bent, with_arrays
from wrod.rods.batch import RodBatch
from wrod.rods.state import node_positions
from wrod.solvers.banded import BandedSystem, multiply_banded
from wrod.solvers.steps import unit_pace

# A strong wind settles slowly.
WIND_PASSES = 200
WIND_TOLERANCE = 1e-7
# What the energy of a law that yields depends on, as the batch and as its elastic model call it.
_SEEN_BY_YIELD = {
    "rest_length": "rest_length",
    "bending_stiffness": "bending",
    "natural_curvature": "natural_curvature",
}
# What `batch_arrays` makes of a setup, and of which of its parts: of all but some.
_LAID_OUT = (
    "rest_length", "stretching_stiffness", "bending_stiffness", "twisting_stiffness",
    "natural_curvature", "natural_twist", "softening", "node_mass", "gravity",
)  # fmt: skip
_BESIDE = {"yielding", "coupling", "wind", "force", "marker_arc_length"} | {
    f"{end}_{part}" for end in ("clamp", "grip") for part in ("position", "rotation")
}
_OF_THE_ROD = tuple(f.name for f in fields(ClampedSetup) if f.name not in _BESIDE)
# Share of these, and of the law's numbers, over which it is differenced.
_DIFFERENCE = 1e-5


class Sensitivity:
    """Derivatives of predictions about the state that a batch is in.

    Args:
        batch: rods in equilibrium, candidate x trial.
        trial_count: trials of one candidate.
        edge_count: edges between the clamps.
    """

    def __init__(self, batch: RodBatch, trial_count: int, edge_count: int):
        self.batch, self.trial_count, self.edge_count = batch, trial_count, edge_count
        self.device = batch.device
        self.system: BandedSystem | None = None

    def predict_rates(
        self,
        rates: Sequence[Sequence[ClampedSetup]],
        wanted: Sequence[Sequence[bool]] | None = None,
    ) -> list[Prediction]:
        """The present prediction with a derivative as imaginary part, for each list of setups.

        Args:
            rates: setups whose imaginary parts are `COMPLEX_STEP` times a parameter's rate; one
                list, a setup for each candidate, for every parameter.
            wanted: whether each candidate has that parameter; the predictions of others are left
                out.
        """
        batch, count = self.batch, len(rates)
        if self.system is None or self.system.x.shape[1] != count:
            self.system = BandedSystem(batch, right_hand_sides=count)
        system = self.system
        batch.evaluate(order=2)
        system.factorise(batch.derivatives.hessian, batch.every_rod)
        gradient_rate = self._gradient_rates(rates)
        step = np.zeros_like(gradient_rate)
        wind_rate = []
        for j, setups in enumerate(rates):
            step[:, j] = self._prescribed_rate(setups)
            wind = np.repeat([s.wind for s in setups], self.trial_count, axis=0)
            wind_rate.append(np.imag(wind) / COMPLEX_STEP)
        wind = np.repeat(np.real([s.wind for s in rates[0]]), self.trial_count, axis=0)
        product = self._times_hessian(step) if step.any() else step
        free_step = np.zeros_like(step)
        load_rate = np.zeros_like(step)
        windy = bool(np.any(wind) or np.any(wind_rate))
        if windy:
            by_edge, by_wind = wind_rates(batch.positions(), wind)
            by_wind = np.einsum("reij,crj->rcei", by_wind, wind_rate)
        for _ in range(WIND_PASSES if windy else 1):
            if windy:
                load_rate = _wind_rate(by_edge, by_wind, step + free_step)
            system.x.assign(load_rate - gradient_rate - product)
            system.solve(batch.every_rod)
            change = np.abs(system.x.numpy() - free_step).max(initial=0.0)
            free_step = system.x.numpy().copy()
            if change <= WIND_TOLERANCE * np.abs(free_step).max(initial=1e-300):
                break
        step += free_step
        # Of the reactions only those at the gripper are seen.
        last = step.shape[2] - END - HALF_BANDWIDTH
        reaction_rate = self._times_hessian(step[:, :, last:], last)[:, :, -END:]
        reaction_rate += (gradient_rate - load_rate)[:, :, -END:]
        view = View(batch)
        wanted = [None] * count if wanted is None else wanted
        return [
            view.observe(setups, step[:, j], reaction_rate[:, j], wanted[j])
            for j, setups in enumerate(rates)
        ]

    def _times_hessian(self, vectors: np.ndarray, first: int = 0) -> np.ndarray:
        """Products of the Hessian of the degrees of freedom from `first` on."""
        batch = self.batch
        product = wp.zeros(vectors.shape, dtype=wp.float64, device=self.device)
        hessian = batch.derivatives.hessian[:, first:]
        given = wp.array(vectors, dtype=wp.float64, device=self.device)
        multiply_banded(batch, batch.every_rod, hessian, given, product)
        return product.numpy()

    def _gradient_rates(self, rates: Sequence[Sequence[ClampedSetup]]) -> np.ndarray:
        """(rod, column, dof) derivatives of the energy's gradient along the setups' imaginary
        parts."""
        batch = self.batch
        rods, count, nodes = batch.rod_count, len(rates), batch.node_count
        model = {name: getattr(batch, name).numpy() for name in _LAID_OUT}
        moved = {name: np.zeros((rods, count, *v.shape[1:])) for name, v in model.items()}
        force = np.zeros((rods, count, nodes, 4))
        for column, setups in enumerate(rates):
            for own, setup in self._rows(setups):
                if _moves(setup, _OF_THE_ROD):
                    arrays = batch_arrays([setup])
                    for name, value in arrays.items():
                        moved[name][own, column] = _rate_of(value)
                    load = arrays["node_mass"][:, :, None] * arrays["gravity"][:, None]
                    force[own, column, :, :3] = _rate_of(load)
                if _moves(setup, ("force",)):
                    force[own, column, :, :3] += _rate_of(dead_force([setup]))
        out = -force.reshape(rods, count, -1)[:, :, :-1]
        out += self._elastic_rates(model, moved)
        # The other terms of a law of bending neither stretch nor twist.
        none = ("stretching_stiffness", "twisting_stiffness")
        laws = [law_layers(setups) for setups in rates]
        for k, layer in enumerate(batch.layers):
            names = ("bending_stiffness", "softening")
            arrays = (layer.bending.numpy(), layer.softening.numpy())
            here = dict(zip(names, arrays, strict=True))
            parts = zip(*(law[k] for law in laws), strict=True)
            own = {
                n: _rate_of(np.stack(part, axis=1)) for n, part in zip(names, parts, strict=True)
            }
            here |= {name: np.zeros_like(model[name]) for name in none}
            own |= {name: np.zeros_like(moved[name]) for name in none}
            out += self._elastic_rates(model | here, moved | own)
        coupling = np.zeros((rods, count, nodes, 2))
        # A law whose share begins at nothing is there in its own column only.
        yielding = np.real(inelastic_of(rates[0]))
        rate = np.zeros((rods, count, nodes, 4))
        for column, setups in enumerate(rates):
            for own, setup in self._rows(setups):
                if _moves(setup, ("coupling", "principal_angle")):
                    coupling[own, column] = _rate_of(coupling_of([setup]))
                if _moves(setup, ("yielding",)):
                    law = inelastic_of([setup])
                    yielding[own] = np.maximum(yielding[own], np.real(law))
                    rate[own, column] = _rate_of(law)
            known = {name: value[:, column] for name, value in moved.items()}
            self._add_coupling_rate(coupling[:, column], known, out[:, column])
        there = yielding[..., 0].any(axis=1)
        for column in range(len(rates)) if there.any() else ():
            own = {name: moved[name][:, column] for name in _SEEN_BY_YIELD}
            if any(r[there].any() for r in (rate[:, column], *own.values())):
                self._add_yielding_rate(there, yielding, rate[:, column], own, out[:, column])
        return out

    def _rows(self, setups: Sequence[ClampedSetup]) -> Iterator[tuple[slice, ClampedSetup]]:
        """The rods of every candidate, and its setup."""
        for c, setup in enumerate(setups):
            yield slice(c * self.trial_count, (c + 1) * self.trial_count), setup

    def _elastic_rates(self, model: dict, moved: dict) -> np.ndarray:
        """(rod, column, dof) derivatives of the elastic energy's gradient along rates of a model's
        arrays, (rod, column, ...)."""
        batch, device, state = self.batch, self.device, self.batch.state
        rods, nodes, count = batch.rod_count, batch.node_count, moved["rest_length"].shape[1]
        if not any(v.any() for n, v in moved.items() if n not in ("node_mass", "gravity")):
            return np.zeros((rods, count, batch.dof_count))

        def zeros(dtype, *shape):
            return wp.zeros(shape, dtype=dtype, device=device)

        def arrays(of: dict, axes: int) -> list[wp.array]:
            """As the kernel takes them; `axes` before those of edges or nodes become one."""
            bent = of["bending_stiffness"], of["natural_curvature"]
            twisted = of["twisting_stiffness"], of["natural_twist"]
            stiffness, strain = (
                np.concatenate([two, one[..., None]], axis=-1)
                for two, one in zip(bent, twisted, strict=True)
            )
            given = of["rest_length"], of["stretching_stiffness"], stiffness, strain
            kinds = wp.float64, wp.float64, wp.vec3d, wp.vec3d, wp.vec4d, wp.vec2d
            none = np.zeros((*strain.shape[:-1], 4))
            return [
                wp.array(value.reshape(-1, *value.shape[axes:]), dtype=kind, device=device)
                for value, kind in zip((*given, none, of["softening"]), kinds, strict=True)
            ]

        # A processor's core takes all columns of a node, a GPU's threads one each.
        each = count if wp.get_device(device).is_cpu else 1
        # Nothing flows, so that the strains before do not count.
        past, flow = zeros(wp.vec4d, rods, nodes), zeros(wp.vec4d, rods, count, nodes)
        out = zeros(wp.float64, rods * count, batch.dof_count)
        batch.launch(
            elastic_tangents,
            (rods, nodes - 1, count // each),
            [*arrays(model, 1), *arrays(moved, 2), unit_pace(batch, 0.0, 0.0, 0.0)]
            + [state.dof, state.director, state.reference_twist, past, past, flow, flow, each],
            [out],
        )
        return -out.numpy().reshape(rods, count, -1)

    def _add_coupling_rate(self, coupling_rate, rate: dict, out: np.ndarray) -> None:
        """What the coupling of bending with twist adds to a column of `_gradient_rates`.

        It is linear in the coupling and quadratic along the rates of both natural strains, so that
        central differences are exact there; along that of the rest length they are good to 1e-8.
        """
        batch, device = self.batch, self.device
        model = batch.elastic_model

        def add(there, number, factor, **moved):
            out[:] += factor * self._gradient_of(bend_twist_energy, there, number, **moved)

        def shifted(name, change):
            known = getattr(model, name)
            return wp.array(known.numpy() + change, dtype=known.dtype, device=device)

        if (there := coupling_rate.any(axis=(1, 2))).any():
            add(there, wp.array(coupling_rate, dtype=wp.vec2d, device=device), 1.0)
        length = ("rest_length",)
        for kernel, coupling in batch.energies:
            if kernel is not bend_twist_energy:
                continue
            there = coupling.numpy().any(axis=(1, 2))
            for moving, least in ((("natural_curvature", "natural_twist"), 1.0), (length, 1e-4)):
                rates = {n: (rate[n].T * there).T for n in moving}
                largest = max(np.abs(r).max() for r in rates.values())
                if largest == 0.0:
                    continue
                h = least / largest
                if moving == length:
                    h *= float(batch.rest_length.numpy().max())
                for sign in (1.0, -1.0):
                    moved = {n: shifted(n, sign * h * r) for n, r in rates.items()}
                    add(there, coupling, 0.5 * sign / h, **moved)

    def _add_yielding_rate(self, there, number, number_rate, rate: dict, out: np.ndarray) -> None:
        """What a law that yields adds to a column of `_gradient_rates`, by central differences at
        the present strains: moments have kinks there, but between them they are smooth.

        Args:
            there: (rod,) whether a rod has one.
            number: (rod, node, 4) of the law, and `number_rate`.
            rate: of what `_SEEN_BY_YIELD`.
        """
        batch = self.batch
        known = {name: getattr(batch, name).numpy() for name in rate}
        size = {name: np.abs(value).max() for name, value in known.items()}
        size["natural_curvature"] = number[..., 2].min()
        relative = [np.abs(r).reshape(len(r), -1).max(axis=1) / size[n] for n, r in rate.items()]
        own = np.abs(number_rate) / np.maximum(number, 1e-300)
        # The share enters in proportion: its difference may be of any size.
        relative += [np.abs(number_rate[..., 1]).max(axis=1), own[..., 2].max(axis=1)]
        largest = np.max(relative, axis=0)
        step = _DIFFERENCE / np.where(largest > 0.0, largest, 1.0)

        def shifted(value, by, sign):
            return value + sign * step.reshape(-1, *[1] * (by.ndim - 1)) * by

        for sign in (1.0, -1.0):
            moved = {}
            for name, r in rate.items():
                array = getattr(batch, name)
                here = shifted(known[name], r, sign)
                moved[_SEEN_BY_YIELD[name]] = wp.array(here, dtype=array.dtype, device=self.device)
            law = never_bent(batch, shifted(number, number_rate, sign))
            gradient = self._gradient_of(inelastic_energy, there, law, **moved)
            out += 0.5 * sign / step[:, None] * gradient

    def _gradient_of(self, kernel, there: np.ndarray, number: wp.array, **moved) -> np.ndarray:
        """(rod, dof) gradient of an energy of the section of those rods that are `there`, with some
        of the model's arrays in other values."""
        batch, state = self.batch, self.batch.state
        part = wp.zeros_like(batch.derivatives.gradient)
        batch.launch(
            kernel,
            (batch.rod_count, batch.node_count - 2),
            [with_arrays(batch.elastic_model, **moved), number, batch.array(there, wp.int32)]
            + [state.dof, state.director, state.reference_twist, 1],
            [wp.zeros_like(batch.derivatives.energy), part, batch.derivatives.hessian],
        )
        return part.numpy()

    def _prescribed_rate(self, setups: Sequence[ClampedSetup]) -> np.ndarray:
        """(rod, dof) rates of the clamps' degrees of freedom."""
        step = np.zeros((self.batch.rod_count, self.batch.dof_count))
        (a, ra), (b, rb) = end_poses(setups, keep=np.imag)
        ta, tb = (r[:, :, 2] for r in (ra, rb))
        (_, ra0), (_, rb0) = end_poses(setups)
        h = self.batch.rest_length.numpy()[:, :1]
        h_rate = np.repeat([np.imag(s.length) for s in setups], self.trial_count) / self.edge_count
        h_rate = h_rate[:, None]
        step[:, 0:3], step[:, 4:7] = a - h * ta - h_rate * ra0[:, :, 2], a
        step[:, -7:-4], step[:, -3:] = b, b + h * tb + h_rate * rb0[:, :, 2]
        principal = np.repeat(np.imag([s.principal_angle for s in setups]), self.trial_count)
        # Time-parallel reference directors do not spin: what is left is the spin of the frame.
        step[:, 3] = np.sum(ra[:, :, 0] * ra0[:, :, 1], axis=1) + principal
        step[:, -4] = np.sum(rb[:, :, 0] * rb0[:, :, 1], axis=1) + principal
        return step / COMPLEX_STEP


def _wind_rate(by_edge: np.ndarray, by_wind: np.ndarray, step: np.ndarray) -> np.ndarray:
    """(rod, column, dof) rates of a wind's load as the rods move by a step and it changes.

    Args:
        by_edge: of `wind_rates`; by_wind: (rod, column, edge, 3) what comes of the wind's change.
        step: (rod, column, dof).
    """
    rods, columns = step.shape[:2]
    moved = node_positions(step.reshape(rods * columns, -1)).reshape(rods, columns, -1, 3)
    half = np.einsum("reij,rcej->rcei", by_edge, np.diff(moved[:, :, 1:-1], axis=2)) + by_wind
    rate = np.zeros((rods, columns, moved.shape[2], 4))
    rate[:, :, 1:-2, :3] += half
    rate[:, :, 2:-1, :3] += half
    return rate.reshape(rods, columns, -1)[:, :, :-1]


def _moves(setup: ClampedSetup, names: Iterable[str]) -> bool:
    """Whether a setup's parameter moves any of these parts of it."""
    parts = (getattr(setup, name) for name in names)
    return any(np.iscomplexobj(part) and np.any(np.imag(part)) for part in parts)


def _rate_of(value: np.ndarray) -> np.ndarray:
    return np.imag(value) / COMPLEX_STEP
