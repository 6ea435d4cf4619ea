"""What a solver says of scenes that are set up otherwise than they seem meant to be."""

import warnings

import newton

from wrod.errors import WrodWarning


def _say(text: str) -> None:
    # Of the line that called the solver: through `arguments.checked`, `step`, and this module.
    warnings.warn(text, WrodWarning, stacklevel=5)


def _named(model: newton.Model, bodies) -> str:
    return ", ".join(repr(model.body_label[b]) for b in bodies[:3])


def nothing_holds(model: newton.Model, bodies) -> None:
    """Bodies that the solver moves would touch something, and it was given no contacts."""
    _say(
        f"this solver moves bodies with shapes ({_named(model, bodies)}) and was given no "
        "contacts: they fall through everything but rods. Give step the contacts of a "
        "newton.CollisionPipeline, or make them shapes without collision"
    )


def rods_of_long_ago() -> None:
    """Another solver has stepped into a state that the rods were not carried over to."""
    _say(
        "the rods of state_in are not those of the last step, which went into another "
        "state; other solvers do not carry rods over. Where one has written bodies into "
        "`other`, call step(state, other, control, contacts, dt, moved=other)"
    )


def nobody_feels(model: newton.Model, bodies) -> None:
    """Rods pull at bodies that another solver moves."""
    _say(
        f"rods pull at bodies that another solver moves ({_named(model, bodies)}), which does not "
        "feel them; call add_body_forces(state) on the state that it steps from"
    )
