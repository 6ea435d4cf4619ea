"""A cable with a stiff, heavy sleeve and a bend off the spool: one model, planned with."""

from pathlib import Path

import numpy as np
from _picture import panels, sagging, save

import wrod


def main(out: str | Path = "out/examples") -> Path:
    plain = wrod.RodModel.of(wrod.rod("cable"))
    k = plain.mean_bending_stiffness
    knots = (0.0, 0.15, 0.16, 0.29, 0.30, plain.length)
    sleeve = wrod.Profile((k, k, 4 * k, 4 * k, k, k), knots)
    mass = plain.line_mass.values[0]
    cable = wrod.RodModel(
        length=plain.length, bending_stiffness=(sleeve, sleeve),
        twisting_stiffness=plain.twisting_stiffness,
        stretching_stiffness=plain.stretching_stiffness,
        line_mass=wrod.Profile((mass, mass, 2 * mass, 2 * mass, mass, mass), knots),
        radius=plain.radius, natural_curvature=(0.0, 1.0),
    )  # fmt: skip
    path = wrod.save_rod(cable, Path(out) / "model.json")
    assert wrod.load_rod(path) == cable
    s = np.linspace(0.0, cable.length, 90)
    arc = sagging(s, apart=0.75)
    figure, axes = panels()
    for name, rod in (("plain", plain), ("with a sleeve, bent off the spool", cable)):
        batch = wrod.RodBatch.of(rod, s, arc[None], director=(0.0, 1.0, 0.0))
        wrod.prescribe(batch, pinned_nodes=(0, -1), clamped_angles=(0,))
        assert wrod.solve_equilibria(batch).converged.all()
        line = batch.positions()[0]
        axes.plot(line[:, 0], line[:, 2], label=name)
        low = line[line[:, 2].argmin()]
        print(f"{name}: hangs {-low[2]:.3f} m low at x = {low[0]:.3f} m")
    axes.set(aspect="equal", xlabel="x [m]", ylabel="z [m]")
    axes.legend(frameon=False)
    return save(figure, out, "cable_with_a_sleeve")


if __name__ == "__main__":
    main()
