"""`saranga-bench report` on a comparison of denoisers."""

import json
from pathlib import Path

import pytest

from bench.cli import main as bench_main
from saranga.__main__ import main


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("compared")
    assert main(["evaluate", "--denoisers", "gaussian,tbd", "--images", "10", "--psnr", "10", "--out", str(folder),
                 "--json"]) == 0
    return folder


def report(folder: Path) -> int:
    try:
        bench_main(["report", str(folder)])
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


def test_the_page_holds_what_was_measured_and_needs_nothing_else(compared: Path,
                                                                 capsys: pytest.CaptureFixture[str]) -> None:
    assert report(compared) == 0
    page = Path(capsys.readouterr().out.strip())
    text = page.read_text()
    tree = json.loads((compared / "evaluation.json").read_text())
    assert f"{tree['methods']['tbd']['f1']:.3f}" in text and f"{tree['methods']['gaussian']['f1']:.3f}" in text
    rate = tree["methods"]["tbd"]["sets"]["single"]["10"]["hit_rate_strongest"]
    assert f"{100 * rate:.0f}" in text
    # three kinds of curves, cost, two sets by the paper's measures, two examples of each of three sets
    assert text.count("<svg") == 3 + 1 + 2 + 6
    assert "simulated" in text and "skipped" not in text.split("Provenance")[0]
    assert not [part for part in ('src="http', "<script", "@import") if part in text]


def test_an_interrupted_comparison_says_so_and_a_damaged_one_is_refused(compared: Path, tmp_path: Path,
                                                                        capsys: pytest.CaptureFixture[str]) -> None:
    tree = json.loads((compared / "evaluation.json").read_text())
    (tmp_path / "evaluation.json").write_text(json.dumps({**tree, "complete": False}))
    assert report(tmp_path) == 0
    assert "Interrupted" in (tmp_path / "evaluation.html").read_text()
    capsys.readouterr()
    for content, words in (("{", "cannot be read"), ('{"methods": {}}', "holds no comparison")):
        (tmp_path / "evaluation.json").write_text(content)
        assert report(tmp_path) == 2
        message = capsys.readouterr().err
        assert words in message and message.count("\n") == 1
