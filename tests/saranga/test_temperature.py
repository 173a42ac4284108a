"""The temperature of the air from the rig's STATUS to the range of an obstacle."""

import math
import threading

import numpy as np
import pytest
from echo_pairs import Point, frames
from test_companion import Vehicle

from saranga import __main__ as command
from saranga import companion, sources, transport
from saranga.companion import Companion
from saranga.denoise import load_denoiser
from saranga.echo import EchoCycle
from saranga.navigate import load_policy
from saranga.sonar_geometry import load_sonar
from saranga.sources import InProcessSource
from saranga.stack import Stack
from saranga.wire import Status, encode

PAIR = load_sonar("pair")
SPEEDS_M_S = {-10.0: 325.18, 20.0: 343.21, 35.0: 351.89}
"""331.3 sqrt(1 + T / 273.15)."""


@pytest.mark.parametrize("air_c", sorted(SPEEDS_M_S))
def test_range_with_the_right_and_with_a_wrong_temperature(air_c: float) -> None:
    rng = np.random.default_rng(1)
    cycles = [EchoCycle(k, k * PAIR.cycle_us, frames([Point(1.0, 0.0)], PAIR, 31 - k, k, air_c, 40.0, rng))
              for k in range(32)]

    def ranges_m(temperature_c: float) -> list[float]:
        stack = Stack(load_denoiser("tbd"), load_policy("none"), PAIR, temperature_c)
        return [o.range_m for o in stack.step(cycles, 0).obstacles]

    assert ranges_m(air_c) == [pytest.approx(1.0, abs=0.004)]
    for believed_c, c_m_s in SPEEDS_M_S.items():
        assert ranges_m(believed_c) == [pytest.approx(c_m_s / SPEEDS_M_S[air_c], abs=0.005)]


def test_a_new_temperature_holds_for_the_echoes_from_then_on() -> None:
    stack = Stack(load_denoiser("tbd"), load_policy("none"), PAIR, 20.0)
    rng = np.random.default_rng(1)
    for k in range(64):
        if k == 32:
            stack.set_temperature(-10.0)
        heard = frames([Point(1.0, 0.0)], PAIR, 0, k, -10.0, 40.0, rng)
        decision = stack.step([EchoCycle(k, k * PAIR.cycle_us, heard)], k * PAIR.cycle_us)
        if k == 31:
            assert decision.obstacles[0].range_m == pytest.approx(1.055, abs=0.005)
    assert decision.obstacles[0].range_m == pytest.approx(1.0, abs=0.004)


def run(temperatures_c: list[float], follow: bool) -> tuple[Stack, list[str]]:
    stack = Stack(load_denoiser("gaussian"), load_policy("none"), PAIR, 20.0)
    source, said = InProcessSource(), list[str]()
    ran = Companion(stack, source, Vehicle(), None, said.append, follow_temperature=follow)
    for k, value in enumerate(temperatures_c):
        threading.Timer(0.1 + 0.2 * k, source.feed, [encode(Status(temperature_c=value))]).start()
    threading.Timer(0.2 + 0.2 * len(temperatures_c), ran.stop, ["test"]).start()
    ran.run()
    return stack, [text for text in said if text.startswith("air")]


def test_the_companion_follows_the_rigs_thermometer_in_steps() -> None:
    stack, said = run([-10.0, -10.05, -9.95, 35.1], follow=True)
    assert stack.c_m_s == pytest.approx(351.9, abs=0.05)
    assert said == ["air -10 C: 325.2 m/s", "air 35 C: 351.9 m/s"]


@pytest.mark.parametrize("reading_c", [math.nan, -60.0, 85.0, math.inf])
def test_a_thermometer_that_is_not_there_or_broken_is_not_followed(reading_c: float) -> None:
    stack, said = run([reading_c], follow=True)
    assert stack.c_m_s == pytest.approx(343.2, abs=0.05) and not said


def test_a_temperature_that_was_given_is_kept() -> None:
    stack, said = run([-10.0], follow=False)
    assert stack.c_m_s == pytest.approx(343.2, abs=0.05) and not said


@pytest.mark.parametrize("given,follows,c_m_s", [([], True, 343.2), (["--temperature", "-10"], False, 325.2)])
def test_the_command_line_decides_which(monkeypatch: pytest.MonkeyPatch, given: list[str], follows: bool,
                                        c_m_s: float) -> None:
    seen: dict[str, object] = {}

    class Recorder(Companion):
        def __init__(self, stack: Stack, *rest: object, **options: object) -> None:
            super().__init__(stack, *rest, **options)  # type: ignore[arg-type]
            seen.update(options, c_m_s=stack.c_m_s, disparity=stack.disparity)

        def run(self) -> str:
            return "test"

    monkeypatch.setattr(companion, "Companion", Recorder)
    monkeypatch.setattr(sources, "open_source", lambda url: InProcessSource())
    monkeypatch.setattr(InProcessSource, "open", lambda self: None)
    monkeypatch.setattr(transport, "open_transport", lambda url: Vehicle())
    monkeypatch.setattr("signal.signal", lambda *_: None)
    arguments = ["run", "--echoes", "tcp://rig:1", "--vehicle", "tcp://copter:2", "--denoiser", "gaussian"]
    assert command.main([*arguments, "--disparity", "envelope", *given]) == 0
    assert seen["follow_temperature"] is follows and seen["disparity"] == "envelope"
    assert seen["c_m_s"] == pytest.approx(c_m_s, abs=0.05)
