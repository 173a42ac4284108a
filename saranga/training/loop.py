"""The training loop: from a recipe to a checkpoint, resumable at any time."""

import contextlib
import itertools
import json
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from saranga.errors import BenchError, DeviceError, UsageError
from saranga.network import build_network, parameter_count, read_checkpoint
from saranga.training.check import check_sets, strongest_edge_rate
from saranga.training.feed import Feed, TrainingBatch
from saranga.training.feed_processes import feed_from_processes
from saranga.training.recipe import TrainingRecipe
from saranga.training.start import start_from

CHECKPOINT = "checkpoint.pt"
LOG = "log.jsonl"
SAVE_S = 60.0
SAY_S = 10.0
START_IMAGES = 512
"""Images that the normalisation of a published network is taken from."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class TrainingOptions:
    """How to run, none of which belongs to the recipe.

    Attributes:
        out: folder of checkpoint and log.
        resume: go on from the checkpoint in `out`.
        minutes: end by then, with the rate falling in time for it; None: all images of the recipe.
        threads, feed_threads: of PyTorch and of the drawing of images.
        feed_processes: draw in so many processes instead of in threads; 0: in threads.
        device: "cpu", "cuda", ...
        precision: "auto", "bf16" or "fp32".
        check_every: images between two looks at how well it does.
        start: checkpoint or published network whose weights the run begins with (see `start_from`); None: random ones.
    """

    out: Path
    resume: bool = False
    minutes: float | None = None
    threads: int = 2
    feed_threads: int = 1
    feed_processes: int = 0
    device: str = "cpu"
    precision: str = "auto"
    check_every: int = 50_000
    start: Path | None = None


@dataclass
class State:
    """What a checkpoint carries besides weights and optimiser."""

    images: int = 0
    elapsed_s: float = 0.0
    loss: float = math.nan
    started_from: dict[str, Any] | None = None
    """Recipe hash and images of the checkpoint that the weights come from, and what that one started from."""


def train(recipe: TrainingRecipe, options: TrainingOptions, say: Say = print) -> Path:
    """Train until all images are seen or the time is up; returns the checkpoint.

    Ctrl-C (KeyboardInterrupt) saves a checkpoint and is raised again.

    Raises:
        UsageError: a checkpoint of another recipe, none to resume, one of another architecture to start from, or one
            that would be overwritten.
        DeviceError: the loss is no longer finite, or the disk is full.
    """
    torch.set_num_threads(options.threads)
    torch.manual_seed(recipe.data.seed)
    device = _device(options.device)
    network = build_network(recipe.network.architecture)
    network.to(device=device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimiser = _optimiser(recipe, network)
    state = State()
    path = options.out / CHECKPOINT
    if options.resume:
        state = _restore(path, recipe, network, optimiser)
    elif path.exists():
        raise UsageError(f"{path} exists: add --resume to go on with it, or choose another --out")
    elif options.start is not None:
        state.started_from = start_from(options.start, recipe.network.architecture, network, _some_inputs(recipe))
    options.out.mkdir(parents=True, exist_ok=True)
    half = _half_precision(options.precision, device)
    say(f"{recipe.network.name}: {parameter_count(network) / 1e6:.3f} M parameters, {recipe.images:,} images, "
        f"{'bf16' if half else 'fp32'} on {device}, {options.threads} threads")
    first = state.images // recipe.optimiser.batch
    run = _Run(recipe, options, network, optimiser, state, device, half, say)
    with contextlib.ExitStack() as stack:
        stack.callback(run.save)
        if options.feed_processes:
            feed = feed_from_processes(recipe, options.feed_processes, first)
        else:
            threads = stack.enter_context(contextlib.closing(Feed(recipe, options.feed_threads, first)))
            feed = iter(threads)
        run.loop(feed)
    return path


class _Run:
    def __init__(self, recipe: TrainingRecipe, options: TrainingOptions, network: nn.Module,
                 optimiser: torch.optim.Optimizer, state: State, device: torch.device, half: bool, say: Say) -> None:
        self.recipe, self.options, self.network, self.optimiser = recipe, options, network, optimiser
        self.state, self.device, self.half, self.say = state, device, half, say
        self.checks = check_sets(_input_kind(recipe))
        self.started = time.monotonic() - state.elapsed_s
        self.first_images, self.first_s = state.images, state.elapsed_s
        self.check_at = (state.images // options.check_every + 1) * options.check_every

    def loop(self, feed: Iterator[TrainingBatch]) -> None:
        saved = said = time.monotonic()
        losses: list[float] = []
        for batch in feed:
            if self._progress() >= 1.0:
                break
            losses.append(self._step(torch.from_numpy(batch.inputs), torch.from_numpy(batch.targets)))
            self.state.images += len(batch.inputs)
            self.state.elapsed_s = time.monotonic() - self.started
            if not math.isfinite(losses[-1]):
                raise DeviceError(f"the loss is {losses[-1]} after {self.state.images} images: lower optimiser.rate, "
                                  "or use --precision fp32; the last checkpoint is kept")
            now = time.monotonic()
            if now - said >= SAY_S:
                self.state.loss = float(np.mean(losses))
                self._report()
                losses, said = [], now
            if self.state.images >= self.check_at:
                self.check_at += self.options.check_every
                self.check()
            if now - saved >= SAVE_S:
                self.save()
                saved = now
        if losses:
            self.state.loss = float(np.mean(losses))
        self.check()

    def _progress(self) -> float:
        done = self.state.images / self.recipe.images
        if self.options.minutes is not None:
            done = max(done, self.state.elapsed_s / (60.0 * self.options.minutes))
        return done

    def _step(self, inputs: Tensor, targets: Tensor) -> float:
        step = self.state.images // self.recipe.optimiser.batch
        for group in self.optimiser.param_groups:
            group["lr"] = rate_at(self.recipe, step, self._progress())
        inputs = inputs.to(self.device, memory_format=torch.channels_last)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.half):
            logits = self.network(inputs)
        loss = loss_of(self.recipe, logits.float(), targets.to(self.device))
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        self.optimiser.step()
        return loss.item()

    def check(self) -> None:
        """Log and say the rate of right strongest edges."""
        rates = {f"{one.psnr_db:g}": strongest_edge_rate(self.edges(one.inputs), one.range_m) for one in self.checks}
        self.say("  strongest edge within 5 cm: " + ", ".join(f"{rate:.3f} at {p} dB" for p, rate in rates.items()))
        self._log({"strongest_within_5_cm": rates})

    def edges(self, inputs: NDArray[np.float32]) -> NDArray[np.float32]:
        """Probabilities (K, N) of the newest row."""
        self.network.eval()
        out = []
        with torch.inference_mode(), torch.autocast(self.device.type, torch.bfloat16, enabled=self.half):
            for part in torch.from_numpy(inputs).split(100):
                logits = self.network(part.to(self.device, memory_format=torch.channels_last)).float().cpu()
                out.append(torch.sigmoid(logits if logits.ndim == 2 else logits[:, -1]))
        self.network.train()
        return torch.cat(out).numpy()

    def _report(self) -> None:
        rate = (self.state.images - self.first_images) / max(self.state.elapsed_s - self.first_s, 1e-9)
        left_s = (self.recipe.images - self.state.images) / max(rate, 1e-9)
        if self.options.minutes is not None:
            left_s = min(left_s, 60.0 * self.options.minutes - self.state.elapsed_s)
        self.say(f"{self.state.images:>9,} images  {rate:6.0f}/s  loss {self.state.loss:.5f}  "
                 f"{max(left_s, 0.0) / 60.0:.1f} min left")
        self._log({})

    def _log(self, more: dict[str, Any]) -> None:
        with (self.options.out / LOG).open("a", encoding="utf-8") as file:
            print(json.dumps({**_finite(asdict(self.state)), **more}),
                  file=file)

    def save(self) -> None:
        """Write the checkpoint; the old one stays until the new one is complete."""
        path = self.options.out / CHECKPOINT
        content = {
            "architecture": self.recipe.network.architecture, "recipe": self.recipe.model_dump(),
            "recipe_sha256": self.recipe.sha256, "state": asdict(self.state),
            "weights": {k: v.detach().cpu().contiguous() for k, v in self.network.state_dict().items()},
            "optimiser": self.optimiser.state_dict(),
            "made_by": {"torch": torch.__version__.split("+")[0], "device": self.device.type,
                        "threads": self.options.threads, "precision": "bf16" if self.half else "fp32"},
        }
        part = path.with_suffix(".part")
        try:
            torch.save(content, part)
            part.replace(path)
        except (OSError, RuntimeError) as error:
            raise DeviceError(f"{path} cannot be written: {error}; free some space and use --resume") from error


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}


def rate_at(recipe: TrainingRecipe, step: int, progress: float) -> float:
    """Learning rate of a step: linear warm-up, then constant or half a cosine down to zero at progress 1."""
    o = recipe.optimiser
    warm = min(1.0, (step + 1) / o.warm_up_steps) if o.warm_up_steps else 1.0
    fall = 0.5 * (1.0 + math.cos(math.pi * min(progress, 1.0))) if o.decay == "cosine" else 1.0
    return o.rate * warm * fall


def loss_of(recipe: TrainingRecipe, logits: Tensor, targets: Tensor) -> Tensor:
    """Mean over all columns; `edge_weight` weighs what is edge."""
    weight = recipe.loss.edge_weight
    if recipe.loss.kind == "bce":
        return functional.binary_cross_entropy_with_logits(logits, targets, pos_weight=torch.tensor(
            weight, device=logits.device))
    squared = (torch.sigmoid(logits) - targets) ** 2
    return torch.mean(squared * (1.0 + (weight - 1.0) * targets))


def _optimiser(recipe: TrainingRecipe, network: nn.Module) -> torch.optim.Optimizer:
    o = recipe.optimiser
    kind = torch.optim.AdamW if o.name == "adamw" else torch.optim.Adam
    return kind(network.parameters(), lr=o.rate, weight_decay=o.weight_decay)


def _some_inputs(recipe: TrainingRecipe) -> Tensor:
    """The recipe's first images, at least START_IMAGES of them."""
    first = Feed(recipe)
    try:
        batches = itertools.islice(first, math.ceil(START_IMAGES / recipe.optimiser.batch))
        return torch.cat([torch.from_numpy(batch.inputs) for batch in batches])
    finally:
        first.close()


