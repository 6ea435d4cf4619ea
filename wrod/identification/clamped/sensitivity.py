"""Exact derivatives of what sensors see of clamped rods, by implicit differentiation.

At equilibrium the gradient of the energy vanishes, so a change of the model moves the rods by
-H^-1 (rate of the gradient), H the Hessian that Newton's iteration already has.
"""

from collections.abc import Sequence

import numpy as np
import warp as wp

from wrod.identification.clamped.layout import (
    COMPLEX_STEP,
    batch_arrays,
    coupling_of,
    dead_force,
    end_poses,
    full_shape,
    law_layers,
    node_part,
    wind_load,
)
from wrod.identification.clamped.sensing import Prediction, View
from wrod.identification.clamped.setup import ClampedSetup
from wrod.kernels.elastic.bend_twist import bend_twist_energy
from wrod.kernels.elastic.loads import dead_loads
from wrod.kernels.elastic.softened_bending import softened_bending_rate
from wrod.kernels.elastic.stretching import stretching_rate
from wrod.kernels.elastic.twisting import twisting_rate
from wrod.kernels.linear import banded
from wrod.rods.batch import RodBatch
from wrod.solvers.banded import BandedSystem

WIND_PASSES = 12
WIND_TOLERANCE = 1e-7


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
        gradient_rate = np.empty((batch.rod_count, count, batch.dof_count))
        step = np.zeros_like(gradient_rate)
        wind_rate = []
        for j, setups in enumerate(rates):
            gradient_rate[:, j] = self._gradient_rate(setups)
            step[:, j] = self._prescribed_rate(setups)
            wind = np.repeat([s.wind for s in setups], self.trial_count, axis=0)
            wind_rate.append(np.imag(wind) / COMPLEX_STEP)
        wind = np.repeat(np.real([s.wind for s in rates[0]]), self.trial_count, axis=0)
        product = self._times_hessian(step)
        free_step = np.zeros_like(step)
        load_rate = np.zeros_like(step)
        windy = bool(np.any(wind) or np.any(wind_rate))
        for _ in range(WIND_PASSES if windy else 1):
            if windy:
                for j in range(count):
                    load_rate[:, j] = self._wind_rate(
                        wind, wind_rate[j], step[:, j] + free_step[:, j]
                    )
            system.x.assign(load_rate - gradient_rate - product)
            system.solve(batch.every_rod)
            change = np.abs(system.x.numpy() - free_step).max(initial=0.0)
            free_step = system.x.numpy().copy()
            if change <= WIND_TOLERANCE * np.abs(free_step).max(initial=1e-300):
                break
        step += free_step
        reaction_rate = self._times_hessian(step) + gradient_rate - load_rate
        view = View(batch)
        wanted = [None] * count if wanted is None else wanted
        return [
            view.observe(setups, step[:, j], reaction_rate[:, j], wanted[j])
            for j, setups in enumerate(rates)
        ]

    def _times_hessian(self, vectors: np.ndarray) -> np.ndarray:
        batch = self.batch
        product = wp.zeros(vectors.shape, dtype=wp.float64, device=self.device)
        batch.launch(
            banded.multiply,
            vectors.shape,
            [
                batch.every_rod,
                batch.derivatives.hessian,
                wp.array(vectors, dtype=wp.float64, device=self.device),
            ],
            [product],
        )
        return product.numpy()

    def _gradient_rate(self, setups: Sequence[ClampedSetup]) -> np.ndarray:
        """(rod, dof) derivative of the energy's gradient along the setups' imaginary parts."""
        batch, device = self.batch, self.device
        rate = {}
        for name, value in batch_arrays(setups).items():
            array = getattr(batch, name)
            value = np.broadcast_to(np.imag(value) / COMPLEX_STEP, full_shape(array))
            rate[name] = wp.array(np.ascontiguousarray(value), dtype=array.dtype, device=device)
        out = wp.zeros_like(batch.derivatives.gradient)
        rods, nodes, state = batch.rod_count, batch.node_count, batch.state
        batch.launch(
            stretching_rate,
            (rods, nodes - 1),
            [
                batch.rest_length,
                batch.stretching_stiffness,
                rate["rest_length"],
                rate["stretching_stiffness"],
                state.dof,
            ],
            [out],
        )
        names = ("rest_length", "bending_stiffness", "natural_curvature", "softening")
        bends = [([getattr(batch, n) for n in names], [rate[n] for n in names])]
        for layer, own in zip(batch.layers, law_layers(setups), strict=True):
            own = [wp.array(np.imag(v) / COMPLEX_STEP, dtype=wp.vec2d, device=device) for v in own]
            bends.append(
                (
                    [batch.rest_length, layer[0], batch.natural_curvature, layer[1]],
                    [rate["rest_length"], own[0], rate["natural_curvature"], own[1]],
                )
            )
        for model, rates in bends:
            batch.launch(
                softened_bending_rate,
                (rods, nodes - 2),
                [*model, *rates, state.dof, state.director],
                [out],
            )
        names = ("rest_length", "twisting_stiffness", "natural_twist")
        batch.launch(
            twisting_rate,
            (rods, nodes - 2),
            [getattr(batch, n) for n in names]
            + [rate[n] for n in names]
            + [state.dof, state.reference_twist],
            [out],
        )
        self._add_coupling_rate(np.imag(coupling_of(setups)) / COMPLEX_STEP, rate, out)
        no_load = wp.zeros_like(batch.point_load)
        no_energy = wp.zeros_like(batch.derivatives.energy)
        for mass, gravity in (
            (rate["node_mass"], batch.gravity),
            (batch.node_mass, rate["gravity"]),
        ):
            batch.launch(
                dead_loads,
                (rods, nodes),
                [mass, gravity, no_load, batch.load_factor, batch.every_rod, state.dof],
                [no_energy, out],
            )
        rate = out.numpy().copy()
        force = np.imag(dead_force(setups)) / COMPLEX_STEP
        rate -= np.pad(force, ((0, 0), (0, 0), (0, 1))).reshape(rods, -1)[:, :-1]
        return rate

    def _add_coupling_rate(self, coupling_rate, rate, out) -> None:
        """What the coupling of bending with twist adds to `_gradient_rate`.

        It is linear in the coupling and quadratic along the rates of both natural strains, so that
        central differences are exact there; along that of the rest length they are good to 1e-8.
        """
        batch, device = self.batch, self.device
        names = ("rest_length", "bending_stiffness", "natural_curvature", "twisting_stiffness")
        model = {n: getattr(batch, n) for n in (*names, "natural_twist")}

        def add(number, factor, **moved):
            """`factor` times the gradient with some of the model's arrays in other values."""
            arrays = [moved.get(n, a) for n, a in model.items()]
            part = wp.zeros_like(out)
            state = batch.state
            batch.launch(
                bend_twist_energy,
                (batch.rod_count, batch.node_count - 2),
                [*arrays, number, batch.every_rod]
                + [state.dof, state.director, state.reference_twist, 1],
                [wp.zeros_like(batch.derivatives.energy), part, batch.derivatives.hessian],
            )
            out.assign(out.numpy() + factor * part.numpy())

        if coupling_rate.any():
            add(wp.array(coupling_rate, dtype=wp.vec2d, device=device), 1.0)
        for _, coupling in batch.energies:
            for moving, least in ((("natural_curvature", "natural_twist"), 1.0), (names[:1], 1e-4)):
                rates = {n: rate[n].numpy() for n in moving}
                largest = max(np.abs(r).max() for r in rates.values())
                if largest == 0.0:
                    continue
                h = least / largest
                if moving == names[:1]:
                    h *= float(batch.rest_length.numpy().max())
                for sign in (1.0, -1.0):
                    moved = {
                        n: wp.array(
                            model[n].numpy() + sign * h * r, dtype=model[n].dtype, device=device
                        )
                        for n, r in rates.items()
                    }
                    add(coupling, 0.5 * sign / h, **moved)

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

    def _wind_rate(self, wind, wind_rate, step) -> np.ndarray:
        position = self.batch.positions() + 1j * COMPLEX_STEP * node_part(step)
        load = np.imag(wind_load(position, wind + 1j * COMPLEX_STEP * wind_rate)) / COMPLEX_STEP
        rate = np.zeros((len(step), load.shape[1], 4))
        rate[:, :, :3] = load
        return rate.reshape(len(step), -1)[:, :-1]
