"""docs/companion.md is enough: its bytes are the project's, and a C++ client that knows nothing else flies."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from hil_helpers import ROOT, fly
from wire_examples import examples

SOURCE = Path(__file__).with_name("hil_client.cpp")
ECHO_WORDS = "echo 1 16909060 168496141 4294967294 53000 6 0 0 1 -2 256 -20984"


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> str:
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("no g++ on this machine: apt-get install g++ to prove the wire with a C++ client")
    program = tmp_path_factory.mktemp("client") / "hil_client"
    subprocess.run([compiler, "-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", "-o", str(program), str(SOURCE)],
                   check=True, timeout=120)
    return str(program)


@pytest.mark.parametrize("name", list(examples()))
def test_the_document_shows_the_bytes_of_the_code(name: str) -> None:
    text = (ROOT / "docs" / "companion.md").read_text(encoding="utf-8")
    block = re.search(rf"^{re.escape(name)} .*\n\n((?:    [0-9a-f ]+\n)+)", text, re.MULTILINE)
    assert block is not None, f"no example of {name}"
    assert bytes.fromhex(block.group(1)) == examples()[name], f"it must read {examples()[name].hex(' ')}"


def test_the_client_writes_the_same_frames_and_reads_an_echo_and_refuses_a_damaged_one(client: str) -> None:
    known = examples()
    damaged = bytearray(known["ECHO"])
    damaged[20] ^= 4
    asked = f"{known['ECHO'].hex()}\n{damaged.hex()}\n{known['START'].hex()}\n"
    ran = subprocess.run([client, "frames"], input=asked, capture_output=True, text=True, check=True, timeout=30)
    assert ran.stdout.splitlines() == [
        f"hello? {known['HELLO?'].hex()}", f"start {known['START'].hex()}",
        f"setpoint {known['SET_POSITION_TARGET_LOCAL_NED'].hex()}", ECHO_WORDS, "bad", "bad"]


def check_flight(client: str, folder: Path, autopilot: str) -> None:
    result, figures = fly(folder, (client,), autopilot, goal_m=4.0)
    assert result.outcome == "clean" and result.landed, result.cause
    assert figures["basis"] == "stamps", "it answers TIMESYNC"
    assert figures["setpoints"] > 25 and figures["lost_mavlink_frames"] == 0 and figures["echo_cycles_dropped"] == 0
    said = Path(result.files["companion"]).read_text()
    counts = re.search(r"echoes (\d+) bad (\d+) setpoints (\d+)", said)
    assert counts is not None, said
    echoes, bad, setpoints = map(int, counts.groups())
    assert echoes >= 2 * figures["echo_cycles"] and bad == 0 and setpoints >= figures["setpoints"]
    print(f"{autopilot}: response {figures['response_ms']}, {figures['setpoint_rate_hz']:.1f} Hz")


@pytest.mark.wall_time
@pytest.mark.xdist_group("wall_time")
def test_the_client_flies_the_embedded_autopilot(client: str, tmp_path: Path) -> None:
    check_flight(client, tmp_path, "embedded")


@pytest.mark.slow
@pytest.mark.wall_time
@pytest.mark.xdist_group("wall_time")
@pytest.mark.real_arducopter
def test_the_client_flies_the_real_arducopter(client: str, tmp_path: Path) -> None:
    check_flight(client, tmp_path, "arducopter")
