"""Units as stands and people write them, to SI. What a column measures decides what "g" in it means."""

import unicodedata

GRAVITY_M_S2 = 9.80665
POUND_N = 0.45359237 * GRAVITY_M_S2
INCH_M = 0.0254

# quantity -> SI unit, and unit -> (factor, offset): SI = value * factor + offset
_FORCE = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "gf": GRAVITY_M_S2 * 1e-3, "g": GRAVITY_M_S2 * 1e-3,
          "kgf": GRAVITY_M_S2, "kg": GRAVITY_M_S2, "kp": GRAVITY_M_S2, "lbf": POUND_N, "lb": POUND_N, "lbs": POUND_N,
          "ozf": POUND_N / 16, "oz": POUND_N / 16}
_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": INCH_M, "ft": 12 * INCH_M}
_TORQUE = {f"{a}{b}": fa * fb for a, fa in _FORCE.items() for b, fb in _LENGTH.items()} | {
    f"{b}{a}": fa * fb for a, fa in _FORCE.items() for b, fb in _LENGTH.items() if b in ("in", "ft")}
_POWER = {"W": 1.0, "mW": 1e-3, "kW": 1e3}
_ACCELERATION = {"m/s2": 1.0, "m/s^2": 1.0, "g": GRAVITY_M_S2, "mg": 1e-3 * GRAVITY_M_S2, "gn": GRAVITY_M_S2}
_TIME = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "μs": 1e-6, "us": 1e-6, "min": 60.0}
TURN_RPM = 60.0 / 6.283185307179586

UNITS: dict[str, tuple[str, dict[str, tuple[float, float]]]] = {
    "force": ("N", {u: (f, 0.0) for u, f in _FORCE.items()}),
    "torque": ("N·m", {u: (f, 0.0) for u, f in _TORQUE.items()}),
    "rotation": ("rpm", {"rpm": (1.0, 0.0), "krpm": (1e3, 0.0), "1/min": (1.0, 0.0), "rev/min": (1.0, 0.0),
                         "r/min": (1.0, 0.0), "hz": (60.0, 0.0), "rps": (60.0, 0.0), "rev/s": (60.0, 0.0),
                         "rad/s": (TURN_RPM, 0.0), "deg/s": (1.0 / 6.0, 0.0)}),
    "voltage": ("V", {"V": (1.0, 0.0), "mV": (1e-3, 0.0)}),
    "current": ("A", {"A": (1.0, 0.0), "mA": (1e-3, 0.0)}),
    "power": ("W", {u: (f, 0.0) for u, f in _POWER.items()}),
    "temperature": ("°C", {"C": (1.0, 0.0), "°C": (1.0, 0.0), "K": (1.0, -273.15), "F": (5 / 9, -160 / 9),
                           "°F": (5 / 9, -160 / 9)}),
    "acceleration": ("m/s²", {u: (f, 0.0) for u, f in _ACCELERATION.items()}),
    "time": ("s", {u: (f, 0.0) for u, f in _TIME.items()}),
    "pulse": ("s", {u: (f, 0.0) for u, f in _TIME.items()}),
    "ratio": ("1", {"%": (1e-2, 0.0), "": (1.0, 0.0), "1": (1.0, 0.0)}),
    "force per power": ("N/W", {f"{a}/{b}": (fa / fb, 0.0) for a, fa in _FORCE.items() for b, fb in _POWER.items()}),
}


def canonical(unit: str) -> str:
    """One spelling for the many: micro signs, degree signs, dots and blanks between factors, double-encoded text."""
    text = unicodedata.normalize("NFC", unit).replace("Â", "").replace("Î¼", "μ").strip()
    text = text.replace("µ", "μ").replace("²", "2")
    for degree in "º˚":
        text = text.replace(degree, "°")
    for dot in "·⋅•∙*.- ":
        text = text.replace(dot, "")
    return text


def conversion(quantity: str, unit: str) -> tuple[float, float] | None:
    """(factor, offset) to the SI unit of `quantity`; None: no unit of it. Case counts only where it must (mN, MN)."""
    table = UNITS[quantity][1]
    text = canonical(unit)
    if text in table:
        return table[text]
    near = [key for key in table if key.lower() == text.lower()]
    return table[near[0]] if len({table[key] for key in near}) == 1 else None


def si_unit(quantity: str) -> str:
    return UNITS[quantity][0]


def known_units(quantity: str) -> str:
    """For messages: a few of them."""
    names = list(UNITS[quantity][1])
    return ", ".join(names[:12])
