"""A denoiser of the user's own, by MODULE:NAME."""

import sys
from pathlib import Path

import numpy as np
import pytest

from saranga.denoise import load_denoiser
from saranga.echo import EchoImage
from saranga.errors import UsageError
from saranga.plugins import user_source

SOURCE = """
import numpy as np

class Mine:
    name, threshold, edge_offset_m = "mine", 0.5, 0.0
    def __init__(self, level=0.0):
        self.level = level
    def __call__(self, image):
        return np.full(512, self.level, np.float32)

ready = Mine(0.25)
class Half:
    name = "half"
NUMBER = 3
def needs_more(thing):
    return Mine()
"""


@pytest.fixture(autouse=True)
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_denoisers_of_a_test.py").write_text(SOURCE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "my_denoisers_of_a_test", raising=False)


def test_class_with_options_and_instance() -> None:
    assert load_denoiser("my_denoisers_of_a_test:Mine", level=0.75)(EchoImage())[0] == np.float32(0.75)
    assert load_denoiser("my_denoisers_of_a_test:ready")(EchoImage())[0] == np.float32(0.25)


@pytest.mark.parametrize(("spec", "said"), [
    ("my_denoisers_of_a_test:", "not MODULE:NAME"), ("no_such_module_here:X", "cannot be imported"),
    ("my_denoisers_of_a_test:Mien", "did you mean 'Mine'"), ("my_denoisers_of_a_test:NUMBER", "it is a int"),
    ("my_denoisers_of_a_test:Half", "lacks threshold, edge_offset_m, __call__"),
    ("my_denoisers_of_a_test:needs_more", "must have defaults"), ("tbdd", "did you mean 'tbd'")])
def test_refusals_say_why(spec: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        load_denoiser(spec)


def test_the_file_of_ones_own_module_is_found_for_the_provenance() -> None:
    assert user_source("my_denoisers_of_a_test:Mine") == Path.cwd() / "my_denoisers_of_a_test.py"
    for spec in ("tbd", "no_such_module_here:X", ":X", "sys:X"):
        assert user_source(spec) is None
