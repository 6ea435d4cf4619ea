"""The training loop: steps, watching, checkpoints that resume, new samples where it errs most."""

import io
import math
import os
import time
import zipfile
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
from wrod.training.dataset import GraspTable
from wrod.training.network import GraspNetwork
from wrod.training.optimizer import Soap
from wrod.training.recipes import Recipe
from wrod.training.sampling import RANGE, RodInputs, sample_worst
from wrod.training.score import figures

from wrod.controller.controller import Controller
from wrod.errors import DataError, needed_extras
from wrod.files import checked_path, write_atomically, write_csv
from wrod.files.reading import shown
from wrod.files.writing import keeps

with needed_extras():
    import torch

CHECKPOINT = "checkpoint.pt"
_FORMAT = "wrod-checkpoint-1"
_MOST_BYTES = 8 * 2**30
# Forces count less than poses: nobody grips by them.
_FORCE_WEIGHT = 0.3
# The falling rate ends at this fraction of the first.
_LAST_RATE = 1e-3
# Where a run is, which checkpoints keep.
_PROGRESS = ("step", "seconds", "rounds", "batch", "using", "best", "waited", "uses_all")
# Validations without a better one before an alternating recipe changes its optimiser.
_PATIENCE = 3


def errors(network, table: GraspTable, device: str = "cpu") -> np.ndarray:
    """(n, 6) errors of position [L_gb] and rotation vector [rad] on every row; of a naturally
    curved rod (n, 7), with the twist [rad]."""
    parts = []
    with torch.no_grad():
        for begin in range(0, len(table), 16384):
            rows = slice(begin, begin + 16384)
            inputs = torch.from_numpy(table.inputs[rows]).to(device)
            found = network(inputs).cpu().numpy()
            pose = _pose(found.shape[1])
            parts.append(found[:, pose] - table.outputs[rows][:, pose])
    return np.concatenate(parts)


def _pose(columns: int) -> list[int]:
    """Which of so many outputs are the grip's pose, twist included, and not the force."""
    return [*range(6), *range(9, columns)]


def _refuse_damage(path: Path) -> None:
    """Raise a ValueError if a part of a checkpoint does not fit its checksum, at which torch does
    not look, or is packed, as none of ours is."""
    with zipfile.ZipFile(path) as archive:
        parts = archive.infolist()
        packed = any(part.compress_type for part in parts)
        if packed or sum(part.file_size for part in parts) > os.path.getsize(path):
            raise ValueError("it is packed")
        if archive.testzip() is not None:
            raise ValueError("a checksum does not fit")


