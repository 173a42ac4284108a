"""`python -m saranga`: the stack on a companion computer, and what it is trained on."""

import argparse
import signal
import sys
from pathlib import Path

from saranga import evaluate_command, export_command, publish_command, synthesis_command, train_command
from saranga.errors import BenchError, UsageError

COMMANDS = (
    ("synthesise", "draw training pairs", synthesis_command),
    ("train", "train a network", train_command),
    ("evaluate", "compare denoisers", evaluate_command),
    ("export", "write a network for a runtime", export_command),
    ("publish", "export, calibrate and measure a network as it ships", publish_command),
)
RUN_HELP = """\
Run the stack: echoes in, velocity setpoints out at 16 Hz.

It never arms, takes off or changes mode. Setpoints are sent only while the vehicle is armed, in GUIDED and in
the air; leave GUIDED on the transmitter to take over at any time.

  python -m saranga run --echoes serial:///dev/ttyACM0 --vehicle serial:///dev/ttyS0?baud=921600
  python -m saranga run --echoes tcp://127.0.0.1:7000 --vehicle tcp://127.0.0.1:5760 --speed 1.0
  python -m saranga run --echoes serial:///dev/ttyACM0 --vehicle serial:///dev/ttyS0?baud=921600 --sign-key key

--sign-key: MAVLink 2 signing; everything that is not signed with the same key is ignored (docs/companion.md).
Ctrl-C sends one last "stop" and ends. Exit codes: 0 ended by Ctrl-C or SIGTERM, 2 bad input, 4 a device failed.
"""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m saranga", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="fly: echoes in, velocity commands out", description=RUN_HELP,
                              formatter_class=argparse.RawDescriptionHelpFormatter)
    run.add_argument("--echoes", required=True, metavar="URL",
                     help="serial:///dev/ttyACM0, tcp://host:port or file:recording.mcap")
    run.add_argument("--vehicle", required=True, metavar="URL",
                     help="serial:///dev/ttyS0?baud=921600, tcp://host:port, udpin://host:port, udpout://host:port")
    run.add_argument("--sign-key", type=Path, metavar="FILE",
                     help="sign MAVLink and hear only what is signed: 64 hexadecimal digits or 32 raw bytes")
    run.add_argument("--denoiser", default="saranga", help="by name, or MODULE:NAME (default: %(default)s)")
    run.add_argument("--stack", default="saranga",
                     help="policy: saranga, batdeck, none or MODULE:NAME (default: %(default)s)")
    run.add_argument("--sonar", help="name in fixtures/sonars or a TOML path (default: the policy's own, else pair)")
    run.add_argument("--speed", type=float, default=1.0, metavar="M/S", help="desired speed (default: %(default)s)")
    run.add_argument("--temperature", type=float, metavar="C",
                     help="air, for the speed of sound (default: by the rig's STATUS, the sonar file until then)")
    run.add_argument("--disparity", choices=("auto", "phase", "envelope", "edges"), default="auto",
                     help="what azimuth comes from (default: phase for calibrated sensors, else envelope)")
    run.add_argument("--log", type=Path, metavar="FILE", help="append one JSON line a tick")
    run.set_defaults(handler=_run)
    for name, about, module in COMMANDS:
        command = commands.add_parser(name, help=about, description=module.HELP,
                                      formatter_class=argparse.RawDescriptionHelpFormatter)
        module.add_arguments(command)
        command.set_defaults(handler=module.run)
    return parser


def _run(arguments: argparse.Namespace) -> int:
    from saranga.companion import Companion
    from saranga.denoise import load_denoiser
    from saranga.echo import load_sonar
    from saranga.navigate import load_policy, sonar_of
    from saranga.signing import load_sign_key
    from saranga.sources import open_source
    from saranga.stack import Stack
    from saranga.transport import open_transport

    if not 0.0 < arguments.speed <= 3.0:
        raise UsageError(f"--speed {arguments.speed:g} m/s: must be over 0 and at most 3 m/s")
    sign_key = load_sign_key(arguments.sign_key) if arguments.sign_key is not None else None
    geometry = load_sonar(arguments.sonar or sonar_of(arguments.stack))
    fixed = arguments.temperature is not None
    stack = Stack(load_denoiser(arguments.denoiser), load_policy(arguments.stack, desired_speed_m_s=arguments.speed),
                  geometry, arguments.temperature if fixed else geometry.temperature_c, arguments.disparity)
    stack.warm_up()
    source = open_source(arguments.echoes)
    vehicle = open_transport(arguments.vehicle)
    try:
        source.open()
        companion = Companion(stack, source, vehicle, arguments.log,
                              say=lambda line: print(line, file=sys.stderr, flush=True),
                              follow_temperature=not fixed, sign_key=sign_key)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda received, _: companion.stop(signal.Signals(received).name))
        reason = companion.run()
    finally:
        source.close()
        vehicle.close()
    tally = companion.tally
    print(f"ended by {reason}: {tally.ticks} ticks, {tally.setpoints} setpoints, {tally.late_ticks} late ticks, "
          f"{tally.faults} ticks with a fault, longest step {tally.longest_step_ms:.1f} ms; "
          f"link {source.counters}", file=sys.stderr)
    return 0


def main(argv: list[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    arguments = _parser().parse_args(argv)
    try:
        code: int = arguments.handler(arguments)
        return code
    except BenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code


if __name__ == "__main__":
    sys.exit(main())
