"""One frame of every message of rig protocol v1, as it goes over the cable. Firmware must make and take the same.

Host tests compare `encode` and `Decoder` with these; they change only with the protocol's version.
"""

import numpy as np

from saranga.wire import (
    Config,
    Echo,
    Fault,
    Hello,
    HelloRequest,
    Message,
    SelfTest,
    SensorInfo,
    Stand,
    Start,
    Status,
    Stop,
    Throttle,
)

MESSAGES: dict[str, Message] = {
    "hello": Hello(flags=1, sequence=1, device_time_us=2500, firmware="rig 1.0", has_stand=True, has_throttle=True,
                   sensors=(
                       SensorInfo(sensor=0, role="left", fop_hz=53000.0, bandwidth_hz=3980.0, self_test="pass",
                                  transmits=True, serial="A1"),
                       SensorInfo(sensor=1, role="right", fop_hz=52750.5, bandwidth_hz=4100.0, self_test="fail"))),
    "echo": Echo(sensor=1, sequence=0x01020304, trigger=0x0A0B0C0D, device_time_us=0xFFFFFFFE, flags=1,
                 fop_hz=53000.0, odr=6, mode=1, iq=np.array([[0, 0], [1, -2], [256, -20984]], np.int16)),
    "status": Status(sequence=7, trigger=9, device_time_us=1_000_000, overruns=3, host_errors=1, cycles=39,
                     temperature_c=21.5, state=2),
    "stand": Stand(sequence=8, thrust_n=1.25, torque_n_m=0.5, rpm=12000.0, voltage_v=16.0, current_a=4.5,
                   esc_temperature_c=40.0, motor_temperature_c=35.5, throttle=0.25, token=0xDEADBEEF),
    "fault": Fault(sequence=9, code=513, text="overcurrent é", latched=True),
    "hello_request": HelloRequest(),
    "config": Config(sensor=2, odr=6, samples=340, ring_down_samples=20),
    "start": Start(mode=1, rate_hz=39.0625),
    "stop": Stop(sequence=5),
    "self_test": SelfTest(sensor=1, kind=1),
    "throttle": Throttle(value=0.5, token=0x01000002, deadline_ms=250),
}

FRAMES_HEX: dict[str, str] = {
    "hello": (
        "06010101ff0101010101010103c409010b0772696720312e3003020103010104084f470ac078450241310101"
        "0205800e4e470420804505e4d911d100"
    ),
    "echo": "1101020101040302010d0c0b0afeffffff07084f4706010301010101020103feff080108ae6f5d36c000",
    "status": "03010303ff070101020901010440420f020301010201010102270101010108ac4102839a8f3c00",
    "stand": (
        "03010403ff0801010101010101010101010103a03f0101023f04803b4601038041010390400103204201030e"
        "42010b803eefbeadde33f065c900"
    ),
    "fault": "03010503ff0901010101010101010101170102010e6f76657263757272656e7420c3a9e5078d7d00",
    "hello_request": "03018102ff010101010101010101010105317d418800",
    "config": "0301820202010101010101010101010105065401140501cb769e00",
    "start": "03018302ff0101010101010101010101020108401c42c344a5b800",
    "stop": "03018403ff050101010101010101010105aab4652300",
    "self_test": "030185020101010101010101010101010601fcdbe58200",
    "throttle": "03018602ff0101010101010101010101010101033f02010301fa050c28bb0900",
}
FRAMES: dict[str, bytes] = {name: bytes.fromhex(text) for name, text in FRAMES_HEX.items()}