class Training:
    """One run of a recipe on a table of grasps.

    Args:
        recipe: what to do.
        table: grasps to learn from; a share is held out for validation.
        seed: of split, first weights and batches.
        device: "cpu" or "cuda:0".
        folder: where checkpoints go and come from.
        refine: new grasps to ask for, in two rounds, where the validation error is largest.
        solve: called with (n, 3) inputs for these grasps.
        rod: that all grasps are of, where they are those of one rod.

    Raises:
        DataError: the recipe does not learn such rods, or wants sensitivities that the table has
            not, or the folder holds a checkpoint of another run.
    """

    def __init__(
        self,
        recipe: Recipe,
        table: GraspTable,
        *,
        seed: int,
        device: str,
        folder: Path,
        refine: int = 0,
        solve: Callable[[np.ndarray], GraspTable] | None = None,
        rod: RodInputs | None = None,
    ):
        if recipe.sensitivity_weight and table.sensitivity is None:
            raise DataError("the recipe learns from sensitivities, which this dataset lacks")
        curved = rod is not None and not rod.is_straight
        if curved != (recipe.architecture == "curved"):
            kind = "one naturally curved rod" if curved else "naturally straight rods"
            raise DataError(
                f"the grasps are of {kind}, which recipe {recipe.name!r} does not learn; "
                f"use recipe {'curved' if curved else 'default'!r}"
            )
        if len(table) < 20:
            raise DataError(f"{len(table)} grasps are too few to learn from; solve more")
        self.recipe, self.seed, self.device, self.folder = recipe, seed, device, Path(folder)
        self.refine, self.solve = refine, solve
        self.samples = len(table)
        order = np.random.default_rng(seed).permutation(len(table))
        held_out = max(1, int(recipe.validation_share * len(table)))
        self.validation = table.take(order[:held_out])
        self.learning = table.take(order[held_out:])
        self.generator = torch.Generator().manual_seed(seed)
        self.rod = rod
        size = 0.0 if rod is None else math.hypot(*rod.natural_curvature)
        self.network = GraspNetwork(
            recipe.architecture, recipe.width, recipe.depth, self.learning, self.generator, size
        ).to(device)
        self.step, self.seconds, self.rounds = 0, 0.0, 0
        self.history: list[list[float]] = []
        # Of alternating recipes:
        self.batch, self.using, self.best, self.waited = recipe.batch, 0, math.inf, 0
        self.uses_all = False
        self.optimizers = self._optimizers()
        self._upload()

    def _optimizers(self) -> list[torch.optim.Optimizer]:
        parameters, rate = list(self.network.parameters()), self.recipe.learning_rate
        if self.recipe.optimizer == "soap":
            return [Soap(parameters, lr=rate)]
        return [
            torch.optim.Adam(parameters, lr=rate),
            torch.optim.SGD(parameters, lr=10.0 * rate, momentum=0.9),
        ]

    def _upload(self) -> None:
        """Put what is learnt from on the device; on a CPU the tensors share NumPy's memory."""
        table = GraspTable.join([self.learning, self.validation]) if self.uses_all else None
        table = table or self.learning
        self.inputs = torch.from_numpy(table.inputs).to(self.device)
        self.outputs = torch.from_numpy(table.outputs).to(self.device)
        if self.recipe.sensitivity_weight:
            self.sensitivity = torch.from_numpy(table.sensitivity).to(self.device)

    def run(
        self,
        *,
        minutes: float | None = None,
        checkpoint_every: float = 2.0,
        watch_every: int = 500,
        progress: Callable[[int, int, float], object] | None = None,
    ) -> None:
        """Train to the recipe's last step, or until `minutes` have been spent in all runs.

        Args:
            minutes: the rate falls with the steps or with the time, whichever is further.
            checkpoint_every: seconds between checkpoints; at least 20 times what one takes, or 0
                for one after every step.
            watch_every: steps between validations.
            progress: called with steps done, all steps and the last validation MAE.
        """
        budget = math.inf if minutes is None else 60.0 * minutes
        steps, begin = self.recipe.steps, time.monotonic() - self.seconds
        saved, took, told = time.monotonic(), 0.0, -math.inf
        while self.step < steps and self.seconds < budget:
            done = max(self.step / steps, self.seconds / budget)
            if self.refine and self.solve and self.rounds < 2 and done > (self.rounds + 1) / 4:
                self._ask_for_more()
            self._one_step(done)
            self.step += 1
            self.seconds = time.monotonic() - begin
            watched = self.step % watch_every == 0 or self.step == steps
            if watched:
                self._watch()
            if progress is not None and (watched or time.monotonic() - told > 1.0):
                told = time.monotonic()
                progress(self.step, steps, self.history[-1][2] if self.history else math.nan)
            pause = max(checkpoint_every, 20.0 * took) if checkpoint_every > 0.0 else 0.0
            if time.monotonic() - saved > pause:
                start = time.monotonic()
                self.checkpoint()
                saved = time.monotonic()
                took = saved - start
        if not self.history or self.history[-1][0] != self.step:
            self._watch()
        self.checkpoint()

    def _one_step(self, done: float) -> None:
        recipe = self.recipe
        optimizer = self.optimizers[self.using]
        if recipe.optimizer == "soap":
            fall = 0.5 * (1.0 + math.cos(math.pi * min(done, 1.0)))
            rate = recipe.learning_rate * (fall * (1.0 - _LAST_RATE) + _LAST_RATE)
            for group in optimizer.param_groups:
                group["lr"] = rate
        # Drawn on the CPU, so that every device sees the same batches.
        rows = torch.randint(len(self.inputs), (self.batch,), generator=self.generator)
        direction = None
        if recipe.sensitivity_weight:
            direction = torch.randn(self.batch, 3, generator=self.generator, dtype=torch.float64)
            direction = direction.to(self.device)
        optimizer.zero_grad()
        self.loss(rows.to(self.device), direction).backward()
        optimizer.step()

    def loss(self, rows: torch.Tensor, direction: torch.Tensor | None = None) -> torch.Tensor:
        """Loss of some rows; with sensitivities, of their derivatives along `direction` (n, 3).

        A random direction in (log l_s, kappa, log k_s) per grasp and step costs one tangent
        instead of three, and matches all of them in the mean.
        """
        inputs, outputs = self.inputs[rows], self.outputs[rows]
        if direction is None:
            return self._size(self.network(inputs) - self._known(outputs))
        one = torch.ones_like(inputs[:, 1])
        tangent = direction * torch.stack([inputs[:, 0], one, inputs[:, 2]], -1)
        value, rate = torch.func.jvp(self.network, (inputs,), (tangent,))
        wanted = torch.einsum("nij,nj->ni", self.sensitivity[rows], tangent)
        total = self._size(value - self._known(outputs))
        return total + self.recipe.sensitivity_weight * self._size(rate - self._known(wanted))

    def _known(self, outputs: torch.Tensor) -> torch.Tensor:
        return outputs[:, :6] if self.network.architecture == "paper" else outputs

    def _size(self, error: torch.Tensor) -> torch.Tensor:
        if self.recipe.loss == "absolute":
            return error[:, :6].abs().mean()
        square = error.square().mean(dim=0)
        pose = square[_pose(len(square))].sum()
        return pose + _FORCE_WEIGHT**2 * square[6:9].sum()

    def _watch(self) -> None:
        """Validate, and let an alternating recipe react."""
        error = float(np.abs(errors(self.network, self.validation, self.device)).mean())
        if not math.isfinite(error):
            raise DataError(
                f"the network's error is {error} after {self.step} steps; train with a smaller "
                "--sensitivity-weight, or look for damage in the dataset"
            )
        rate = self.optimizers[self.using].param_groups[0]["lr"]
        self.history.append([self.step, self.seconds, error, rate, self.batch])
        if self.recipe.optimizer != "alternating":
            return
        if error < self.recipe.all_below and not self.uses_all:
            self.uses_all = True
            self._upload()
        if error < 0.99 * self.best:
            self.best, self.waited = error, 0
            return
        self.waited += 1
        if self.waited >= _PATIENCE:
            self.waited, self.using = 0, 1 - self.using
            self.batch = min(2 * self.batch, self.recipe.largest_batch)

    def _ask_for_more(self) -> None:
        """Solve grasps where the validation error is largest, and learn from them as well."""
        size = np.linalg.norm(errors(self.network, self.validation, self.device), axis=1)
        count = self.refine // 2
        first = self.samples + 4 * count * self.rounds
        inputs = sample_worst(self.validation.inputs, size, first, count, self.seed)
        self.learning = GraspTable.join([self.learning, self.solve(inputs)])
        self.rounds += 1
        self._upload()

    def checkpoint(self) -> Path:
        """Write all that `resume` needs."""
        extra = None
        if self.rounds:
            known = self.samples - len(self.validation)
            rows = self.learning.take(slice(known, None))
            values = (rows.inputs, rows.outputs, rows.sensitivity)
            extra = [None if v is None else torch.from_numpy(v.copy()) for v in values]
        content = {
            "format": _FORMAT,
            "run": self._run(),
            "network": self.network.state_dict(),
            "optimizers": [optimizer.state_dict() for optimizer in self.optimizers],
            "generator": self.generator.get_state(),
            "progress": [getattr(self, name) for name in _PROGRESS],
            "history": self.history,
            "extra": extra,
        }
        buffer = io.BytesIO()
        torch.save(content, buffer)
        path = self.folder / CHECKPOINT
        return write_atomically(path, lambda file: file.write(buffer.getvalue()), "wb")

    def resume(self) -> bool:
        """Go on from the folder's checkpoint, if there is one.

        Raises:
            DataError: it is damaged, or of another recipe, seed or dataset.
        """
        path = self.folder / CHECKPOINT
        keeps(path)
        if not path.exists():
            return False
        checked_path(path, "a checkpoint; delete it", limit=_MOST_BYTES)
        try:
            _refuse_damage(path)
            content = torch.load(path, map_location=self.device, weights_only=True)
            known = content["format"] == _FORMAT
            other = not known or content["run"] != self._run()
        except Exception as error:
            said = shown(error, 200)
            raise DataError(f"{path}: not a readable checkpoint ({said}); delete it") from None
        if other:
            raise DataError(
                f"{path}: is of another recipe, seed or dataset; delete it or choose another --out"
            )
        try:
            self._restore(content)
        except Exception as error:  # whichever part of the file lacks or is misshapen
            said = shown(error, 200)
            raise DataError(f"{path}: a part of it does not fit ({said}); delete it") from None
        return True

    def _restore(self, content: dict) -> None:
        self.network.load_state_dict(content["network"])
        for optimizer, state in zip(self.optimizers, content["optimizers"], strict=True):
            optimizer.load_state_dict(state)
        self.generator.set_state(content["generator"].cpu())
        for name, value in zip(_PROGRESS, content["progress"], strict=True):
            setattr(self, name, value)
        self.history = content["history"]
        if content["extra"] is not None:
            parts = [None if v is None else v.cpu().numpy() for v in content["extra"]]
            self.learning = GraspTable.join([self.learning, GraspTable(*parts)])
        finite = all(bool(torch.isfinite(p).all()) for p in self.network.parameters())
        whole = all(isinstance(n, int) and n >= 0 for n in (self.step, self.rounds, self.batch))
        if not (finite and whole and self.using in range(len(self.optimizers))):
            raise ValueError("weights or counters are not numbers that a training has")
        self._upload()

    def _run(self) -> dict:
        """What a checkpoint must agree in."""
        run = {**asdict(self.recipe), "seed": self.seed, "samples": self.samples}
        if self.rod is not None:
            run["rod"] = [self.rod.length, self.rod.stretch_ratio, *self.rod.natural_curvature]
        return run

    def controller(self, metadata: dict) -> Controller:
        """The trained controller, with `metadata` beside what every controller says of itself."""
        bounds = RANGE if self.rod is None else self.rod.range
        return Controller(
            self.network.arrays(),
            {
                "architecture": self.recipe.architecture,
                "range": {name: list(limits) for name, limits in bounds.items()},
                "rod": None if self.rod is None else asdict(self.rod),
                "recipe": asdict(self.recipe),
                "seed": self.seed,
                "samples": len(self.learning) + len(self.validation),
                "steps": self.step,
                "seconds": self.seconds,
                "validation": figures(errors(self.network, self.validation, self.device)),
                **metadata,
            },
        )

    def write_history(self, path: str | os.PathLike[str]) -> Path:
        """Write the validations as CSV."""
        head = ["step", "seconds", "validation_mae", "learning_rate", "batch"]
        return write_csv(path, head, self.history)
