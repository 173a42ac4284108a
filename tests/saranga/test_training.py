"""The training loop: it learns, and an interruption changes nothing."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="training needs PyTorch: pip install 'saranga-bench[train]'")

from test_training_data import small  # noqa: E402

from saranga.__main__ import main  # noqa: E402
from saranga.errors import UsageError  # noqa: E402
from saranga.input_kinds import SHAPES  # noqa: E402
from saranga.network import (  # noqa: E402
    ARCHITECTURES,
    build_network,
    load_checkpoint,
    parameter_count,
    read_checkpoint,
)
from saranga.training.loop import TrainingOptions, loss_of, rate_at, train  # noqa: E402


@pytest.fixture(autouse=True)
def one_thread() -> object:
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def options(out: Path, **more: object) -> TrainingOptions:
    return TrainingOptions(out, threads=1, precision="fp32", check_every=10**6, **more)  # type: ignore[arg-type]


def quiet(_: str) -> None:
    pass


@pytest.mark.parametrize("name", sorted(ARCHITECTURES))
def test_size_and_shapes_are_as_promised(name: str) -> None:
    network = build_network(name)
    assert 1.24e6 * 0.95 <= parameter_count(network) <= 1.24e6 * 1.05
    layers = [m for m in network.modules() if isinstance(m, torch.nn.Conv2d | torch.nn.ConvTranspose2d)]
    assert [type(m).__name__ for m in layers] == ["Conv2d"] * 4 + ["ConvTranspose2d"] * 4
    out = network(torch.zeros(2, *SHAPES[network.input_kind][1:]))
    assert tuple(out.shape) == ((2, 512) if name == "tracks" else (2, 32, 512))


@pytest.mark.parametrize("name", sorted(ARCHITECTURES))
def test_an_interrupted_run_ends_where_an_uninterrupted_one_does(name: str, tmp_path: Path) -> None:
    recipe = small(name, pairs=24)
    whole = read_checkpoint(train(recipe, options(tmp_path / "whole"), quiet))
    calls = 0

    import saranga.training.loop as loop

    step = loop._Run._step

    def interrupted(run: object, *batch: object) -> float:
        nonlocal calls
        calls += 1
        if calls == 4:
            raise KeyboardInterrupt
        return step(run, *batch)  # type: ignore[arg-type]

    loop._Run._step = interrupted  # type: ignore[method-assign,assignment]
    try:
        with pytest.raises(KeyboardInterrupt):
            train(recipe, options(tmp_path / "cut"), quiet)
    finally:
        loop._Run._step = step  # type: ignore[method-assign]
    assert read_checkpoint(tmp_path / "cut" / "checkpoint.pt")["state"]["images"] == 12
    cut = read_checkpoint(train(recipe, options(tmp_path / "cut", resume=True), quiet))
    assert cut["state"]["images"] == whole["state"]["images"] == 24
    for key, value in whole["weights"].items():
        assert torch.equal(value, cut["weights"][key]), key


def test_a_run_can_start_from_the_weights_of_another(tmp_path: Path) -> None:
    first = train(small(pairs=24), options(tmp_path / "first"), quiet)
    recipe = small(pairs=8, seed=5)
    recipe = recipe.model_copy(update={"optimiser": recipe.optimiser.model_copy(update={"rate": 1e-9})})
    second = read_checkpoint(train(recipe, options(tmp_path / "second", start=first), quiet))
    before = read_checkpoint(first)
    assert second["state"]["images"] == 8
    assert second["state"]["started_from"] == {"recipe_sha256": before["recipe_sha256"], "images_seen": 24,
                                               "started_from": None}
    key = "down1.0.weight"
    assert torch.allclose(second["weights"][key], before["weights"][key], atol=1e-6)
    fresh = read_checkpoint(train(recipe, options(tmp_path / "fresh"), quiet))
    assert not torch.allclose(fresh["weights"][key], before["weights"][key], atol=1e-3)
    assert fresh["state"]["started_from"] is None
    with pytest.raises(UsageError, match=r"is of architecture 'tracks', the recipe wants 'paper'"):
        train(small("paper"), options(tmp_path / "paper", start=first), quiet)
    with pytest.raises(UsageError, match="does not exist"):
        train(small(), options(tmp_path / "none", start=tmp_path / "nothing.pt"), quiet)


def test_it_learns(tmp_path: Path) -> None:
    """The loss of a few images falls far under what saying the mean everywhere costs."""
    recipe = small(pairs=4, epochs=60)
    path = train(recipe, options(tmp_path), quiet)
    said = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert "strongest_within_5_cm" in said[-1]
    network = load_checkpoint(path)
    from saranga.training.feed import Sources, draw_batch

    batch = draw_batch(recipe, Sources.of(recipe), 0)
    with torch.inference_mode():
        logits = network(torch.from_numpy(batch.inputs))
    targets = torch.from_numpy(batch.targets)
    constant = torch.full_like(logits, float(torch.logit(targets.mean())))
    assert loss_of(recipe, logits, targets) < 0.6 * loss_of(recipe, constant, targets)


def test_rate_and_loss_are_what_the_recipe_says() -> None:
    recipe = small()
    o = recipe.optimiser
    assert rate_at(recipe, 0, 0.0) == pytest.approx(o.rate / o.warm_up_steps)
    assert rate_at(recipe, 10**6, 0.5) == pytest.approx(o.rate / 2)
    assert rate_at(recipe, 10**6, 1.0) == pytest.approx(0.0, abs=1e-12)
    assert rate_at(small("paper"), 0, 0.9) == 2e-4
    logits, targets = torch.tensor([[0.0, 2.0]]), torch.tensor([[1.0, 0.0]])
    p = 1.0 / (1.0 + np.exp(-2.0))
    assert float(loss_of(recipe, logits, targets)) == pytest.approx((4.0 * np.log(2.0) - np.log(1.0 - p)) / 2, rel=1e-5)
    assert float(loss_of(small("paper"), logits, targets)) == pytest.approx((0.25 + p * p) / 2, rel=1e-5)


def test_checkpoints_of_other_recipes_and_broken_ones_are_refused(tmp_path: Path) -> None:
    path = train(small(pairs=4), options(tmp_path), quiet)
    with pytest.raises(UsageError, match="exists: add --resume"):
        train(small(pairs=4), options(tmp_path), quiet)
    with pytest.raises(UsageError, match="another recipe"):
        train(small(pairs=8), options(tmp_path, resume=True), quiet)
    with pytest.raises(UsageError, match="does not exist: train one"):
        train(small(pairs=4), options(tmp_path / "new", resume=True), quiet)
    content = torch.load(path, weights_only=True)
    content["architecture"] = "paper"
    torch.save(content, tmp_path / "other.pt")
    with pytest.raises(UsageError, match="not of architecture 'paper'"):
        load_checkpoint(tmp_path / "other.pt")
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(UsageError, match="cannot be read"):
        load_checkpoint(path)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["--resume", "--start", "x.pt"], "give one of them"), (["--threads", "0"], "--threads is 0"),
     (["--recipe", "nothing"], "unknown training recipe 'nothing'"),
     (["--minutes", "-1"], "--minutes is -1"), (["--device", "abacus"], "--device 'abacus' cannot be used")],
)
def test_bad_options_are_one_clear_error(arguments: list[str], words: str, tmp_path: Path,
                                         capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "--out", str(tmp_path / "x"), *arguments]) == 2
    message = capsys.readouterr().err
    assert words in message and message.count("\n") == 1


def _heed_ctrl_c() -> None:
    """A shell that runs the tests in the background has it ignored, and so would every child."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.wall_time
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_leaves_a_checkpoint(number: signal.Signals, tmp_path: Path) -> None:
    process = subprocess.Popen([sys.executable, "-m", "saranga", "train", "--out", str(tmp_path), "--threads", "1"],
                               stderr=subprocess.PIPE, text=True, start_new_session=True, preexec_fn=_heed_ctrl_c)
    try:
        assert process.stderr is not None
        for line in process.stderr:
            if "images  " in line:
                break
        time.sleep(0.5)
        process.send_signal(number)
        assert process.wait(200) == 130
    finally:
        process.kill()
    assert read_checkpoint(tmp_path / "checkpoint.pt")["state"]["images"] > 0
