"""Energies of the section: any function of both curvatures and the twist, beside the linear rod's.

An energy is one Warp function, (excess strain, stiffness, numbers) -> `Response`: of the excesses
(kappa_1 / l - kappa0_1, kappa_2 / l - kappa0_2, tau / l - tau0), the section's (B_1, B_2, C) and
numbers of its own at a node, it says the energy per length, the moments, and their derivatives.
`make_section_energy` turns it into the kernel that `RodBatch.add_energy` takes, with the exact
gradient and Hessian; kernels/elastic/bend_twist.py is the shortest example.
"""

import warp as wp
from wrod.kernels.elastic.assembly import add_number
from wrod.kernels.elastic.bending import BendingResponse, add_stencil, make_bending
from wrod.kernels.elastic.curvature import component, excess_curvature, stencil, symmetric
from wrod.kernels.elastic.frames import HALF, TWO, ZERO
from wrod.kernels.elastic.model import ElasticModel
from wrod.kernels.elastic.twisting import twisting_moment


@wp.struct
class Response:
    """Energy per length, moments of the two curvatures and the twist, and their symmetric
    derivatives by the strains; the derivatives are only read of an order of 2."""

    energy: wp.float64
    moment: wp.vec3d
    tangent: wp.mat33d


@wp.func
def _as_it_is(excess: wp.vec2d, stiffness: wp.vec2d, law: BendingResponse) -> BendingResponse:
    return law


_bending = make_bending(_as_it_is, BendingResponse)


def make_section_energy(response: wp.Function, numbers: type) -> wp.Kernel:
    """The kernel of an energy, for `RodBatch.add_energy`.

    Args:
        response: (excess strain vec3d, stiffness vec3d, numbers) -> `Response`.
        numbers: Warp type of what the energy has at each node.
    """

    @wp.kernel(module="unique", enable_backward=False)
    def section_energy(
        # Model:
        model: ElasticModel,
        number: wp.array2d(dtype=numbers),
        # State in:
        active: wp.array(dtype=wp.int32),
        dof_in: wp.array2d(dtype=wp.float64),
        director_in: wp.array2d(dtype=wp.vec3d),
        reference_twist_in: wp.array2d(dtype=wp.float64),
        order: int,
        # Out:
        energy_out: wp.array(dtype=wp.float64),
        gradient_out: wp.array2d(dtype=wp.float64),
        hessian_out: wp.array3d(dtype=wp.float64),
    ):
        """Add energy and gradient, and the exact Hessian if `order` is 2."""
        r, j = wp.tid()
        if active[r] == 0:
            return
        i = j + 1
        principal = model.bending[r, i]
        if principal[0] == ZERO:  # at a cut
            return
        s = stencil(dof_in, director_in, r, i)
        rest = HALF * (model.rest_length[r, i - 1] + model.rest_length[r, i])
        curved = excess_curvature(s, rest, model.natural_curvature[r, i])
        tau = dof_in[r, 4 * i + 3] - dof_in[r, 4 * i - 1] + reference_twist_in[r, i]
        here = response(
            wp.vec3d(curved[0], curved[1], tau / rest - model.natural_twist[r, i]),
            wp.vec3d(principal[0], principal[1], model.twisting[r, i]),
            number[r, i],
        )
        tangent = here.tangent
        law = BendingResponse()
        law.energy = here.energy
        law.moment = wp.vec2d(here.moment[0], here.moment[1])
        law.tangent = wp.mat22d(tangent[0, 0], tangent[0, 1], tangent[1, 0], tangent[1, 1])
        none = wp.vec2d(ZERO, ZERO)
        bend = _bending(s, rest, none, none, law, none, order)
        twist = twisting_moment(ZERO, here.moment[2], tangent[2, 2] / rest, s)
        if order == 2:
            turn = s.length_e * twist.e
            for k in range(2):
                b = tangent[k, 2] / rest
                if b != ZERO:
                    c = component(s, k)
                    bend.ee += b * symmetric(c.e, turn)
                    bend.ef += b * (wp.outer(c.e, turn) + wp.outer(turn, c.f))
                    bend.ff += b * symmetric(c.f, turn)
                    bend.e_te += b * (c.te * turn - c.e)
                    bend.f_te += b * (c.te * turn - c.f)
                    bend.e_tf += b * (c.tf * turn + c.e)
                    bend.f_tf += b * (c.tf * turn + c.f)
                    bend.te_te -= TWO * b * c.te
                    bend.te_tf += b * (c.te - c.tf)
                    bend.tf_tf += TWO * b * c.tf
        no_force = wp.vec3d(ZERO, ZERO, ZERO)
        no_stiffness = wp.mat33d()
        if energy_out.shape[0] > 0:
            add_number(energy_out, r, bend.energy + twist.energy)
        add_stencil(
            r, i, s, bend, twist, no_force, no_force, no_stiffness, no_stiffness,
            True, False, False, order, gradient_out, hessian_out,
        )  # fmt: skip

    return section_energy
