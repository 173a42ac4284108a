"""Parameter sets: both spellings, read back, nothing lost."""

from pathlib import Path

import pytest

from saranga.errors import UsageError
from sitl.autopilot.parameters import load_parameters, mismatches, write_defaults

SHIPPED = load_parameters("arducopter-gps-denied")


def test_both_spellings_are_written(tmp_path: Path) -> None:
    write_defaults(SHIPPED, tmp_path / "x.parm")
    lines = dict(line.split() for line in (tmp_path / "x.parm").read_text().splitlines())
    assert lines["GPS1_TYPE"] == lines["GPS_TYPE"] == "0"
    assert lines["RNGFND1_MAX"] == "5" and lines["RNGFND1_MAX_CM"] == "500"
    assert lines["EK3_SRC1_VELXY"] == "5"


@pytest.mark.parametrize("version,name", [((4, 7), "GPS1_TYPE"), ((4, 5), "GPS_TYPE"), ((4, 6), "GPS_TYPE")])
def test_each_version_is_asked_in_its_own_spelling(version: tuple[int, int], name: str) -> None:
    assert name in [p.spelling(version)[0] for p in SHIPPED]


def test_a_perfect_readback_has_no_mismatch_and_each_kind_of_wrong_is_named() -> None:
    answered = dict(p.spelling((4, 7)) for p in SHIPPED)
    assert mismatches(SHIPPED, (4, 7), answered) == []
    answered["FLOW_TYPE"] = 0.0
    del answered["EK3_SRC1_YAW"]
    answered["GUID_TIMEOUT"] = float("nan")
    wrong = "\n".join(mismatches(SHIPPED, (4, 7), answered))
    assert "FLOW_TYPE: reads 0, wanted 5" in wrong and "EK3_SRC1_YAW: no answer" in wrong
    assert "GUID_TIMEOUT: reads nan" in wrong


@pytest.mark.parametrize("text,expected", [
    ("[A]\nwhy = 'x'\n", "needs a number"), ("[A]\nvalue = 'x'\nwhy = 'x'\n", "needs a number"),
    ("[A]\nvalue = 1\n", "reason"), ("A = 1\n", "needs a number"), ("[A\n", "not valid TOML"),
    ("[ABCDEFGHIJKLMNOPQ]\nvalue = 1\nwhy = 'x'\n", "16 characters")])
def test_malformed_files_are_usage_errors_naming_file_and_parameter(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(UsageError, match=expected) as caught:
        load_parameters(str(path))
    assert "mine.toml" in str(caught.value)
