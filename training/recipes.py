"""How controllers are trained: the default recipe, and the paper's for comparison."""

from dataclasses import dataclass

from wrod.errors import DataError


@dataclass(frozen=True)
class Recipe:
    """Everything that a training run follows from, but data and seed.

    Attributes:
        name: of the recipe.
        architecture: of `wrod.controller.controller.ARCHITECTURES`.
        width, depth: units of a hidden layer, and number of these.
        optimizer: "soap" with a falling rate, or "alternating": SGD and Adam in turn.
        learning_rate: the largest.
        batch: grasps per step.
        largest_batch: what an alternating recipe grows the batch to, twofold at every stall.
        steps: of the optimiser.
        validation_share: part of the data that is held out to watch.
        all_below: once the validation MAE is below this, learn from all data.
        loss: "squared" or "absolute" mean error.
        sensitivity_weight: of the derivatives' error beside the outputs'.
    """

    name: str
    architecture: str
    width: int
    batch: int
    largest_batch: int
    steps: int
    depth: int = 3
    optimizer: str = "soap"
    learning_rate: float = 3e-3
    validation_share: float = 0.1
    all_below: float = 0.0
    loss: str = "squared"
    sensitivity_weight: float = 0.0


RECIPES = {
    recipe.name: recipe
    for recipe in (
        Recipe("default", "chain", 96, batch=1024, largest_batch=1024, steps=20_000),
        # One naturally curved rod: a map of two inputs, learnt from a few thousand grasps.
        Recipe("curved", "curved", 64, batch=512, largest_batch=512, steps=6000),
        # Sec. Training the Neural Controller.
        Recipe(
            "paper", "paper", 392, batch=128, largest_batch=2048, steps=40_000, depth=4,
            optimizer="alternating", learning_rate=1e-3, validation_share=0.2, all_below=0.003,
            loss="absolute",
        ),
    )
}  # fmt: skip


def recipe(name: str) -> Recipe:
    """Recipe by name.

    Raises:
        DataError: no recipe has that name.
    """
    if name not in RECIPES:
        raise DataError(f"unknown recipe {name!r}; use one of {', '.join(RECIPES)}")
    return RECIPES[name]