def _input_kind(recipe: TrainingRecipe) -> str:
    return "tracks" if recipe.network.architecture == "tracks" else "envelope"


def _restore(path: Path, recipe: TrainingRecipe, network: nn.Module, optimiser: torch.optim.Optimizer) -> State:
    content = read_checkpoint(path)
    if content.get("recipe_sha256") != recipe.sha256:
        theirs = content.get("recipe_sha256")
        raise UsageError(f"checkpoint {path} was trained by another recipe ({theirs}, this one is {recipe.sha256}): "
                         "use its recipe, or start anew in another --out")
    network.load_state_dict(content["weights"])
    optimiser.load_state_dict(content["optimiser"])
    return State(**content["state"])


def _device(name: str) -> torch.device:
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise UsageError(f"--device {name!r} cannot be used: {str(error).splitlines()[0]}") from error
    return device


def _half_precision(wish: str, device: torch.device) -> bool:
    """bf16 where the hardware computes in it; elsewhere it is emulated and slower than fp32."""
    if wish != "auto":
        return wish == "bf16"
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported())
    try:
        return device.type == "cpu" and bool(torch.cpu._is_avx512_bf16_supported())
    except AttributeError as error:
        raise BenchError(f"this PyTorch ({torch.__version__}) does not say whether the CPU has bf16: give --precision"
                         ) from error
