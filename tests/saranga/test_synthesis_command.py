"""`python -m saranga synthesise`."""

import json
import struct
import zlib

import numpy as np
import pytest

from saranga.__main__ import main
from saranga.synthesis import Synthesiser, load_recipe


def command(tmp_path, *more: str) -> list[str]:
    return ["synthesise", "--count", "131", "--seed", "4", "--out", str(tmp_path / "a.npz"), *more]


def test_the_file_holds_the_pairs_in_order(tmp_path, capsys):
    assert main(command(tmp_path)) == 0
    assert "131/131 pairs" in capsys.readouterr().err
    batch = Synthesiser(load_recipe("default"), 4).batch(0, 66)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        assert np.array_equal(file["images"], batch.images.reshape(-1, 32, 512)[:131])
        assert np.array_equal(file["labels"], (255 * batch.labels.reshape(-1, 32, 512)[:131]).astype(np.uint8))
        assert file["truth"].tobytes() == batch.truth.tobytes()
        assert list(file["role"][:3]) == ["left", "right", "left"] and list(file["scene"][:3]) == [0, 0, 1]
        provenance = json.loads(str(file["provenance"]))
    assert provenance["seed"] == 4 and provenance["recipe_sha256"] == load_recipe("default").sha256
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


def test_values_roles_and_half_floats(tmp_path):
    assert main(command(tmp_path, "--set", "noise.psnr_db=[5, 5]", "--set", "label.rule=merged", "--roles", "right",
                        "--dtype", "float16")) == 0
    with np.load(tmp_path / "a.npz") as file:
        truth = file["truth"]
        assert file["images"].dtype == np.float16 and set(file["role"]) == {"right"} and len(truth) == 131
    seen = truth["psnr_db"] > -99
    assert np.allclose(truth["psnr_db"][seen & (truth["noise_model"] == 0)], 5, atol=1e-3) or (
        np.abs(truth["psnr_db"][seen] - 5) < 1e-3).mean() > 0.95


@pytest.mark.parametrize("after", [0, 1])
def test_interrupted_leaves_no_file(tmp_path, monkeypatch, capsys, after):
    calls = iter(range(100))
    real = Synthesiser.fill

    def fill(self, first, images, labels, iq=None):  # type: ignore[no-untyped-def]
        if next(calls) > after:
            raise KeyboardInterrupt
        return real(self, first, images, labels, iq)

    monkeypatch.setattr(Synthesiser, "fill", fill)
    assert main(command(tmp_path)) == 130
    assert "was not written" in capsys.readouterr().err and list(tmp_path.iterdir()) == []


def test_bad_input_is_one_line_and_exit_code_2(tmp_path, capsys):
    (tmp_path / "old.npz").write_bytes(b"mine")
    for more, words in (
        (["--count", "0"], "--count is 0: it must be at least 1"),
        (["--recipe", "defalt"], "did you mean 'default'"),
        (["--set", "noise.psnr_db"], "give TABLE.KEY=VALUE"),
        (["--set", "noise.psnr_db=[9, 1]"], "low must not exceed high"),
        (["--out", str(tmp_path / "old.npz")], "exists: data sets are never overwritten"),
        (["--out", str(tmp_path / "no" / "a.npz")], "there is no folder"),
        (["--out", str(tmp_path / "a.csv")], "must end in .npz"),
        (["--noise", str(tmp_path / "none.npz")], "does not exist"),
        (["--roles", "left,up"], "has no 'up' sensor"),
    ):
        assert main(command(tmp_path, *more)) == 2
        message = capsys.readouterr().err
        assert message.startswith("error: ") and words in message and message.count("\n") == 1
    assert (tmp_path / "old.npz").read_bytes() == b"mine"


def test_preview_is_a_grey_png(tmp_path):
    picture = tmp_path / "look.png"
    assert main([*command(tmp_path, "--preview", str(picture)), "--count", "2"]) == 0
    data = picture.read_bytes()
    width, height, depth, colour = struct.unpack(">IIBB", data[16:26])
    assert data[:8] == b"\x89PNG\r\n\x1a\n" and (width, height, depth, colour) == (1028, 2 * 102, 8, 0)
    begin = data.index(b"IDAT")
    size, = struct.unpack(">I", data[begin - 4:begin])
    body = data[begin + 4:begin + 4 + size]
    assert struct.unpack(">I", data[begin + 4 + size:begin + 8 + size])[0] == zlib.crc32(b"IDAT" + body)
    pixels = np.frombuffer(zlib.decompress(body), np.uint8).reshape(height, width + 1)[:, 1:]
    batch = Synthesiser(load_recipe("default"), 4).batch(0, 1)
    assert np.array_equal(pixels[0:96:3, 516:], 255 * batch.labels[0, 0].astype(np.uint8))
