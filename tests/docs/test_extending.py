"""The four examples of "Adding to the bench" are found and do their work."""

from pathlib import Path

import numpy as np
import pytest

import bench.preflight.checks as checks
import bench.thrust_stand.drivers as drivers
from bench.preflight.evidence import Evidence, Heard, VehicleEvidence
from bench.thrust_stand.registry import open_stand
from saranga.echo import load_sonar
from saranga.errors import DeviceError
from saranga.plugins import plugins
from sitl.acoustics.atmosphere import StandardAir
from sitl.acoustics.shield import load_shield
from sitl.acoustics.sonar import AcousticModel
from sitl.scene import build_scene
from sitl.scene_spec import load_scene
from tests.docs.tutorial import steps

PAGE = Path(__file__).parents[2] / "docs" / "extending.md"


@pytest.fixture
def files(tmp_path: Path) -> Path:
    for step in steps(PAGE):
        assert isinstance(step, tuple)
        (tmp_path / step[0]).write_text(step[1], encoding="utf-8")
    return tmp_path


def test_the_scene_is_a_course(files: Path) -> None:
    scene = build_scene(load_scene(str(files / "my-gate.toml")), seed=1)
    assert scene.name == "my-gate" and len(scene.obstacles) == 2


def test_the_shield_takes_noise(files: Path) -> None:
    scene = build_scene(load_scene(str(files / "my-gate.toml")), seed=1)
    model = AcousticModel(scene.primitives, StandardAir(), load_sonar("pair"),
                          load_shield(str(files / "my-shield.toml")), 1)
    assert 3.0 < model.insertion_loss_db("left") < 40.0


def test_the_driver_measures(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drivers, "__path__", [*drivers.__path__, str(files)])
    grams = files / "grams.txt"
    stand = open_stand(f"weights:{grams}")
    with pytest.raises(DeviceError, match="is the logger running"):
        stand.open()
    grams.write_text("100\n")
    assert stand.open().quantities == {"thrust_n"}
    stand.tare()
    grams.write_text("220.0\n")
    assert stand.read(0.01)[0].thrust_n == pytest.approx(0.12 * 9.80665)


def test_the_check_finds(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "__path__", [*checks.__path__, str(files)])
    examine = plugins(checks)["board_temperature"].build()
    vehicle = VehicleEvidence("serial:///dev/ttyACM1", watch_s=(0.0, 10.0))
    assert examine(Evidence(vehicle))[0].value is None
    assert examine(Evidence())[0].blocked
    vehicle.messages["SCALED_PRESSURE"] = [Heard(1.0, {"temperature": 4150}), Heard(2.0, {"temperature": 4250})]
    found = examine(Evidence(vehicle))[0]
    assert found.value == 42.5 and found.samples == 2 and np.isfinite(found.heard_s)
