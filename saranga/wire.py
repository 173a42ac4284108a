"""Rig protocol v1: what goes over the cable between the sonar rig and the host. Pure bytes, no I/O.

A frame is COBS(header + payload + CRC) followed by one 0x00. All numbers are little-endian; f32 is IEEE 754.
CRC is CRC-32 as in zlib (polynomial 0xEDB88320 reflected, start and final XOR 0xFFFFFFFF), u32, over header
and payload. A receiver drops what does not decode and goes on at the next 0x00. Text is a u8 length and UTF-8.

Header, 16 bytes:

    0 u8 version = 1    1 u8 type    2 u8 flags    3 u8 sensor (255: the rig itself, or all sensors)
    4 u32 sequence, counted per sensor byte    8 u32 trigger    12 u32 device time, us, at the trigger

Sequence, trigger and time wrap. An ECHO's trigger number is the same for all sensors of a cycle.

    type            payload (offsets from its start)
    0x01 HELLO      text firmware (<= 64), u8 capabilities (bit 0 stand, bit 1 throttle), u8 count (<= 16),
                    then per sensor: u8 sensor, u8 role (0 left, 1 right, 2 down, 255 none), u8 self test
                    (0 untested, 1 pass, 2 fail), u8 transmits (0, 1), f32 fop Hz, f32 bandwidth Hz,
                    text serial (<= 32).   Header flags bit 0: first since power-up
    0x02 ECHO       0 f32 fop Hz, 4 u8 ODR (2..6), 5 u8 mode (0 transmit/receive, 1 receive only),
                    6 u16 n (1..680), 8 n x (i16 Q, i16 I).
                    Header flags bit 0: cycles of this sensor were lost on the device
    0x03 STATUS     0 u32 overruns, 4 u32 bad frames from the host, 8 u32 cycles, 12 f32 temperature C,
                    16 u8 state (0 idle, 1 transmit/receive, 2 receive only)
    0x04 STAND      0 f32 thrust N, 4 f32 torque N m, 8 f32 rpm, 12 f32 V, 16 f32 A, 20 f32 ESC C,
                    24 f32 motor C, 28 f32 throttle applied (0..1), 32 u32 token of the throttle applied.
                    NaN: not measured
    0x05 FAULT      0 u16 code, 2 u8 latched (0, 1), 3 text (<= 200)
    0x81 HELLO?     nothing
    0x82 CONFIG     0 u8 ODR, 1 u16 samples (1..680), 3 u16 ring-down samples
    0x83 START      0 u8 mode, 1 f32 rate Hz (0.1..200)
    0x84 STOP       nothing
    0x85 SELF TEST  0 u8 kind (0 built-in, 1 link test: the sensor sends a known IQ sequence)
    0x86 THROTTLE   0 f32 value (0..1), 4 u32 token, 8 u16 deadline ms (1..5000), after which the device idles

`tests/saranga/golden_frames.py` holds one frame of each as bytes; firmware must produce and accept the same.
"""

from saranga.assembler import CycleAssembler, CycleCounters
from saranga.framing import MAX_FRAME_BYTES, VERSION, Decoder, LinkCounters, encode
from saranga.messages import (
    ALL_SENSORS,
    FLAG_BOOT,
    FLAG_OVERRUN,
    MAX_SAMPLES,
    MODE_RECEIVE_ONLY,
    MODE_TRANSMIT_RECEIVE,
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

__all__ = [
    "ALL_SENSORS", "FLAG_BOOT", "FLAG_OVERRUN", "MAX_FRAME_BYTES", "MAX_SAMPLES", "MODE_RECEIVE_ONLY",
    "MODE_TRANSMIT_RECEIVE", "VERSION", "Config", "CycleAssembler", "CycleCounters", "Decoder", "Echo",
    "Fault", "Hello", "HelloRequest", "LinkCounters", "Message", "SelfTest", "SensorInfo", "Stand", "Start",
    "Status", "Stop", "Throttle", "encode",
]
